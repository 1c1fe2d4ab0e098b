# SPDX-License-Identifier: GPL-3.0-or-later
"""Nothing invented, nothing lost: whatever happens to the stream, a reading is right or flagged."""

import faults
import numpy as np
import pytest
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.simulator import simulate

SEQUENCES, LONG_SEQUENCES = 50, 1000


@pytest.fixture(scope="module")
def codes(tmp_path_factory):
    """ADC codes of a press; shape (n, 2)."""
    path = tmp_path_factory.mktemp("faults") / "press"
    simulate(load_scene(faults.SCENE), path)
    return np.fromfile(f"{path}.sigmf-data", "<i2").reshape(-1, 2)


def check(codes, seed, chosen):
    """Reads the stream after these faults; returns readings and what is wrong with them."""
    stream = faults.faulty(codes, np.random.default_rng(seed), chosen)
    readings, reader = faults.read(stream)
    told = f"seed {seed}: {', '.join(stream.said)}"
    assert reader.failure is None, told
    # Every sample that came or was told lost lies in a group that is counted, but for the last.
    left = len(stream.codes) + reader.fold.samples_lost() - reader.counts.groups * faults.GROUP
    assert -faults.FRAME < left < faults.GROUP, told
    assert len(readings) == reader.counts.groups, told
    wrong = [(r.time_s, faults.wrong(r, stream.shift_s)) for r in readings]
    return readings, [f"{told}: at {time:.3f} s {what}" for time, what in wrong if what]


def test_without_a_fault_all_is_read(codes):
    readings, wrong = check(codes, 0, [])
    assert not wrong
    assert sum(not r.flags for r in readings) >= 28


@pytest.mark.parametrize("fault", faults.FAULTS, ids=lambda fault: fault.__name__)
def test_what_one_fault_spoils_is_flagged(codes, fault):
    readings, wrong = check(codes, 1, [fault])
    assert not wrong
    # What came before the fault is read.
    assert sum(not r.flags for r in readings) >= 8


@pytest.mark.timeout(7200)
def test_no_sequence_of_faults_gives_a_wrong_reading_without_a_flag(codes, long_run):
    wrong, clear = [], 0
    for seed in range(LONG_SEQUENCES if long_run else SEQUENCES):
        rng = np.random.default_rng([seed, 99])
        chosen = [
            faults.FAULTS[i] for i in rng.integers(len(faults.FAULTS), size=rng.integers(1, 5))
        ]
        readings, found = check(codes, seed, chosen)
        wrong += found
        clear += sum(not r.flags for r in readings)
    assert not wrong, "\n".join(wrong)
    assert clear > 10 * (seed + 1)
