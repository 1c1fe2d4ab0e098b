# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings: what their metadata may state, and what is refused before anything is read."""

import copy
import json
import os

import pytest
import sigmf
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.capture import Segment, open_capture
from gnuradio.wiforce.io.capture.sigmf_metadata import SPECIFICATION, read_metadata, write_metadata
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


def stated(*places):
    """Segments of metadata that begin at such samples, on the device's count where it is given."""
    return [
        {"core:sample_start": start} | ({} if index is None else {"core:global_index": index})
        for start, index in places
    ]


@pytest.mark.parametrize("suffix", ["", ".sigmf-meta", ".sigmf-data"])
def test_open_capture_any_of_its_names_is_found(tmp_path, suffix):
    stem = write(tmp_path, name="Prüfung 1.5 N")
    capture = open_capture(f"{stem}{suffix}")
    assert capture.datatype == "ci16_le"
    assert capture.sample_rate_hz == 12.5e6
    assert capture.center_frequency_hz == 900e6
    assert capture.segments == (Segment(0, 0, 1000),)


@pytest.mark.parametrize(
    ("places", "segments"),
    [
        ([(0, 50), (400, 950)], [(0, 50, 400), (400, 950, 600)]),  # a gap
        ([(0, 0), (600, 700), (5000, 6000)], [(0, 0, 600), (600, 700, 400)]),  # a file that was cut
        ([(0, 50), (300, 350), (400, None), (700, 751)], [(0, 50, 700), (700, 751, 300)]),
    ],
)
def test_open_capture_segments_lie_between_gaps_on_the_count_of_the_device(
    tmp_path, places, segments
):
    capture = open_capture(write(tmp_path, captures=stated(*places)))
    assert capture.segments == tuple(Segment(*each) for each in segments)
    assert capture.samples == 1000
    assert capture.span == sum(segments[-1][1:]) - segments[0][1]


def test_open_capture_begins_a_segment_at_each_retuning(tmp_path):
    """Its phases are new ones: a recording that was reconnected read as presses of nobody."""
    captures = stated((0, 50), (300, 350), (400, None), (700, 900), (1000, None))
    for n in (1, 3):
        captures[n]["wiforce:retuned"] = True
    captures[2]["wiforce:retuned"] = False
    capture = open_capture(write(tmp_path, captures=captures))
    places = (0, 50, 300, False), (300, 350, 400, True), (700, 900, 300, True)
    assert capture.segments == tuple(Segment(*each) for each in places)
    assert capture.gaps == 1


@pytest.mark.parametrize(
    ("changes", "places", "lacking"),
    [
        ({}, [0, 600], None),
        ({"wiforce:samples": 900}, [0], None),  # a recorder that goes on
        ({"wiforce:samples": 1234}, [0], "ends 234 samples before the 1234 that"),
        ({}, [0, 600, 5000], "ends 4000 samples before the 5000 that"),
    ],
)
def test_capture_shorter_than_its_metadata_state_says_so(tmp_path, changes, places, lacking):
    """A copy that ended early read as a shorter measurement, without a word."""
    captures = [{"core:sample_start": start} for start in places]
    capture = open_capture(write(tmp_path, captures=captures, **changes))
    assert capture.incomplete.startswith(lacking) if lacking else capture.incomplete == ""


@pytest.mark.parametrize("path", ["../secret.bin", "x.sigmf-data/../../secret.bin", "other.iq"])
def test_open_capture_samples_in_another_file_are_refused(tmp_path, path):
    """The file beside the metadata was read, whatever file they named."""
    (tmp_path / "secret.bin").write_bytes(bytes(4 * 77))
    folder = tmp_path / "folder"
    folder.mkdir()
    assert open_capture(write(folder, **{"core:dataset": "x.sigmf-data"})).samples == 1000
    with pytest.raises(InputError, match=r"x.sigmf-meta: core:dataset must be x.sigmf-data"):
        open_capture(write(folder, **{"core:dataset": path}))


