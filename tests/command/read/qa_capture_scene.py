# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture is read with the right scene, and only when its samples agree with it."""

import warnings

import numpy as np
import pytest
import yaml
from command_runs import refused, succeeded
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.capture import Capture, Segment, open_capture
from gnuradio.wiforce.receiver.recording_reader import RecordingReader
from gnuradio.wiforce.scene import load_scene, scene_of
from gnuradio.wiforce.sensor import load_sensor, write_sensor
from long_cases import cases

# Frames of 320 samples at 1.25 Msps: a second of it is small and quickly read.
SCENE = {
    "radio": {"sample_rate_hz": 1.25e6},
    "sounding": {"frame_length": 320},
    "phase_group": {"snapshots": 125},
    "sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 400}],
    "reference_s": 0.4,
    "simulation": {"duration_s": 1.2, "seed": 2, "snr_db": 15, "static_clutter_db": 50},
}


def changed(section, **values):
    scene = {key: dict(value) if isinstance(value, dict) else value for key, value in SCENE.items()}
    scene[section] = scene.get(section, {}) | values
    return scene


@pytest.fixture(scope="module")
def press(tmp_path_factory):
    """Stem of a capture."""
    stem = tmp_path_factory.mktemp("capture") / "press"
    wiforce.simulate(load_scene(SCENE), stem)
    return stem


def written(folder, scene):
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(scene))
    return path


def test_read_finds_sensors_of_a_scene_in_another_folder(tmp_path, monkeypatch):
    """Names of sensor files are relative to the scene, but the capture holds a copy of it."""
    for folder in ("scenes/sensors", "captures"):
        (tmp_path / folder).mkdir(parents=True)
    write_sensor(load_sensor("line-900mhz"), tmp_path / "scenes/sensors/own.yaml")
    sensors = [SCENE["sensors"][0] | {"model": "sensors/own.yaml"}]
    scene = changed("simulation", truth_model="sensors/own.yaml", duration_s=0.6)
    (tmp_path / "scenes/own.yaml").write_text(yaml.safe_dump(scene | {"sensors": sensors}))
    monkeypatch.chdir(tmp_path)
    wiforce.simulate("scenes/own.yaml", "captures/first")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    held = scene_of(open_capture("../captures/first"))[0]
    assert {path.resolve() for path in held.files if path.suffix == ".yaml"} == {
        tmp_path / "scenes/sensors/own.yaml"
    }
    assert wiforce.read("../captures/first")["ok"].sum() >= 8


def test_read_scene_that_differs_warns_of_each_key(press, tmp_path):
    """A scene of another experiment would give wrong readings without a word."""
    scene = changed("phase_group", snapshots=250)
    off = {"off_reflection": [0.1, 0.0], "clock_tolerance_ppm": 50}
    scene["sensors"] = [SCENE["sensors"][0] | off]
    scene["simulation"] = {"duration_s": 2.0}
    scene_file = written(tmp_path, scene)
    done = succeeded("read", press, "--scene", scene_file, "-o", tmp_path / "out.csv")
    data = press.with_suffix(".sigmf-data")
    start = f"gr-wiforce: warning: {data}: "
    assert [line.removeprefix(start) for line in done.stderr.splitlines()[:-1]] == [
        "phase_group.snapshots is 125 in the capture's own scene, 250 in the scene given",
        "sensors[arm].clock_tolerance_ppm is 100 in the capture's own scene, 50 in the scene given",
        "sensors[arm].off_reflection is [0, 0] in the capture's own scene, "
        "[0.1, 0] in the scene given",
    ]
    with pytest.warns(UserWarning, match="phase_group.snapshots is 125") as caught:
        wiforce.read(press, scene)
    assert len(caught) == 3


def test_read_with_another_symbol_warns_in_a_readable_line(tmp_path):
    """The samples of a symbol as text filled the terminal."""
    n = np.arange(64)
    np.save(tmp_path / "up.npy", np.exp(1j * np.pi * n**2 / 64))
    scene = changed("sounding", waveform="up.npy")
    path = written(tmp_path, scene)
    wiforce.simulate(load_scene(path), tmp_path / "press")
    capture = open_capture(tmp_path / "press")
    assert scene_of(capture, path)[1] == []
    named = written(tmp_path, changed("sounding", waveform="chirp", symbol_length=64))
    lines = scene_of(capture, named)[1]
    assert [line.split(" is ")[0] for line in lines] == [
        "sounding.waveform",
        "sounding.symbol_length",
    ]
    np.save(tmp_path / "up.npy", np.exp(-1j * np.pi * n**2 / 64))
    assert scene_of(capture, written(tmp_path, scene))[1] == [
        "sounding.symbol: up.npy holds another symbol than in the capture's own scene"
    ]


