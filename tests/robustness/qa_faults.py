# SPDX-License-Identifier: GPL-3.0-or-later
"""Nothing invented, nothing lost: whatever happens to the stream, a reading is right or flagged."""

from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache, partial
from multiprocessing import get_context

import faults
import numpy as np
import pytest
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate

SEQUENCES = 1000

# What the flags say of each fault; those left out cost nothing.
SHOWN_AS = {
    faults.lost_tagged: {"gap"},
    faults.lost_untagged: {"weak"},
    faults.doubled: {"weak"},
    faults.time_ahead: {"gap", "weak"},
    faults.clock_set_anew: {"gap", "weak"},
    faults.other_rate: {"gap", "moved"},
    faults.retuned: {"gap", "moved"},
    faults.reopened: {"gap", "moved"},
    faults.saturated: {"saturated"},
    faults.dead_air: {"weak"},
    faults.tag_off_and_on: {"weak"},
}


# Readers leave their buffers behind: see "What GNU Radio 3.10 requires" in docs/architecture.md.
PER_PROCESS = 100


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """ADC codes of a press, as a file."""
    path = tmp_path_factory.mktemp("faults") / "press"
    simulate(load_scene(faults.SCENE), path)
    return f"{path}.sigmf-data"


@lru_cache
def codes_in(path):
    """Shape (n, 2)."""
    return np.fromfile(path, "<i2").reshape(-1, 2)


def check(codes, seed, chosen, earliest=0):
    """Reads the stream after these faults; returns readings and what is wrong with them."""
    stream = faults.faulty(codes, np.random.default_rng(seed), chosen, earliest)
    readings, reader = faults.read(stream)
    case = f"seed {seed}: {', '.join(fault.__name__ for fault in chosen)}"
    assert reader.failure is None, case
    # Every sample that was received, or is known to be lost, lies in a group that is counted,
    # but for the last, and for silent or misplaced ones just before it.
    moved = reader.fold.samples_moved()
    unread = len(stream.codes) + reader.fold.samples_lost() + moved
    unread -= reader.counts.groups * faults.GROUP
    late = any(item > len(stream.codes) - 2 * faults.GROUP for (item,) in stream.cuts)
    misplaced = faults.GROUP if moved and late else 0
    assert -faults.FRAME < unread < faults.GROUP + stream.silent + misplaced, case
    assert len(readings) == reader.counts.groups, case
    wrong = [(r.time_s, faults.wrong(r, stream.shift_s)) for r in readings]
    return readings, [f"{case}: at {time:.3f} s {what}" for time, what in wrong if what]


def sequence(path, seed):
    """What is wrong after the random faults of a seed, and how many readings have no flag."""
    chosen = faults.random_faults(seed, faults.ALL_FAULTS)
    readings, wrong = check(codes_in(path), seed, chosen)
    return wrong, sum(not r.flags for r in readings)


def test_losses_in_any_order_are_found_by_the_time_of_their_sample():
    rng = np.random.default_rng(5)
    stream = faults.Stream(np.repeat(np.arange(4_000_000)[:, None], 2, axis=1))
    for fault in 4 * [faults.lost_tagged] + [faults.clock_set_anew, faults.lost_tagged]:
        fault(stream, rng)
    last = dict(stream.times)  # what a later loss swallowed is counted with it
    assert len(last) >= 6
    assert [item for item, _ in stream.losses] != sorted(item for item, _ in stream.losses)
    for item, seconds in last.items():
        assert stream.codes[item, 0] == round((seconds - 7.25) * faults.RATE)


@pytest.mark.parametrize(
    "fault", [None, *faults.ALL_FAULTS], ids=lambda fault: getattr(fault, "__name__", "none")
)
def test_what_one_fault_spoils_is_flagged(path, fault):
    readings, wrong = check(codes_in(path), 1, [fault] if fault else [], faults.STARTED)
    assert not wrong
    # What came before the fault is read, and what comes when it is over.
    clear = sum(not r.flags for r in readings)
    assert clear >= 16
    if fault in SHOWN_AS:
        assert SHOWN_AS[fault] <= {flag for r in readings for flag in r.flags}
    else:
        assert clear >= 30


@pytest.mark.parametrize("count", [777, 2345])
@pytest.mark.parametrize("change", ["cut", "double"])
def test_frames_are_found_again_without_restart(path, change, count):
    stream = faults.Stream(codes_in(path), shift_s=(count + faults.FRAME) / faults.RATE)
    getattr(stream, change)(19 * faults.GROUP + 98_765, count)
    readings, _ = faults.read(stream)
    assert not [r for r in readings if faults.wrong(r, stream.shift_s)]
    flagged = {round(r.time_s / 0.036 - 0.5): bool(r.flags) for r in readings}
    assert not any(flagged[g] for g in range(6, 16))
    # The group it falls into, and up to one until frames are found; the tag's clock is known.
    assert flagged[19]
    after = [r for r in readings if 21 <= round(r.time_s / 0.036 - 0.5) <= 30]
    assert [r.touch for r in after] == [1] * 10
    assert not any(r.flags for r in after)


def test_a_reference_taken_late_is_flagged_in_all_that_rests_on_it(path):
    """The tag comes up while it is pressed: its release would look like a press."""
    stream = faults.Stream(codes_in(path).copy())
    stream.codes[: 18 * faults.GROUP] = 0
    readings, _ = faults.read(stream)
    assert readings[-1].touch is not None
    assert all("inconsistent" in r.flags for r in readings if r.touch is not None)


@pytest.mark.long
@pytest.mark.timeout(7200)
def test_no_sequence_of_faults_gives_a_wrong_reading_without_a_flag(path):
    seeds = range(SEQUENCES)
    found = []
    for first in seeds[::PER_PROCESS]:
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            found += pool.map(partial(sequence, path), seeds[first : first + PER_PROCESS])
    wrong, clear = zip(*found, strict=True)
    assert not any(wrong), "\n".join(sum(wrong, []))
    assert sum(clear) > 13 * len(seeds)
