# SPDX-License-Identifier: GPL-3.0-or-later
"""`gr-wiforce check FILE` of any file: what it is, whether it is whole, whether a tag is seen."""

import json

import numpy as np
import pytest
import yaml
from command_runs import refused, run_command
from gnuradio import wiforce
from gnuradio.wiforce.planning.advice import outside_band
from packet_simulator import PacketCapture, PacketTag
from wiforce_app.plan.check_file import check_file


def checked(path, datatype=None):
    """What the command finds, and what it shows of it."""
    return check_file(path, None, datatype, None)


def snapshots(folder, line_db=30, snr_db=30.0, **more):
    static = 0.225 * 10 ** (line_db / 20)
    settings = {"seed": 4, "subcarriers": 16, "duration_s": 3.0, "gain_db": (0.0, 0.5)}
    tag = PacketTag(more.pop("clock_hz", 134.0), offset_ppm=0.0)
    noise = static * 10 ** (-snr_db / 20)
    PacketCapture([tag], static=static, noise=noise, **(settings | more)).save(folder / "a.npz")
    return folder / "a.npz"


def test_snapshots_with_a_tag_say_how_strong_it_is_and_what_error_it_allows(tmp_path):
    found, text = checked(snapshots(tmp_path, flip_s=0.4, touched_s=(9.0, 9.0)))
    assert found["file"]["packets"] > 2500 and found["antennas"]["count"] == 2
    assert found["tag"]["clock_hz"] == pytest.approx(134.0, abs=0.1)
    assert found["tag"]["line_db"] == pytest.approx(-30, abs=6)
    assert 0.02 < found["tag"]["phase_error_deg"] < 1.0
    assert found["antennas"]["states"] == 2 and 3 <= found["antennas"]["changes"] <= 20
    assert np.median(found["antennas"]["snr_db"]) == pytest.approx(30, abs=4)
    assert found["advice"] == ["none: read it with a scene (docs/wifi.md)"]
    assert "seen at 134." in text and "2 states, " in text


def test_snapshots_without_a_tag_say_so(tmp_path):
    found, text = checked(snapshots(tmp_path, line_db=120))
    assert found["tag"] is None and "none is seen" in text
    assert any("no tag is seen: check that it is on" in advice for advice in found["advice"])


def test_stamps_gaps_lamps_and_a_single_antenna_are_advised_on(tmp_path):
    path = snapshots(
        tmp_path, antennas=1, clock_hz=120.0, stamp_grid_s=1e-4, clock_back_s=1.0, duration_s=4.0
    )
    found, text = checked(path)
    timing = found["timing"]
    assert timing["rounded_to_s"] == 1e-4 and timing["clock_steps"] == 1 and timing["gaps"] == 1
    assert timing["packets_per_s"] == pytest.approx(900, rel=0.2)
    advice = " ".join(found["advice"])
    for words in ("two antennas on one oscillator", "rounded to 0.1 ms", "stepped back"):
        assert words in advice
    assert found["tag"]["may_be_a_lamp"] and "or a lamp, seen at 120." in text


@pytest.mark.filterwarnings("ignore:.*encountered in:RuntimeWarning")
@pytest.mark.parametrize("kind", ["ci16_le", "cf32_le"])
def test_raw_samples_are_recognised_by_their_values(kind, tmp_path):
    """A file of integers that is opened as floats gives no reading and no message."""
    rng = np.random.default_rng(1)
    samples = 0.01 * rng.standard_normal((60_000, 2))
    samples[10_000:10_320] += np.tile(0.3 * rng.standard_normal((16, 2)), (20, 1))
    if kind == "ci16_le":
        (32768 * samples).astype("<i2").tofile(tmp_path / "air")
    else:
        samples.astype("<f4").tofile(tmp_path / "air")
    found, text = checked(tmp_path / "air")
    assert found["file"]["datatype"] == kind and found["file"]["samples"] == 60_000
    assert found["levels"]["peak_dbfs"] == pytest.approx(-2, abs=3)
    assert found["tag"] is None and "name a scene with --scene" in text
    other = "cf32_le" if kind == "ci16_le" else "ci16_le"
    found = checked(tmp_path / "air", other)[0]
    assert found["advice"][0].startswith(f"the values are those of {kind} rather than {other}")


