# SPDX-License-Identifier: GPL-3.0-or-later
"""`gr-wiforce check CAPTURE`: files that were changed or cut are found before they are read."""

import json
import os

import pytest
import yaml
from command_runs import run_command
from gnuradio import wiforce

SCENE = {
    "radio": {"sample_rate_hz": 1.25e6},
    "sounding": {"frame_length": 400},
    "phase_group": {"snapshots": 125},
    "sensors": [{"name": "arm", "model": "line-900mhz-calibrated", "clock_hz": 300}],
    "simulation": {"truth_model": "line-900mhz", "duration_s": 0.4, "snr_db": 20},
}


def check(*arguments):
    return run_command("check", *arguments)


@pytest.fixture
def capture(tmp_path):
    wiforce.simulate(wiforce.load_scene(SCENE), tmp_path / "press")
    return tmp_path / "press"


def test_check_capture_whole_file_is_verified(capture):
    done = check(capture, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    (file,) = found["files"]
    assert file["checksum"] == "verified" and file["samples"] == 500_000
    assert file["seconds"] == pytest.approx(0.4) and file["gaps"] == 0
    assert found["first_frame"] == 0 and found["levels"]["peak_dbfs"] == pytest.approx(-3, abs=1)
    assert found["warnings"] == []
    assert "checksum   verified" in check(capture).stdout


@pytest.mark.parametrize("damage", ["changed", "cut"])
def test_check_capture_changed_or_cut_file_is_refused(capture, damage):
    """One flipped bit, or a copy that ended early, gives readings of something else."""
    data = capture.with_suffix(".sigmf-data")
    if damage == "cut":
        os.truncate(data, data.stat().st_size - 4 * 50_000)
    else:
        content = bytearray(data.read_bytes())
        content[1_000_001] ^= 1
        data.write_bytes(content)
    done = check(capture)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
    assert "press.sigmf-data: must have the checksum that its metadata state" in done.stderr


def test_check_capture_without_checksum_or_with_gaps_says_so(capture):
    meta = capture.with_suffix(".sigmf-meta")
    content = json.loads(meta.read_text())
    del content["global"]["core:sha512"]
    gap = {"core:sample_start": 400_000, "core:global_index": 450_000}
    content["captures"].append({**content["captures"][0], **gap})
    meta.write_text(json.dumps(content))
    done = check(capture)
    assert done.returncode == 0, done.stderr
    assert "50000 samples lost in 1 gaps" in done.stdout and "checksum   none" in done.stdout
    assert "no checksum is known" in done.stdout


def test_check_capture_with_a_tag_says_how_well_it_is_seen(tmp_path):
    scene = {**SCENE, "reference_s": 0.2}
    wiforce.simulate(wiforce.load_scene(scene), tmp_path / "press")
    (tag,) = json.loads(check(tmp_path / "press", "--json").stdout)["sensors"]
    assert tag["name"] == "arm" and abs(tag["clock_offset_ppm"]) < 100
    assert max(tag["phase_error_deg"]) < 1.0
    assert "advice     none, ready to be read" in check(tmp_path / "press").stdout


def test_check_raw_samples_gives_what_the_scene_and_the_file_state(capture, tmp_path):
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(SCENE))
    raw = capture.with_suffix(".sigmf-data").rename(tmp_path / "press.bin")
    options = "--scene", tmp_path / "scene.yaml", "--datatype", "ci16_le"
    done = check(raw, *options, "--json")
    assert done.returncode == 0, done.stderr
    (file,) = json.loads(done.stdout)["files"]
    assert file["seconds"] == pytest.approx(0.4) and file["checksum"] == "none"
    assert "unknown carrier" in check(raw, *options).stdout
    assert "give a FILE" in check("--datatype", "ci16_le").stderr


def test_check_needs_a_capture_or_a_device(capture):
    for arguments in ([], ["--scene", "demo"], [capture, "--args", "addr=127.0.0.1"]):
        done = check(*arguments)
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