@pytest.mark.parametrize(
    "changes, rule",
    [
        ({"datatype": "ci8"}, "core:datatype must be one of"),
        ({"core:sample_rate": None}, "core:sample_rate must be a positive number"),
        ({"core:num_channels": 2}, "core:num_channels must be 1"),
        ({"core:trailing_bytes": 8}, "core:trailing_bytes must be 0"),
        ({"samples": 0}, "is empty"),
        (
            {"captures": [{"core:sample_start": n, "core:frequency": n // 2} for n in (2, 3, 4)]},
            "core:frequency must be the same in all captures, got 2",
        ),
        (
            {"captures": [{"core:sample_start": 0, "wiforce:retuned": 1}]},
            "wiforce:retuned: is not valid SigMF (1 is not of type 'boolean')",
        ),
        ({"captures": stated((0, 9), (100, 20))}, "core:global_index must not decrease"),
        (
            {"captures": stated((0, None), (100, 10**15))},
            "core:global_index must not jump by over 2^40 samples",
        ),
    ],
)
def test_open_capture_invalid_metadata_names_file_and_rule(tmp_path, changes, rule):
    stem = write(tmp_path, **changes)
    with pytest.raises(InputError) as refusal:
        open_capture(stem)
    assert rule in str(refusal.value) and "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("name", "datatype", "rule"),
    [
        ("none", None, "none.sigmf-meta: no such file"),
        ("alone", None, "alone.sigmf-data: no such file"),
        ("x", "ci16_le", "x.sigmf-meta states its own type: omit --datatype"),
        ("raw.dat", None, "no raw.dat.sigmf-meta; for raw samples, give their type .--datatype ci"),
        ("pipe", "ci16_le", "must be a regular file"),
        ("", "ci16_le", "must be a regular file"),
    ],
)
def test_open_capture_what_is_no_capture_is_named(tmp_path, name, datatype, rule):
    write(tmp_path)
    write(tmp_path, name="alone")
    (tmp_path / "alone.sigmf-data").unlink()
    (tmp_path / "raw.dat").write_bytes(bytes(8000))
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match=rule):
        open_capture(tmp_path / name, datatype)


def test_load_capture_scene_not_a_mapping_is_named(tmp_path):
    stem = write(tmp_path)
    (tmp_path / "raw.dat").write_bytes(bytes(8000))
    for bare in (open_capture(stem), open_capture(tmp_path / "raw.dat", "cf32_le")):
        with pytest.raises(InputError, match="holds no scene; name one with --scene$"):
            load_capture_scene(bare)
    with pytest.raises(InputError, match="or leave out --datatype to use that of its metadata"):
        load_capture_scene(open_capture(f"{stem}.sigmf-data", "ci16_le"))
    capture = open_capture(write(tmp_path, **{"wiforce:scene": "demo"}))
    with pytest.raises(InputError, match="wiforce:scene: must hold a mapping .*, got 'demo'"):
        load_capture_scene(capture)


def test_check_against_other_rate_or_carrier_raises(tmp_path):
    capture = open_capture(write(tmp_path))
    scene = {"sensors": [{"name": "arm", "model": "wiforce-900mhz"}]}
    capture.check_against(load_scene(scene))
    for key, value, model, message in (
        ("sample_rate_hz", 10e6, "wiforce-900mhz", "sample rate must be radio.sample_rate_hz of"),
        ("center_frequency_hz", 2.4e9, "wiforce-2400mhz", "carrier must be radio.center_"),
    ):
        other = {"radio": {key: value}, "sensors": [{"name": "arm", "model": model}]}
        with pytest.raises(InputError, match=message):
            capture.check_against(load_scene(other))


FIELDS = {
    "core:datatype": "ci16_le",
    "core:sample_rate": 12.5e6,
    "core:num_channels": 1,
    "core:offset": 0,
    "core:extensions": [{"name": "wiforce", "version": "1", "optional": True}],
    "wiforce:scene": {"b": [1, {"z": None, "a": "Kräfte"}], "a": 2.5},
}
CAPTURES = [
    {"core:sample_start": 0, "core:frequency": 9e8},
    {"core:sample_start": 10, "core:global_index": 15, "core:datetime": "2026-01-02T03:04:05Z"},
]
VALID = {"global": FIELDS, "captures": CAPTURES, "annotations": [{"core:sample_start": 3}]}


def changed(section, key, value):
    whole = copy.deepcopy(VALID)
    item = whole[section] if isinstance(whole[section], dict) else whole[section][-1]
    item[key] = value
    return whole


def test_write_metadata_gives_file_of_package(tmp_path):
    """Files would differ from those of earlier versions, or other tools refuse them."""
    data = tmp_path / "x.sigmf-data"
    data.write_bytes(bytes(range(256)) * 20_000)
    write_metadata(tmp_path / "x.sigmf-meta", data, FIELDS, CAPTURES)
    other = sigmf.SigMFFile(global_info=FIELDS)
    for capture in CAPTURES:
        other.add_capture(capture["core:sample_start"], metadata=capture)
    other.set_data_file(data)
    ours, theirs = json.loads((tmp_path / "x.sigmf-meta").read_text()), json.loads(other.dumps())
    assert ours["global"]["core:version"] == SPECIFICATION
    for whole in (ours, theirs):  # the package writes the version that it knows
        whole["global"].pop("core:version")
    assert json.dumps(ours) == json.dumps(theirs)
    sigmf.fromfile(tmp_path / "x.sigmf-meta").validate()


MISTAKES = [
    (changed("global", "core:sample_rate", "fast"), "global: core:sample_rate: .*'fast' is not of"),
    (changed("global", "core:sample_rate", 0), "core:sample_rate: .*0 is not a number"),
    (changed("global", "core:num_channels", 0), "core:num_channels: .*0 is not a number from 1"),
    (changed("captures", "core:sample_start", -1), "captures: 1: core:sample_start: .*-1 is not"),
    (changed("captures", "core:global_index", 1.5), "core:global_index: .*1.5 is not of type"),
    (changed("captures", "core:frequency", float("nan")), "core:frequency: .*nan is not a number"),
    (changed("captures", "core:global_index", 10**400), "core:global_index: .*1000.* is not a num"),
    (VALID | {"captures": [3]}, "captures: 0: .*3 is not of type 'object'"),
    (VALID | {"captures": [{}]}, "captures: 0: .*'core:sample_start' is missing"),
    (VALID | {"captures": CAPTURES[::-1]}, "captures: .*must not decrease"),
    ({"global": FIELDS}, "key 'captures' is missing"),
    (VALID | {"global": {}}, "global: .*'core:datatype' is missing"),
]


NO_OBJECTS = ["", "{", "[]", "null", "\xff", "[" * 100_000, '{"global": NaN}']
# The last one was taken, which need not be the one that is meant.
TWICE = '{"global": {"core:datatype": "cf32_le", "core:datatype": "ci16_le"}, "captures": []}'


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        *((json.dumps(whole), rule) for whole, rule in MISTAKES),
        *((text, "x.sigmf-meta: ") for text in NO_OBJECTS),
        (TWICE, "key 'core:datatype' is given more than once"),
    ],
)
def test_read_metadata_names_the_key_that_breaks_a_rule(tmp_path, text, rule):
    """A mistake would appear later, as a wrong reading or a traceback."""
    (tmp_path / "x.sigmf-meta").write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=rule):
        read_metadata(tmp_path / "x.sigmf-meta")