def test_scene_of_capture_is_its_own_unless_another_is_given_that_is_compared(press):
    """A capture whose own scene is broken must be readable with a good one."""
    capture = open_capture(press)
    own, differences = scene_of(capture)
    assert own.sounding.frame_length == 320 and differences == []
    again, differences = scene_of(capture, SCENE)
    assert again.sensors == own.sensors and differences == []
    scene = {**SCENE, "sensors": [{**SCENE["sensors"][0], "name": "leg"}]}
    # Each key of both sensors was named as well.
    assert scene_of(capture, scene)[1] == [
        "sensors is [arm] in the capture's own scene, [leg] in the scene given"
    ]
    broken = Capture(capture.path, "ci16_le", None, None, capture.segments, {"sensors": 3})
    (difference,) = scene_of(broken, scene)[1]
    assert difference.startswith("the capture's own scene cannot be compared")
    with pytest.raises(InputError, match="wiforce:scene"):
        scene_of(broken)


def test_read_wrong_frame_offset_warns_where_frames_begin(tmp_path):
    """Frames cut at the wrong places gave wrong readings, or none, without a word."""
    scene = changed("sounding", frame_length=400)
    scene["sensors"] = [{**SCENE["sensors"][0], "clock_hz": 320}]
    wiforce.simulate(load_scene(scene), tmp_path / "press")
    offset = "--frame-offset", 130
    done = succeeded("read", tmp_path / "press", *offset, "-o", tmp_path / "out.csv")
    warning, *_, last = done.stderr.splitlines()
    assert (
        "press.sigmf-data: frames begin at sample 2 and every 400 from there, not at sample 130; "
        "set the frame offset"
    ) in warning
    assert last.startswith("gr-wiforce: read ")
    with pytest.warns(UserWarning, match="begin at sample 2 and every 400 from there, not at "):
        wiforce.read(tmp_path / "press", frame_offset=130)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wiforce.read(tmp_path / "press", frame_offset=800)


def test_read_more_repetitions_than_are_sent_warns_of_the_symbols(tmp_path):
    """What is received behind a preamble was averaged with it: forces were 3 % too large."""
    wiforce.simulate(load_scene(changed("sounding", repetitions=3)), tmp_path / "press")
    scene = changed("sounding", repetitions=5)
    with pytest.warns(UserWarning) as caught:
        wiforce.read(tmp_path / "press.sigmf-data", scene)
    (warning,) = [str(each.message) for each in caught if "preambles" in str(each.message)]
    assert "press.sigmf-data: preambles hold 3 symbols, but sounding.repetitions is 5" in warning
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wiforce.read(tmp_path / "press")


def test_read_half_frame_length_is_refused_by_command_and_function(tmp_path):
    """Half the true length reads a preamble in every second frame only."""
    scene = changed("sounding", frame_length=640)
    scene["sensors"] = [{**SCENE["sensors"][0], "clock_hz": 200}]
    wiforce.simulate(load_scene(scene), tmp_path / "long")
    rule = "long.sigmf-data: frames repeat every 640 samples, but sounding.frame_length is 320"
    half = changed("sounding", frame_length=320)
    half["sensors"] = scene["sensors"]
    assert rule in refused("read", tmp_path / "long", "--scene", written(tmp_path, half))
    with pytest.raises(InputError, match=rule):
        wiforce.read(tmp_path / "long", half)
    # The frames' place may be stated, but not their length.
    with pytest.raises(InputError, match=rule):
        wiforce.read(tmp_path / "long", half, frame_offset=0)


def test_read_faint_tag_is_read(tmp_path):
    """A weak or absent tag in front of static paths gives flagged readings, not a refusal."""
    faint = changed("simulation", snr_db=-45, static_clutter_db=45)
    wiforce.simulate(load_scene(faint), tmp_path / "faint")
    assert (wiforce.read(tmp_path / "faint")["flags"] != "").all()


