# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings: what their metadata may state, and what is refused before anything is read."""

import json
import os

import pytest
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.capture import Segment, open_capture
from gnuradio.wiforce.scene import load_capture_scene, load_scene


def write(folder, samples=1000, datatype="ci16_le", captures=None, name="x", **changes):
    """A SigMF pair with ``samples`` zeros."""
    size = {"ci16_le": 4, "cf32_le": 8}.get(datatype, 4)
    (folder / f"{name}.sigmf-data").write_bytes(bytes(samples * size))
    captures = captures or [{"core:sample_start": 0, "core:frequency": 900e6}]
    fields = {
        "core:datatype": datatype,
        "core:sample_rate": 12.5e6,
        "core:version": "1.0.0",
        **changes,
    }
    fields = {key: value for key, value in fields.items() if value is not None}
    meta = {"global": fields, "captures": captures, "annotations": []}
    (folder / f"{name}.sigmf-meta").write_text(json.dumps(meta))
    return folder / name


@pytest.mark.parametrize("suffix", ["", ".sigmf-meta", ".sigmf-data"])
def test_open_capture_any_of_its_names_is_found(tmp_path, suffix):
    stem = write(tmp_path, name="Prüfung 1.5 N")
    capture = open_capture(f"{stem}{suffix}")
    assert capture.datatype == "ci16_le"
    assert capture.sample_rate_hz == 12.5e6
    assert capture.center_frequency_hz == 900e6
    assert capture.segments == (Segment(0, 0, 1000),)


def test_open_capture_gap_keeps_device_sample_count(tmp_path):
    captures = [
        {"core:sample_start": 0, "core:global_index": 50},
        {"core:sample_start": 400, "core:global_index": 950},
    ]
    capture = open_capture(write(tmp_path, captures=captures))
    assert capture.segments == (Segment(0, 50, 400), Segment(400, 950, 600))
    assert capture.samples == 1000 and capture.span == 1500


def test_open_capture_truncated_file_keeps_remaining_segments(tmp_path):
    places = [(0, 0), (600, 700), (5000, 6000)]
    captures = [{"core:sample_start": a, "core:global_index": b} for a, b in places]
    capture = open_capture(write(tmp_path, captures=captures))
    assert capture.segments == (Segment(0, 0, 600), Segment(600, 700, 400))


def test_open_capture_contiguous_captures_are_merged(tmp_path):
    captures = [
        {"core:sample_start": 0, "core:global_index": 50},
        {"core:sample_start": 300, "core:global_index": 350},
        {"core:sample_start": 400},
        {"core:sample_start": 700, "core:global_index": 751},
    ]
    capture = open_capture(write(tmp_path, captures=captures))
    assert capture.segments == (Segment(0, 50, 700), Segment(700, 751, 300))


@pytest.mark.parametrize("path", ["../secret.bin", "x.sigmf-data/../../secret.bin"])
def test_open_capture_foreign_path_in_metadata_is_ignored(tmp_path, path):
    (tmp_path / "secret.bin").write_bytes(bytes(4 * 77))
    folder = tmp_path / "folder"
    folder.mkdir()
    capture = open_capture(write(folder, **{"core:dataset": path}))
    assert capture.path == folder / "x.sigmf-data" and capture.samples == 1000


def test_open_capture_raw_file_needs_datatype_only(tmp_path):
    path = tmp_path / "raw.bin"
    path.write_bytes(bytes(8 * 77 + 3))
    assert open_capture(path, "cf32_le").segments == (Segment(0, 0, 77),)


