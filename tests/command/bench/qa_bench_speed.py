# SPDX-License-Identifier: GPL-3.0-or-later
"""Benchmarks of time: chains held to double precision, and what is printed."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command_runs import run_command
from gnuradio.wiforce.planning.plan import plan
from wiforce_app.bench import inversion, read
from wiforce_app.bench.chains import CHAINS, reference_tones, tone_weights, write_recording
from wiforce_app.bench.live import delays_s
from wiforce_app.bench.speed import check_tones


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return write_recording(tmp_path_factory.mktemp("recording"), 2_000_000)


@pytest.mark.parametrize("name", [n for n in CHAINS if not n.startswith("ceiling")])
def test_every_chain_gives_the_tones_of_the_plain_reference(recording, name):
    weights = tone_weights(4)
    made = CHAINS[name](recording, weights)
    made.run()
    reference = reference_tones(recording, weights)
    check_tones(name, made.tones, reference)


@pytest.mark.parametrize("name", ["file-fc32", "file-sc16"])
def test_files_with_bursts_give_the_tones_without_the_frames_hit(tmp_path, name):
    """A row of bursts that nothing rejects would be as fast as a quiet one."""
    recording, weights = write_recording(tmp_path, 2_000_000, bursts=True), tone_weights(4)
    made = CHAINS[name](recording, weights)
    made.run()
    reference = reference_tones(recording, weights)
    check_tones(name, made.tones, reference)
    with pytest.raises(ValueError, match="off"):
        check_tones(name, made.tones, reference_tones(replace(recording, bursts=False), weights))


def test_tones_that_are_off_are_refused(recording):
    reference = reference_tones(recording, tone_weights(4))
    wrong = reference.copy()
    wrong[1, 2, 3] += 2e-5 * np.abs(reference).max()
    with pytest.raises(ValueError, match="off"):
        check_tones("row", wrong, reference)
    with pytest.raises(ValueError, match="2 groups instead of 4"):
        check_tones("row", reference[:2], reference)
    with pytest.raises(ValueError, match="off"):
        check_tones("row", np.full_like(reference, np.nan), reference)


def test_bench_inversion_of_one_sensor_gives_a_row_per_noise(monkeypatch, long_run):
    if not long_run:
        shorter = {"_BATCH": 4000, "_SINGLE": 100, "_RUNS": 2}
        for name, value in shorter.items():
            monkeypatch.setattr(inversion, name, value)
    done = run_command("bench", "inversion", "--json", "--sensor", "wiforce-900mhz")
    assert (done.returncode, done.stderr) == (0, "")
    rows = json.loads(done.stdout)["rows"]
    assert [row["noise_deg"] for row in rows] == [0.2, 1.0]
    for row in rows:
        assert row["sensor"] == "wiforce-900mhz" and row["carrier_mhz"] == 900
        assert row["batch_us"] > 0 and row["single_us"] > 0
        assert row["within_2_std"] > 0.9 and 0 < row["flagged"] < 1
        assert row["beyond_3_std"] < 0.01


def test_delays_are_counted_from_when_the_device_sent_the_sample():
    """A device that is late, or sends in bursts, must not count as a delay of the reader."""
    sent = [(5.00, 100.0), (5.01, 100.2), (5.02, 100.21), (5.03, 100.5)]
    readings = [(100.25, 5.005), (100.30, 5.015), (100.30, 4.9), (101.0, 5.03)]
    assert delays_s(readings, sent, 0.005) == pytest.approx([0.05, 0.09])
    assert delays_s(readings, sent, 0.006) == pytest.approx([0.04, -0.2])


@pytest.mark.parametrize("sensors", read.SENSORS)
def test_pieces_of_recordings_are_repeated_without_a_break(sensors):
    """A row that is refused after minutes of measuring would cost the whole run."""
    settings = plan(read.scene_of(sensors, 625))
    assert len(settings.clocks) == sensors and settings.group_length == 625
    # Whole periods, frames and groups in the piece.
    assert all((read.PIECE_S * hz) % 1 == pytest.approx(0, abs=1e-6) for hz in settings.clocks_hz)
    assert all(read.PIECE_SAMPLES % (720 * n) == 0 for n in (125, 625))
