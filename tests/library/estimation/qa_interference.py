# SPDX-License-Identifier: GPL-3.0-or-later
"""Interference: snapshots that other transmitters hit are left out, and no others."""

import copy
import shutil
from functools import lru_cache

import numpy as np
import pytest
from chain_runs import assert_equal_readings, readings_of_reader
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver import recording_reader
from gnuradio.wiforce.receiver.recording_reader import RecordingReader
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.signal.carrier import wrap_deg
from gnuradio.wiforce.simulation.simulator import simulate
from press_capture import DEFAULT, codes_of, source_of
from rooms.effects import Air
from rooms.radio import Bursts, Hopper

FRAME = 720


def scene_of(clocks=(1000,), waveform="repeated", snapshots=625, **simulation):
    described = copy.deepcopy(DEFAULT)
    described["sensors"] = [
        {"name": f"arm{n}", "model": "line-900mhz", "clock_hz": hz} for n, hz in enumerate(clocks)
    ]
    described["sounding"] = {"waveform": waveform}
    described["phase_group"] = {"snapshots": snapshots}
    press = described["simulation"]["presses"][0] | {"sensor": "arm0"}
    described["simulation"].update(presses=[press], **simulation)
    return load_scene(described)


def captured(scene, name):
    """Write a scene's capture; its codes."""
    simulate(scene, name)
    return codes_of(name)


def copy_with(codes, source, name):
    """A capture like another one, of other samples."""
    codes.astype("<i2").tofile(f"{name}.sigmf-data")
    shutil.copy(f"{source}.sigmf-meta", f"{name}.sigmf-meta")
    return name