@pytest.mark.parametrize(
    "changes, rule",
    [
        ({"datatype": "ci8"}, "core:datatype must be one of"),
        ({"core:sample_rate": None}, "core:sample_rate must be a positive number"),
        ({"core:sample_rate": -1.0}, "x.sigmf-meta"),
        ({"core:num_channels": 2}, "core:num_channels must be 1"),
        ({"samples": 0}, "is empty"),
        ({"captures": [{"core:sample_start": 5}, {"core:sample_start": 1}]}, "x.sigmf-meta"),
        (
            {
                "captures": [
                    {"core:sample_start": 0, "core:global_index": 9},
                    {"core:sample_start": 100, "core:global_index": 20},
                ]
            },
            "core:global_index must not decrease",
        ),
    ],
)
def test_open_capture_invalid_metadata_names_file_and_rule(tmp_path, changes, rule):
    stem = write(tmp_path, **changes)
    with pytest.raises(InputError) as refusal:
        open_capture(stem)
    assert rule in str(refusal.value) and "\n" not in str(refusal.value)


@pytest.mark.parametrize("text", ["", "[]", "{", '{"global": 3}', "null", '{"global": {}}', "\xff"])
def test_open_capture_metadata_not_sigmf_raises(tmp_path, text):
    stem = write(tmp_path)
    (tmp_path / "x.sigmf-meta").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match="x.sigmf-meta"):
        open_capture(stem)


def test_open_capture_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match="none.sigmf-meta: no such file"):
        open_capture(tmp_path / "none")
    stem = write(tmp_path)
    (tmp_path / "x.sigmf-data").unlink()
    with pytest.raises(InputError, match="x.sigmf-data: no such file"):
        open_capture(stem)


def test_open_capture_missing_metadata_key_is_named(tmp_path):
    stem = write(tmp_path)
    (tmp_path / "x.sigmf-meta").write_text("{}")
    with pytest.raises(InputError, match="is not valid SigMF .key 'global' is missing"):
        open_capture(stem)


def test_open_capture_wrong_type_of_metadata_is_named(tmp_path):
    stem = write(tmp_path)
    meta = tmp_path / "x.sigmf-meta"
    content = json.loads(meta.read_text())
    content["global"]["core:sample_rate"] = "fast"
    meta.write_text(json.dumps(content))
    with pytest.raises(InputError, match="global: core:sample_rate: is not valid SigMF .'fast'"):
        open_capture(stem)


def test_open_capture_samples_without_metadata_asks_for_their_type(tmp_path):
    raw = tmp_path / "raw.dat"
    raw.write_bytes(bytes(8000))
    rule = r"no raw\.dat\.sigmf-meta; for raw samples, give their type .--datatype ci16_le or"
    with pytest.raises(InputError, match=rule):
        open_capture(raw)
    with pytest.raises(InputError, match=r"raw\.dat: holds no scene; name one"):
        load_capture_scene(open_capture(raw, "cf32_le"))


def test_open_capture_pipe_or_folder_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path):
        with pytest.raises(InputError, match="must be a regular file"):
            open_capture(path, "ci16_le")


def test_load_capture_scene_not_a_mapping_is_named(tmp_path):
    with pytest.raises(InputError, match="holds no scene"):
        load_capture_scene(open_capture(write(tmp_path)))
    capture = open_capture(write(tmp_path, **{"wiforce:scene": "demo"}))
    with pytest.raises(InputError, match="wiforce:scene: must hold a mapping .*, got 'demo'"):
        load_capture_scene(capture)


def test_check_against_other_rate_or_carrier_raises(tmp_path):
    capture = open_capture(write(tmp_path))
    scene = {"sensors": [{"name": "arm", "model": "wiforce-900mhz"}]}
    capture.check_against(load_scene(scene))
    for key, value, message in (
        ("sample_rate_hz", 10e6, "sample rate must be radio.sample_rate_hz of the scene"),
        (
            "center_frequency_hz",
            2.4e9,
            "carrier must be radio.center_frequency_hz of the scene",
        ),
    ):
        other = {"radio": {key: value}, "sensors": scene["sensors"]}
        if key == "center_frequency_hz":
            other["sensors"] = [{"name": "arm", "model": "wiforce-2400mhz"}]
        with pytest.raises(InputError, match=message):
            capture.check_against(load_scene(other))
