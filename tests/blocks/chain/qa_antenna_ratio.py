# SPDX-License-Identifier: GPL-3.0-or-later
"""Two receive antennas: their ratio is read where one antenna on a clock of its own is not."""

import json
import os
import shutil
from functools import lru_cache
from pathlib import Path

import numpy as np
import pmt
import pytest
from command_runs import run_command, succeeded
from device_times import tag_at
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.capture.names import second_antenna
from gnuradio.wiforce.receiver.recording_reader import groups_of
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.signal.carrier import wrap_deg
from gnuradio.wiforce.signal.waveform import sounding_waveform
from gnuradio.wiforce.simulation.simulator import simulate
from press_capture import SLOW, Run, array_source, codes_of
from wiforce_app.read.recordings import read_capture

SCENE = SLOW | {
    "sensors": [{"name": "arm", "model": "line-900mhz-calibrated", "clock_hz": 670}],
    "environment": {"reader_clock": "free", "receive_antennas": 2},
    "reference_s": 0.3,
    "simulation": {
        "truth_model": "line-900mhz",
        "duration_s": 0.9,
        "seed": 5,
        "snr_db": 15,
        "static_clutter_db": 65,
        "carrier_offset_hz": 800,
        "phase_noise_hz": 5,
        "presses": [{"start_s": 0.45, "rise_s": 0, "hold_s": 9, "force_n": 4, "location_mm": 33}],
    },
}


def test_antenna_ratio_block_gives_folded_vectors_of_the_ratio():
    waveform, rng = sounding_waveform(), np.random.default_rng(2)
    folded = (rng.standard_normal((2, 30, 64)) + 1j * rng.standard_normal((2, 30, 64))).astype("c8")
    found = Run(tuple(map(array_source, folded)), wiforce.antenna_ratio())
    got = np.fft.fft(found.items) * waveform.equalizer()
    wanted = np.divide(*np.fft.fft(folded)[:, :, waveform.bins])
    np.testing.assert_allclose(got[:, waveform.bins], wanted, rtol=1e-4, atol=1e-4)
    assert np.abs(got[:, 0]).max() < 1e-5


def ratio_noise_of(ratio, *tags):
    """Noise tags of the ratio of 20 vectors to themselves, with these tags."""
    source = array_source(np.ones((20, 64), np.complex64), tags)
    return np.concatenate([*Run((source, source), ratio).tags["noise"].values()])


@pytest.mark.parametrize(
    "value", [pmt.from_double(1.0), pmt.init_f32vector(1, [1.0])], ids=["number", "half a pair"]
)
def test_antenna_ratio_tag_noise_of_another_type_is_ignored(value):
    """The flowgraph hung, as it does after any exception in a block."""
    noise = ratio_noise_of(wiforce.antenna_ratio(), tag_at(3, "noise", value))
    assert noise.tolist() == [0] * 40


def test_antenna_ratio_started_again_forgets_the_noise_of_before():
    ratio, known = wiforce.antenna_ratio(), pmt.init_f32vector(40, [1.0] * 40)
    assert ratio_noise_of(ratio, tag_at(0, "noise", known)).all()
    assert not ratio_noise_of(ratio).any()


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """Two antennas' captures of a press, with carrier offset and phase noise."""
    name, scene = tmp_path_factory.mktemp("two") / "press", load_scene(SCENE)
    simulate(scene, name)
    return name, scene


@lru_cache
def readings(name, scene):
    """Readings of a touch; captures do not change."""
    return [r for r in read_capture(open_capture(name), scene) if r.time_s > 0.5]


def test_antenna_ratio_with_carrier_offset_and_phase_noise_is_read(captures):
    name, scene = captures
    truth = scene.load_model("line-900mhz")
    known = scene.load_model("line-900mhz-calibrated")
    bias = np.subtract(known.untouched_deg(), truth.untouched_deg())
    found = readings(name, scene)
    # The carrier offset makes repetitions differ far more than noise does, in every frame.
    assert all(r.interference == 0 for r in found)
    phases = np.array([[r.phase1_deg, r.phase2_deg] for r in found])
    errors = wrap_deg(phases - truth.phases_deg(4.0, 33.0) - bias)
    # not quite linear in the tag: up to 2 |T|/|S| = 0.29 deg, and noise of 0.1 deg
    assert len(found) >= 8 and np.abs(np.median(errors, axis=0)).max() < 0.35
    assert np.abs([r.location_mm - 33 for r in found]).max() < 0.3