def noise_power(codes):
    """Per sample, by the guards."""
    frames = codes[: len(codes) // FRAME * FRAME].reshape(-1, FRAME, 2)
    return 2 * np.mean(frames[:, 450:].astype(float) ** 2)


def with_transmissions(codes, effect):
    """Codes to which another transmitter of ``rooms`` is added."""
    whole = codes[: len(codes) // FRAME * FRAME].astype(np.float32)
    frames = whole.view(np.complex64).reshape(-1, FRAME)
    air = Air(None, np.sqrt(noise_power(codes)), None, len(frames))
    effect.begin(air, np.random.default_rng(3))
    effect.add(frames, 0)
    return np.clip(np.rint(whole), -32768, 32767)


def groups_of(scene, name):
    """All groups of tones of a recording."""
    reader = RecordingReader(open_capture(name), plan(scene))
    source = recording_reader.groups_of(reader.recording, reader.plan, reader.frame_offset)
    batches = []
    while len(batch := source.read()):
        batches.append(batch)
    return Groups.concatenate(batches)


@pytest.mark.parametrize("settings", [{"clocks": (2000,)}, {"waveform": "wifi"}], ids=str)
def test_screen_quiet_capture_rejects_no_snapshot(settings, tmp_path):
    """Edges of a tag differ from the rest of a frame as well; they are not to cost anything."""
    scene = scene_of(**{"snr_db": 30, "duration_s": 0.54} | settings)
    captured(scene, tmp_path / "quiet")
    groups = groups_of(scene, tmp_path / "quiet")
    assert len(groups) >= 14
    assert not groups.interference.any() and groups.snapshot_weights is None


@pytest.fixture(scope="module")
def press(tmp_path_factory):
    """Name, scene and codes of a capture of a press."""
    name = tmp_path_factory.mktemp("interference") / "press"
    scene = scene_of(snapshots=125)
    return name, scene, captured(scene, name)


def phase_errors(scene, readings):
    """In degrees, of both ends, while the press is held."""
    model = scene.load_model("line-900mhz")
    truth = model.phases_deg(4.0, 37.0)
    held = [r for r in readings if 0.54 < r.time_s < 0.8 and r.touch == 1]
    assert len(held) > 30
    return wrap_deg(np.array([(r.phase1_deg, r.phase2_deg) for r in held]) - truth)


@lru_cache
def read(scene, name):
    """Readings of a capture that does not change."""
    return [r for batch in RecordingReader(open_capture(name), plan(scene)) for r in batch]


def rms(errors):
    return np.sqrt(np.mean(errors**2))


def hit_by(effect, press, tmp_path_factory):
    """The capture with another transmitter of ``rooms``."""
    (name, _, codes), folder = press, tmp_path_factory.mktemp("interference")
    return copy_with(with_transmissions(codes, effect), name, folder / "hit")


@pytest.fixture(scope="module")
def bursty(press, tmp_path_factory):
    """The capture with bursts 25 dB above the noise for 20 % of the time."""
    return hit_by(Bursts(0.2, 25), press, tmp_path_factory)


def test_read_with_bursts_stays_at_the_bound(press, bursty):
    """Without rejection, Wi-Fi nearby multiplies the errors; nothing but what it hits is lost."""
    name, scene, _ = press
    clean, readings = rms(phase_errors(scene, read(scene, name))), read(scene, bursty)
    free = 1 - np.mean([reading.interference for reading in readings])
    assert 0.7 < free < 0.85
    assert rms(phase_errors(scene, readings)) < 1.15 * clean / np.sqrt(free)
    assert not any("gap" in reading.flags for reading in readings)


def test_read_groups_hit_as_a_whole_have_no_values_and_are_flagged(press, tmp_path):
    name, scene, codes = press
    hit, group = codes.astype(float), 125 * FRAME
    part = hit[90 * group : 95 * group]
    part += np.random.default_rng(5).normal(0, 20 * np.sqrt(noise_power(codes)), part.shape)
    copy_with(np.clip(np.rint(hit), -32768, 32767), name, tmp_path / "hit")
    readings = read(scene, tmp_path / "hit")
    for reading in readings[90:95]:
        assert reading.flags == ("gap",) and reading.interference == 1
        assert reading.touch is None and reading.phase1_deg is None
    assert all(r.interference < 0.02 for r in readings[:90] + readings[95:])


@pytest.fixture(scope="module")
def hopped(press, tmp_path_factory):
    """The capture with a narrow-band transmitter 30 dB above the noise."""
    return hit_by(Hopper(0.5, 30), press, tmp_path_factory)


def test_read_with_hopper_loses_subcarriers_and_no_groups(press, hopped):
    """Groups are shorter than its transmissions: without their snapshots nothing would be left."""
    name, scene, _ = press
    clean = rms(phase_errors(scene, read(scene, name)))
    readings = read(scene, hopped)
    assert not any("gap" in r.flags for r in readings)
    errors = phase_errors(scene, readings)
    assert rms(errors) < 1.35 * clean
    # A transmitter on 8 of 62 subcarriers costs a fifth of the information at most.
    shares = np.array([r.interference for r in readings])
    assert 0.05 < np.mean(shares) < 0.2 and np.quantile(shares, 0.9) < 0.35
    stated = np.array([r.force_std_n for r in readings if 0.54 < r.time_s < 0.8])
    quiet = np.array([r.force_std_n for r in read(scene, name) if 0.54 < r.time_s < 0.8])
    assert np.median(stated) < 1.5 * np.median(quiet)


@pytest.mark.parametrize(
    ("input_type", "interference"),
    [("sc16", "bursty"), ("folded", "bursty"), ("fc32", "hopped")],
)
def test_stream_with_interference_is_read_as_the_recording(
    press, request, input_type, interference
):
    """Live readings must be as good as those of a recording of the same signal."""
    _, scene, _ = press
    hit = request.getfixturevalue(interference)
    source = source_of(hit, scene, input_type)
    found = readings_of_reader(scene, source, input_type=input_type)
    # A stream without reported gaps ends with its last whole group, as a recording does.
    assert_equal_readings(found, read(scene, hit))