@pytest.mark.parametrize(
    ("waveform", "clock_hz"), [("repeated", 1000), ("repeated", 1035), ("wifi", 1365)]
)
def test_frames_and_tag_are_found_without_a_scene(waveform, clock_hz, tmp_path):
    """What somebody else recorded with the default frame needs no scene to be recognised."""
    scene = {
        "radio": {"center_frequency_hz": 915e6},
        "sounding": {"waveform": waveform},
        "sensors": [{"name": "arm", "model": "line-915mhz", "clock_hz": clock_hz}],
        "simulation": {"duration_s": 1.0, "clock_offset_ppm": 40},
    }
    wiforce.simulate(scene, tmp_path / "air")
    path = tmp_path / "air.sigmf-meta"
    metadata = json.loads(path.read_text())
    stated = ("core:datatype", "core:sample_rate", "core:version")
    metadata["global"] = {key: metadata["global"][key] for key in stated}
    path.write_text(json.dumps(metadata))
    found, text = checked(tmp_path / "air")
    (found_hz,) = found["tag"]["clocks_hz"]
    assert found_hz == pytest.approx(clock_hz * (1 + 40e-6), abs=0.1)
    assert f"those of the waveform '{waveform}'" in text and "name a scene" in text


def test_noise_without_a_scene_is_no_frame(tmp_path):
    """A recording of something else must not be taken for a sounding frame."""
    codes = (300 * np.random.default_rng(1).standard_normal((2_000_000, 2))).astype("<i2")
    codes.tofile(tmp_path / "air.sigmf-data")
    stated = {"core:datatype": "ci16_le", "core:sample_rate": 12.5e6, "core:version": "1.0.0"}
    metadata = {"global": stated, "captures": [{"core:sample_start": 0}], "annotations": []}
    (tmp_path / "air.sigmf-meta").write_text(json.dumps(metadata))
    found, text = checked(tmp_path / "air")
    assert found["tag"] is None and "no frames of the default waveforms" in text


def test_samples_without_numbers_and_text_are_named(tmp_path):
    np.full(9999, np.nan, "<c8").tofile(tmp_path / "nan.cf32")
    found, _ = checked(tmp_path / "nan.cf32", "cf32_le")
    assert found["levels"]["not_finite"] == 1.0
    (tmp_path / "text").write_text("no samples at all\n" * 99)
    assert "holds text, not samples" in refused("check", tmp_path / "text")


def test_options_for_samples_are_refused_for_snapshots(tmp_path):
    path = snapshots(tmp_path, duration_s=1.0)
    for option in (("--scene", "demo"), ("--datatype", "ci16_le", "--mac", "11:22:33:44:55:66")):
        said = refused("check", path, *option)
        assert "not for channel snapshots" in said


def test_one_antenna_of_a_wide_band_states_the_error_of_readings(tmp_path):
    """What read will show: the tag's lines, and the noise of what is left of them."""
    settings = {"line_db": 40, "snr_db": 40.0, "antennas": 1, "duration_s": 1.2}
    found, _ = checked(snapshots(tmp_path, subcarriers=256, **settings))
    assert found["tag"]["clock_hz"] == pytest.approx(134.0, abs=0.1)
    assert found["tag"]["line_db"] == pytest.approx(-40, abs=6)
    assert -4 < found["one_antenna"]["kept_db"] < 0
    assert 0.01 < found["tag"]["phase_error_deg"] < 0.5
    assert 0.3 < found["one_antenna"]["phase_error_deg"] < 3
    assert found["advice"] == ["none: read it with a scene (docs/wifi.md)"]
    narrow, text = checked(snapshots(tmp_path, subcarriers=52, **settings))
    assert "dB of a tag beside the phases" in text
    assert narrow["one_antenna"]["kept_db"] < found["one_antenna"]["kept_db"]
    assert narrow["one_antenna"]["phase_error_deg"] > 2.2 * found["one_antenna"]["phase_error_deg"]


