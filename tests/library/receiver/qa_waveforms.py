# SPDX-License-Identifier: GPL-3.0-or-later
"""Sounding symbols from files: captures of an independent simulator, held to their bound."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from command_runs import run_command, succeeded
from gnuradio import wiforce
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.receiver.recording_reader import RecordingReader, groups_of
from gnuradio.wiforce.signal.bound import phase_bound_deg
from second_simulator import Tag, write_vna
from waveform_captures import Air, chirp, zadoff_chu

SHORT = Air(chirp(64), duration_s=2.0)
MIDDLE = Air(zadoff_chu(128, 49), sent=3, averaged=2, frame=512, clock_hz=500, group=180)
LONG = Air(
    chirp(1024), rate_hz=5e6, sent=2, averaged=1, frame=2300, clock_hz=240, group=80, duration_s=2
)
# By the largest factor by which errors may be stated too large. What the switching of a strong tag
# within a long symbol spreads over the subcarriers would be 25 dB above the noise, and 15 dB within
# a short one.
CASES = {
    "chirp-64": (SHORT, 1.5),
    "zadoff-chu-128": (MIDDLE, 1.5),
    "chirp-1024": (LONG, 1.5),
    "strong-64": (replace(SHORT, snr_db=30.0), 1.5),
    "few-subcarriers": (replace(LONG, symbol=chirp(64), rate_hz=312.5e3, frame=144), 1.5),
    "strong": (replace(LONG, snr_db=20.0), 1.8),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Holds the calibrated model of the sensor."""
    folder = tmp_path_factory.mktemp("waveforms")
    write_vna(Tag(), folder / "finger.csv", np.random.default_rng(1))
    succeeded("calibrate", folder / "finger.csv", "-o", folder / "finger.yaml")
    return folder


def held_to_the_bound(air, folder):
    """rms phase error of the press over the bound in dB, the stated one over it, and the SNR read.

    Every reading must be unflagged.
    """
    groups = []
    capture, plan = open_capture(folder / "capture"), wiforce.plan(folder / "scene.yaml")
    batches = RecordingReader(capture, plan, on_groups=groups.append)
    readings = [reading for batch in batches for reading in batch]
    stated = np.concatenate([each.phase_std_deg for each in groups])
    time_s = np.array([reading.time_s for reading in readings])
    phases = np.array([(r.phase1_deg, r.phase2_deg) for r in readings], float)
    errors = (phases - air.truth_deg(time_s) + 180) % 360 - 180
    reference = np.array(["reference" in reading.flags for reading in readings])
    # Against the untouched sensor: the calibration's own phases carry its noise.
    errors -= errors[reference].mean(axis=0)
    start, rise, hold, *_ = air.presses[0]
    steady = (time_s > start + rise + 0.06) & (time_s < start + rise + hold - 0.06)
    assert steady.sum() >= 25 and not any(readings[i].flags for i in np.flatnonzero(steady))
    bound = phase_bound_deg(
        np.ones((2, 1)),
        np.array([air.noise_of_all]),
        [(air.clock_hz, 0.3)],
        np.arange(air.group) * air.frame / air.rate_hz,
        air.averaging_s,
        reference_groups=reference.sum(),
    )
    rms = np.sqrt(np.mean(errors[steady] ** 2))
    # The median, since groups in which the press begins or ends are uncertain by more.
    ratio = np.sqrt(np.mean(np.median(stated[steady], axis=0) ** 2)) / rms
    snr_db = np.median(np.concatenate([each.snr_db for each in groups]))
    return 10 * np.log10(np.mean((errors[steady] / bound) ** 2)), ratio, snr_db


@pytest.mark.parametrize("name", CASES)
def test_symbol_given_as_a_file_is_read_at_its_bound_and_errors_are_as_stated(name, folder):
    """A user's own symbol must read as well as the physics allows, and say how well."""
    (air, most), own = CASES[name], folder / name
    own.mkdir()
    air.write(own, "../finger.yaml")
    excess_db, ratio, snr_db = held_to_the_bound(air, own)
    assert -1.5 < excess_db < 1.5
    assert 0.9 < ratio < most
    assert abs(snr_db - air.snr_db) < 1