@pytest.mark.parametrize("content", cases("noise", long=("silence", "floats")))
def test_read_without_frames_is_refused_with_a_hint(press, tmp_path, content):
    """A wrong datatype, rate or file gave an empty table and exit status 0."""
    rng, count = np.random.default_rng(1), 400_000
    samples = {
        "noise": (1000 * rng.standard_normal(2 * count)).astype("<i2"),
        "silence": np.zeros(2 * count, "<i2"),
        "floats": open_capture(press).read(count),
    }[content]
    samples.tofile(tmp_path / "raw.bin")
    output, scene = tmp_path / "out.csv", written(tmp_path, SCENE)
    arguments = tmp_path / "raw.bin", "--datatype", "ci16_le", "--scene", scene, "-o", output
    line = refused("read", *arguments)
    assert (
        "raw.bin: no sounding frames found (waveform 'repeated', 320 samples per frame at "
        "1.25 Msps); check the datatype (ci16_le), radio.sample_rate_hz and sounding.frame_length"
    ) in line and not output.exists()


def test_read_integers_as_floats_are_refused(press):
    """NumPy's warnings would hide the reason."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match="no sounding frames found"):
            wiforce.read(press.with_suffix(".sigmf-data"), SCENE, datatype="cf32_le")


@pytest.mark.parametrize("noise", [0, 3], ids=["zeros", "noise"])
def test_read_begins_with_the_first_frame_that_was_received(press, tmp_path, noise):
    """Recorders are often started before the transmitter: what came before was the reference."""
    before = 700_155  # .56 s, longer than the reference
    silence = noise * np.random.default_rng(1).standard_normal(2 * before)
    codes = np.fromfile(press.with_suffix(".sigmf-data"), "<i2")
    np.concatenate([silence.astype("<i2"), codes]).tofile(tmp_path / "late.bin")
    reader = RecordingReader(open_capture(tmp_path / "late.bin", "ci16_le"), wiforce.plan(SCENE))
    # Without a guard frames begin with any of their symbols.
    assert (reader.frame_offset + 8 - before) % 64 <= 8
    assert abs(reader.frame_offset - before) <= 320
    late = wiforce.read(tmp_path / "late.bin", SCENE, datatype="ci16_le")
    whole = wiforce.read(press)[: len(late)]
    assert late["flags"].tolist() == whole["flags"].tolist()
    # Other samples of the same frames: by less than the noise.
    assert late["phase1_deg"].tolist() == pytest.approx(whole["phase1_deg"].tolist(), abs=0.2)


@pytest.mark.parametrize("stated", [True, False])
def test_read_times_count_from_the_first_sample_before_the_frames(press, tmp_path, stated):
    """A press was read as early as the recorder was started before the transmitter."""
    before = 40_123 if stated else 123
    codes = np.fromfile(press.with_suffix(".sigmf-data"), "<i2")
    np.concatenate([np.zeros(2 * before, "<i2"), codes]).tofile(tmp_path / "late.bin")
    options = {"datatype": "ci16_le"} | ({"frame_offset": before} if stated else {})
    capture = open_capture(tmp_path / "late.bin", "ci16_le")
    offset = before if stated else RecordingReader(capture, wiforce.plan(SCENE)).frame_offset
    assert offset > 0
    readings = wiforce.read(tmp_path / "late.bin", SCENE, **options)
    start_s = offset / 1.25e6
    assert readings["time_s"].tolist() == pytest.approx(0.032 * (readings["group"] + 0.5) + start_s)


def test_read_span_keeps_samples_at_their_time_across_gaps(tmp_path):
    """Frames would seem to move at every gap."""
    np.arange(1, 11, dtype=np.complex64).tofile(tmp_path / "gaps.bin")
    segments = Segment(0, 7, 3), Segment(3, 12, 4), Segment(7, 16, 3)
    capture = Capture(tmp_path / "gaps.bin", "cf32_le", None, None, segments)
    whole = [1, 2, 3, 0, 0, 4, 5, 6, 7, 8, 9, 10]
    assert capture.read_span(0, 100).real.tolist() == whole
    assert capture.read_span(4, 3).real.tolist() == whole[4:7]
    assert capture.read_span(12, 3).tolist() == []


def test_read_tail_that_is_not_finite_counts_as_dropped(press, tmp_path):
    """Groups would be missing at the end of the table without being counted."""
    samples = open_capture(press).read(10**7)
    samples[20 * 40_000 :] = np.nan
    samples.tofile(tmp_path / "tail.cf32")
    scene = written(tmp_path, SCENE)
    done = succeeded("read", tmp_path / "tail.cf32", "--datatype", "cf32_le", "--scene", scene)
    assert "read 37 groups" in done.stderr and "17 lost" in done.stderr, done.stderr
    rows = done.stdout.splitlines()[1:]
    assert len(rows) == 37 and all(row.split(",")[-3] == "gap" for row in rows[20:])