def test_antenna_that_repeats_another_is_left_out(tmp_path):
    """Rounding is all that is left between them, in which a tag was seen."""
    arrays = dict(np.load(snapshots(tmp_path)))
    arrays["channel"] = np.repeat(arrays["channel"][:, :, :1], 2, axis=2)
    np.savez(tmp_path / "a.npz", **arrays)
    found, text = checked(tmp_path / "a.npz")
    assert found["antennas"]["count"] == 1 and found["one_antenna"] is not None
    assert "left out 1 x antenna with the values of another one" in text


@pytest.mark.parametrize(
    ("start", "says"), [(b"\n\r\r\n", "pcapng file"), (b"\xd4\xc3\xb2\xa1", "none of nexmon_csi")]
)
def test_files_of_packets_are_not_taken_for_samples(start, says, tmp_path):
    (tmp_path / "a.pcap").write_bytes(start + bytes(9000))
    assert says in refused("check", tmp_path / "a.pcap")


SCENE = {
    "radio": {"sample_rate_hz": 1.25e6},
    "sounding": {"frame_length": 400},
    "phase_group": {"snapshots": 125},
    "sensors": [{"name": "arm", "model": "line-900mhz-calibrated", "clock_hz": 300}],
    "reference_s": 0.2,
    "simulation": {"truth_model": "line-900mhz", "duration_s": 0.4, "snr_db": 20},
}


@pytest.fixture
def capture(tmp_path):
    wiforce.simulate(wiforce.load_scene(SCENE), tmp_path / "press")
    return tmp_path / "press"


def test_check_capture_whole_file_is_verified_and_its_tag_measured(capture):
    done = run_command("check", capture, "--json")
    found = json.loads(done.stdout)
    (file,) = found["files"]
    assert file["checksum"] == "verified" and file["samples"] == 500_000
    assert file["seconds"] == pytest.approx(0.4) and file["gaps"] == 0
    assert found["first_frame"] == 0 and found["levels"]["peak_dbfs"] == pytest.approx(-3, abs=1)
    (tag,) = found["sensors"]
    assert tag["name"] == "arm" and abs(tag["clock_offset_ppm"]) < 100
    assert max(tag["phase_error_deg"]) < 1.0 and found["warnings"] == []
    text = run_command("check", capture).stdout
    assert "checksum   verified" in text and "ready to be read; only `read` can tell" in text


@pytest.mark.parametrize("damage", ["changed", "cut"])
def test_check_capture_changed_or_cut_file_is_refused(capture, damage):
    """One flipped bit, or a copy that ended early, gives readings of something else."""
    data = capture.with_suffix(".sigmf-data")
    content = bytearray(data.read_bytes())
    content[1_000_001] ^= 1
    data.write_bytes(content if damage == "changed" else content[: -4 * 50_000])
    said = refused("check", capture)
    assert "press.sigmf-data: must have the checksum that its metadata state" in said


def test_check_capture_without_checksum_or_with_gaps_says_so(capture):
    meta = capture.with_suffix(".sigmf-meta")
    content = json.loads(meta.read_text())
    del content["global"]["core:sha512"]
    gap = {"core:sample_start": 400_000, "core:global_index": 450_000}
    content["captures"].append({**content["captures"][0], **gap})
    meta.write_text(json.dumps(content))
    text = checked(capture)[1]
    assert "50000 samples lost in 1 gaps" in text and "checksum   none" in text
    assert "no checksum is known" in text
    with open(capture.with_suffix(".sigmf-data"), "r+b") as data:
        data.truncate(4 * 450_000)
    assert "ends 50000 samples before the 500000 that its metadata state" in checked(capture)[1]