def test_long_symbols_in_batches_of_any_size_give_equal_readings(folder):
    """Spread lines and their noise follow the groups, whether these come singly or not."""
    air, own = replace(LONG, snr_db=20.0, duration_s=1.2), folder / "batches"
    own.mkdir()
    air.write(own, "../finger.yaml")
    plan = wiforce.plan(own / "scene.yaml")
    source = groups_of(open_capture(own / "capture"), plan, 0)
    groups = Groups.concatenate(source.read() for _ in range(4))  # of 16 each, and none at the end

    def values(size):
        receiver, count = Receiver(plan), len(groups)
        parts = [receiver.process(groups[i : i + size]) for i in range(0, count, size)]
        readings = [r for part in [*parts, receiver.finish()] for r in part]
        return np.array([(r.phase1_deg, r.phase2_deg, r.snr_db) for r in readings], float)

    assert len(groups) >= 30
    np.testing.assert_allclose(values(1), values(len(groups)), rtol=1e-8)


def test_capture_is_read_elsewhere_without_the_file_of_its_symbol(tmp_path):
    """The symbol is part of the metadata: a capture that needs a lost file is lost as well."""
    np.save(tmp_path / "own.npy", chirp(48))
    scene = {
        "radio": {"sample_rate_hz": 1.25e6},
        "sounding": {"waveform": "own.npy", "frame_length": 300},
        "sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 400}],
        "simulation": {"duration_s": 0.4},
        "phase_group": {"snapshots": 150},
        "reference_s": 0.1,
    }
    (tmp_path / "scene.yaml").write_text(json.dumps(scene))
    succeeded("simulate", tmp_path / "scene.yaml", tmp_path / "run")
    here = run_command("read", tmp_path / "run")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for suffix in (".sigmf-data", ".sigmf-meta"):
        shutil.move(tmp_path / f"run{suffix}", elsewhere)
    there = run_command("read", elsewhere / "run")
    assert here.returncode == there.returncode == 0, here.stderr + there.stderr
    assert there.stdout == here.stdout and here.stdout.count("\n") > 5


def test_subcarriers_without_energy_are_not_used(tmp_path):
    """Noise divided by nothing would drown the rest."""
    spectrum = np.zeros(64, complex)
    spectrum[[3, 4, 5, 60]] = 1, 1j, -1, 0.11
    spectrum[[0, 6, 32]] = 1, 0.09, 1
    np.save(tmp_path / "own.npy", np.fft.ifft(spectrum))
    waveform = wiforce.sounding_waveform(str(tmp_path / "own.npy"))
    assert waveform.subcarriers.tolist() == [-4, 3, 4, 5]
    used = np.sum(np.abs(spectrum[[3, 4, 5, 60]]) ** 2) / np.sum(np.abs(spectrum) ** 2)
    assert waveform.used_share == pytest.approx(used)
    channel = np.fft.fft(waveform.symbol) * waveform.equalizer()
    np.testing.assert_allclose(channel[waveform.bins], 1)


@pytest.mark.parametrize("name", ["chirp", "fmcw", "zadoff-chu"])
def test_shipped_symbols_are_their_formulas(name):
    length = 63 if name == "zadoff-chu" else 128
    n = np.arange(length)
    expected = {
        "chirp": np.exp(2j * np.pi * (n**2 / 256 - n / 2)),
        "fmcw": np.exp(0.8j * np.pi * (n**2 / 128 - n)),
        "zadoff-chu": np.exp(-25j * np.pi * n * (n + 1) / 63),
    }[name]
    waveform = wiforce.sounding_waveform(name)
    np.testing.assert_allclose(waveform.symbol, expected, atol=1e-9)
    assert waveform.preamble_length == 5 * length and waveform.repetitions == 4
    # Constant envelope at the samples; a swept frequency stays in its band.
    assert np.allclose(np.abs(waveform.symbol), 1)
    steps = np.angle(waveform.symbol[1:] * waveform.symbol[:-1].conj()) / (2 * np.pi)
    if name == "fmcw":
        assert np.all(np.abs(steps) <= 0.4) and np.all(np.diff(steps) > 0)