def test_antenna_ratio_partial_last_group_is_not_read(captures):
    scene = load_scene({**SCENE, "phase_group": {"snapshots": 244}})  # 25.6 groups
    found = readings(captures[0], scene)
    assert found[-1].time_s == pytest.approx(24.5 * scene.group_period_s)
    assert "gap" not in found[-1].flags


@pytest.fixture
def loud(captures, tmp_path):
    """The captures, whose second antenna clips in group 4 and the first one as well in group 6."""
    name, scene = captures
    codes = [codes_of(name), codes_of(second_antenna(name))]
    frame, group = scene.sounding.frame_length, 250 * scene.sounding.frame_length
    codes[1][4 * group + 100 : 5 * group : frame] = 32767
    codes[1][6 * group + 100 : 6 * group + 5 * frame : frame] = 32767
    codes[0][6 * group + 3 * frame + 100 : 7 * group : frame] = 32767
    loud = tmp_path / "x"
    for antenna, of in zip(codes, (str, second_antenna), strict=True):
        antenna.tofile(f"{of(loud)}.sigmf-data")
        shutil.copy(f"{of(name)}.sigmf-meta", f"{of(loud)}.sigmf-meta")
    return loud, scene


def test_saturation_of_either_antenna_flags_its_group_in_recordings(loud):
    """Only the first antenna counted: clipped samples of the second were read without a flag."""
    name, scene = loud
    groups = groups_of(open_capture(name), wiforce.plan(scene), 0).read()
    assert np.flatnonzero(groups.saturated).tolist() == [4, 6]


def test_saturation_of_either_antenna_is_tagged_once_per_snapshot(loud):
    name, scene = loud
    sources = (wiforce.capture_source(each, scene) for each in (name, second_antenna(name)))
    tagged = Run(tuple(sources), wiforce.antenna_ratio(scene)).tags["saturated"]
    assert sorted(tagged) == [*range(1000, 1250), *range(1500, 1750)]


def test_retuning_of_two_antennas_marks_its_group(loud):
    """The new phases of a device opened again, in a recording of it, were read as a press."""
    name, scene = loud
    for of in (str, second_antenna):
        meta = Path(f"{of(name)}.sigmf-meta")
        content = json.loads(meta.read_text())
        start = 5 * 250 * scene.sounding.frame_length + 77
        content["captures"].append({"core:sample_start": start, "wiforce:retuned": True})
        meta.write_text(json.dumps(content))
    groups = groups_of(open_capture(name), wiforce.plan(scene), 0).read()
    assert np.flatnonzero(groups.retuned).tolist() == [5]


def test_single_antenna_with_free_clock_reads_nothing(captures):
    alone = load_scene({**SCENE, "environment": {"reader_clock": "free"}})
    assert all(r.force_n is None or r.flags for r in readings(captures[0], alone))


def test_single_antenna_with_free_clock_is_named_as_the_cause(captures, tmp_path):
    """A user would look for the fault in datatype, clock and levels."""
    scene = {**SCENE, "environment": {"reader_clock": "free"}}
    (tmp_path / "alone.yaml").write_text(json.dumps(scene))
    for command in ("read", "check"):
        done = succeeded(command, captures[0], "--scene", tmp_path / "alone.yaml")
        said = done.stderr + done.stdout
        assert "reader_clock free: with one receive antenna" in said
        assert "check the datatype" not in said and "no tag detected" not in said


def test_survey_of_two_antennas_states_how_strong_the_tag_is(captures):
    done = run_command("survey", captures[0])
    assert "the ratio of two antennas is not linear (tag against static path: -51 dB)" in (
        done.stdout
    )


def test_reader_samples_of_one_antenna_are_refused_for_two():
    with pytest.raises(InputError, match="environment.receive_antennas: must be 1 where samples"):
        wiforce.reader(SCENE, input_type="sc16")


def test_shorter_file_of_one_antenna_is_reported(captures, tmp_path):
    """Its groups were dropped without a word about the file."""
    first, copied = captures[0], tmp_path / "short"
    for name, copy in ((first, copied), (second_antenna(first), second_antenna(copied))):
        for suffix in (".sigmf-data", ".sigmf-meta"):
            shutil.copy(f"{name}{suffix}", f"{copy}{suffix}")
    path = second_antenna(copied) + ".sigmf-data"
    os.truncate(path, os.path.getsize(path) - 4 * 125_000)
    done = succeeded("read", copied)
    assert f"{path}: ends 125000 samples" in done.stderr and "before" in done.stderr
    assert "groups that lack one antenna cannot be read" in done.stderr