def test_check_samples_at_a_rate_of_no_default_scene_names_no_key_of_it(capture):
    """It complained about a clock of 1000 Hz, which nobody had written."""
    meta = capture.with_suffix(".sigmf-meta")
    content = json.loads(meta.read_text())
    del content["global"]["wiforce:scene"]
    meta.write_text(json.dumps(content))
    (note,) = checked(capture)[0]["notes"]
    assert note.startswith("no scene is known, and default ones do not fit this sample")
    assert note.endswith("name a scene with --scene") and "clock_hz" not in note


def test_check_capture_states_levels_of_extreme_and_damaged_floats(capture):
    """It printed inf for squares beyond single precision, and nan for one frame without numbers."""
    usual = checked(capture)[0]["levels"]
    samples = np.fromfile(capture.with_suffix(".sigmf-data"), np.int16).astype(np.float32)
    samples, data = samples.view(np.complex64) / 32768, capture.with_name("raw.cf32")
    scene = capture.with_name("scene.yaml")
    scene.write_text(yaml.safe_dump(SCENE))
    for scale, at, count in ((1.0, 500, 1), (1e25, 0, 0), (1.0, 0, 150_000)):
        damaged = samples * np.float32(scale)
        damaged[at : at + count] = np.nan
        damaged.tofile(data)
        levels = check_file(data, scene, "cf32_le", None)[0]["levels"]
        more_db = 20 * np.log10(scale)
        assert levels["preamble_dbfs"] == pytest.approx(usual["preamble_dbfs"] + more_db, abs=0.1)
        assert levels["noise_dbfs"] == pytest.approx(usual["noise_dbfs"] + more_db, abs=0.5)
    samples[::100] = np.nan
    samples.tofile(data)
    said = refused("check", data, "--scene", scene, "--datatype", "cf32_le")
    assert "raw.cf32: holds no whole frame of finite samples" in said


def test_check_with_a_wrong_clock_names_the_one_on_the_air(capture, tmp_path):
    """It asked whether the tag was on, whose clock a survey of the same samples showed."""

    def advice(clock_hz):
        sensors = [{**SCENE["sensors"][0], "clock_hz": clock_hz}]
        (tmp_path / "other.yaml").write_text(yaml.safe_dump({**SCENE, "sensors": sensors}))
        found, _ = check_file(capture, tmp_path / "other.yaml", None, None)
        return " ".join(found["advice"])

    assert advice(340).startswith("arm: no tag detected at 340 Hz: on the air is a clock of 300.")
    assert advice(340).endswith("does not list: is it the scene of what is received?")
    found = "arm: no tag detected at 301 Hz: a tag is found at 300.01"
    assert advice(301).startswith(found) and " ppm from the clock_hz of arm" in advice(301)
    assert "a tag is found at 300 Hz, 2 times the clock_hz of arm; check clock_hz" in advice(150)
    advice(340)
    done = run_command("read", capture, "--scene", tmp_path / "other.yaml")
    assert "does not list: is it the scene of what is received?" in done.stderr


def test_check_of_a_capture_outside_its_band_warns_as_plan_does(tmp_path):
    """A recording was called ready although its transmitter had left the permitted band."""
    scene = wiforce.load_scene({**SCENE, "environment": {"band": "us-902-928"}})
    wiforce.simulate(scene, tmp_path / "press")
    found, text = checked(tmp_path / "press")
    assert found["advice"] == list(outside_band(scene)) and found["advice"]
    assert "leaves environment.band us-902-928" in text and "ready to be read" not in text


def test_check_raw_samples_gives_what_the_scene_and_the_file_state(capture, tmp_path):
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(SCENE))
    raw = capture.with_suffix(".sigmf-data").rename(tmp_path / "press.bin")
    found, text = check_file(raw, tmp_path / "scene.yaml", "ci16_le", None)
    (file,) = found["files"]
    assert file["seconds"] == pytest.approx(0.4) and file["checksum"] == "none"
    assert "unknown carrier" in text
