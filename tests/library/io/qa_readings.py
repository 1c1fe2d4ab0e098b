# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings, their flags and their files: what a script that parses them relies on."""

import io
import json
import os
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import numpy as np
import pytest
from command_runs import rows_of
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.files.writers import RotatingWriter, Rotation, open_writer
from gnuradio.wiforce.io.outputs import Outputs
from gnuradio.wiforce.io.readings import (
    COLUMNS,
    NUMBERS,
    Flag,
    GroupCounts,
    Reading,
    flag_words,
    reading_of,
)
from gnuradio.wiforce.wiforce_kernels import group_reading, reading_fields

TOUCHED = Reading(0.018, "arm", 1, 4.123456, 0.05, 45.0, 0.1, 91.5, -12.25, 9.876, ("gap", "weak"))
UNKNOWN = Reading(0.054, "arm", None, None, None, None, None, None, None, None, ("gap",))


def test_columns_and_flag_words_equal_documented_order():
    """Scripts look for these words; their order in a cell is that of the documentation."""
    assert ",".join(COLUMNS) == (
        "time_s,sensor,touch,force_n,force_std_n,location_mm,location_std_mm,"
        "phase1_deg,phase2_deg,snr_db,flags,group,interference"
    )
    documented = (
        "reference gap transition weak ambiguous force-unobservable inconsistent extrapolated "
        "moved saturated"
    )
    assert " ".join(flag.word for flag in Flag) == documented
    assert flag_words(2 ** len(Flag) - 1) == tuple(documented.split())
    assert flag_words(0) == ()


def test_columns_of_kernel_readings_are_those_of_a_reading():
    """Force and its standard deviation, exchanged by a line of C++, would look plausible."""
    found = np.zeros((2, 2), group_reading)
    values = {name: float(row) for row, name in enumerate(NUMBERS, 1) if name in found.dtype.names}
    for name, value in values.items():
        found[name] = value
    found["phases_deg"], found["touch"], found["group"] = (-1.5, 2.5), 1, [[7], [8]]
    found["flags"] = (Flag.GAP | Flag.WEAK).value
    found["force_n"][1, 1], found["touch"][1, 1] = np.nan, -1
    fields = reading_fields(found, ["left", "right"], 0.036, 1.0, flag_words)
    readings = list(map(reading_of, fields))
    assert [(each.sensor, each.group) for each in readings] == [
        ("left", 7), ("right", 7), ("left", 8), ("right", 8)
    ]  # fmt: skip
    assert readings[0] == Reading(
        7.5 * 0.036 + 1.0,
        "left",
        1,
        phase1_deg=-1.5,
        phase2_deg=2.5,
        flags=("gap", "weak"),
        group=7,
        **values,
    )
    assert (readings[3].force_n, readings[3].touch) == (None, None)


def test_writers_round_and_write_unknown_values_as_nothing(tmp_path):
    """Rows are in the file as soon as they are written."""
    with open_writer(tmp_path / "out.csv") as writer:
        writer.write(TOUCHED)
        writer.write(UNKNOWN)
        rows = rows_of(tmp_path / "out.csv")
    assert rows[0]["force_n"] == "4.1235" and rows[0]["flags"] == "gap weak"
    assert rows[0]["touch"] == "1" and rows[0]["snr_db"] == "9.88"
    assert rows[1]["touch"] == "" and rows[1]["force_n"] == ""
    with open_writer(tmp_path / "out.jsonl") as writer:
        writer.write(Reading(0.018, "arm", 1, float("nan"), snr_db=float("-inf")))
    row = json.loads((tmp_path / "out.jsonl").read_text())
    assert tuple(row) == COLUMNS
    assert row["force_n"] is None and row["snr_db"] is None and row["touch"] == 1


@pytest.fixture
def earlier(tmp_path):
    """A file of an earlier run."""
    path = tmp_path / "out.csv"
    path.write_text("precious\n")
    return path


def test_writer_existing_file_is_kept_until_first_reading(earlier):
    with pytest.raises(InputError), open_writer(earlier):
        raise InputError("another parameter", "is refused")
    assert earlier.read_text() == "precious\n"
    with open_writer(earlier) as writer:
        assert earlier.read_text() == "precious\n"
        writer.write(UNKNOWN)
        assert earlier.read_text() == f"{','.join(COLUMNS)}\n0.054,arm,,,,,,,,,gap,,\n"


def test_outputs_beside_a_full_standard_output_get_all_rows(tmp_path, monkeypatch):
    file, stdout = open_writer(tmp_path / "out.csv"), open_writer()
    with open("/dev/full", "wb", buffering=0) as full:
        monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(full, write_through=True))
        with pytest.raises(OSError, match="No space left"), Outputs(stdout, file) as outputs:
            for _ in range(2):
                outputs.write(UNKNOWN)
        assert outputs.failure is not None and outputs.rows == file.rows == 2
        other = open_writer(tmp_path / "other.csv")
        for outputs in (Outputs(stdout), Outputs(stdout, other, needs_all=True)):
            with pytest.raises(OSError, match="No space left"), outputs:
                outputs.write(UNKNOWN)
                raise AssertionError("no more rows are wanted")


@pytest.mark.parametrize("fails", [False, True])
def test_writer_without_a_reading_leaves_header_only(earlier, fails):
    raised = pytest.raises(InputError, match="is lost") if fails else nullcontext()
    with raised, open_writer(earlier) as writer:
        if fails:
            assert writer.begin() is writer
            raise InputError("a device", "is lost")
    assert earlier.read_text() == ",".join(COLUMNS) + "\n"


def test_writer_pipe_is_opened_before_the_first_reading(tmp_path):
    pipe = tmp_path / "out.csv"
    os.mkfifo(pipe)
    with ThreadPoolExecutor(1) as pool:
        listener = pool.submit(pipe.open)
        writer = Outputs(open_writer(pipe))
        with listener.result(timeout=60) as stream:
            writer.close()
            assert stream.read() == ",".join(COLUMNS) + "\n"


@pytest.mark.parametrize("name", ["out.txt", "out", "missing/out.csv", "x" * 300 + "out.csv"])
def test_open_writer_unusable_path_is_named(tmp_path, name):
    with pytest.raises(InputError, match="out"):
        open_writer(tmp_path / name)


def test_group_counts_name_sensors_that_were_touched_in_the_reference():
    """A press that began within the reference was read without a word."""
    counts = GroupCounts()
    for group, touch in enumerate((0, 1, 1)):
        counts.note([Reading(0.036 * group, name, touch, flags=("reference",)) for name in "ab"])
    counts.note([Reading(0.108, "a", 1)])
    assert counts.touched_reference()["a"].startswith("a: was touched in 2 groups of the reference")
    assert list(counts.touched_reference()) == ["a", "b"]


def test_group_counts_name_saturation_first():
    """Nobody pressed: the summary of a receiver that clipped spoke of 70 groups of presses."""
    counts = GroupCounts()
    counts.note([Reading(0.018, "arm", flags=("saturated", "transition"))])
    counts.note([Reading(0.054, "arm", flags=("saturated", "reference"))])
    assert str(counts) == "2 groups: 0 usable, 2 doubtful (2 saturated)"
    counts.note([Reading(0.09, "arm")])
    assert str(counts) == "3 groups: 1 usable, 2 doubtful (2 saturated)"


GROUP_S = 0.036


def readings(first, count, sensors=("left", "right")):
    return [
        Reading(round(GROUP_S * (first + group + 0.5), 6), sensor, 0)
        for group in range(count)
        for sensor in sensors
    ]


def write(writer, found):
    with writer:
        writer.write_all(found)


@pytest.mark.parametrize("name", ["grip.csv", "grip.jsonl"])
def test_append_restart_keeps_previous_readings(tmp_path, name):
    path = tmp_path / name
    for run in range(3):
        write(open_writer(path, append=True), readings(10 * run, 10))
    lines = path.read_text().splitlines()
    if name.endswith(".csv"):
        assert lines[0] == ",".join(COLUMNS) and lines.count(lines[0]) == 1
        times = [float(row["time_s"]) for row in rows_of(path)]
    else:
        times = [json.loads(line)["time_s"] for line in lines]
    assert times == [reading.time_s for reading in readings(0, 30)]


@pytest.mark.parametrize(
    ("append", "rotation"), [(False, Rotation()), (True, Rotation(size_bytes=10_000))]
)
def test_output_of_a_running_writer_refused_and_unchanged(tmp_path, append, rotation):
    """A second live reader with the same output emptied the file of the first one."""
    path = tmp_path / "grip.csv"
    with open_writer(path) as writer:
        writer.write_all(readings(0, 10))
        before = path.read_bytes()
        with pytest.raises(InputError, match="is being written to by another process"):
            open_writer(path, append=append, rotation=rotation).begin()
        assert path.read_bytes() == before
        writer.write(readings(10, 1)[0])
    assert len(rows_of(path)) == 21
    write(open_writer(path, append=True, rotation=rotation), readings(11, 1))
    assert len(rows_of(path)) == 23


def test_append_after_a_power_failure_removes_only_the_incomplete_row(tmp_path):
    path = tmp_path / "grip.csv"
    write(open_writer(path, append=True), readings(0, 10))
    whole = path.read_bytes()
    for torn in (whole[:-5], whole[: len(",".join(COLUMNS)) - 3], b""):
        path.write_bytes(torn)
        complete = torn.count(b"\n")
        write(open_writer(path, append=True), readings(10, 5))
        rows = rows_of(path)
        assert len(rows) == max(complete - 1, 0) + 10
        assert all(None not in row.values() and None not in row for row in rows)


@pytest.mark.parametrize("name", ["grip.csv", "grip.jsonl"])
@pytest.mark.parametrize("zeros", [10, 200_000])
def test_append_after_a_power_failure_removes_zeros_and_no_row(tmp_path, name, zeros):
    """As many zeros as 64 KiB at the end of a file emptied it of all readings."""
    path = tmp_path / name
    write(open_writer(path, append=True), readings(0, 10))
    whole = path.read_bytes()
    for rows in (whole, whole[:-5], whole[:3], b""):
        path.write_bytes(rows + bytes(zeros))
        kept = rows[: rows.rfind(b"\n") + 1]
        write(RotatingWriter(path, Rotation(size_bytes=10**6)), readings(10, 5))
        assert path.read_bytes().startswith(kept)
        assert path.read_bytes().count(b"\n") == max(kept.count(b"\n"), name == "grip.csv") + 10


@pytest.mark.parametrize("name", ["grip.csv", "grip.jsonl"])
def test_append_behind_a_line_that_is_no_row_refused_and_unchanged(tmp_path, name):
    """A file with a long last line, of another program, was emptied."""
    path = tmp_path / name
    write(open_writer(path), readings(0, 10))
    rows = path.read_bytes()
    long = rows.replace(b"\n", b"") * 300
    for content in (rows + long, rows + long + bytes(100), *([long] if "json" in name else [])):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"its last line has \d+ bytes"):
            write(open_writer(path, append=True), readings(0, 1))
        assert path.read_bytes() == content


@pytest.mark.parametrize("name", ["grip.csv", "grip.jsonl"])
@pytest.mark.parametrize("content", ["a,b\n1,2\n", "dear diary", "[1]\n"])
def test_append_to_another_kind_of_file_refused_and_unchanged(tmp_path, name, content):
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(InputError, match="columns of these readings"):
        write(open_writer(path, append=True), readings(0, 1))
    assert path.read_text() == content


def test_rotation_by_size_keeps_groups_together_and_loses_no_row(tmp_path):
    path = tmp_path / "grip.csv"
    expected = readings(0, 200)
    write(RotatingWriter(path, Rotation(size_bytes=2000)), expected)
    renamed = sorted(tmp_path.glob("grip-*Z*.csv"))
    assert len(renamed) > 3
    assert all(2000 <= part.stat().st_size < 2300 for part in renamed)
    assert all(len(rows_of(part)) % 2 == 0 for part in renamed)
    rows = rows_of(*renamed, path)
    assert [row["sensor"] for row in rows] == [reading.sensor for reading in expected]
    assert [float(row["time_s"]) for row in rows] == [reading.time_s for reading in expected]


def test_rotation_by_time_begins_a_file_at_each_period_of_utc(tmp_path):
    path = tmp_path / "grip.jsonl"
    now = [6 * 3600.0 - 1]
    with RotatingWriter(path, Rotation(every_s=6 * 3600), now=lambda: now[0]) as writer:
        for reading in readings(0, 60, ["arm"]):
            writer.write(reading)
            now[0] += GROUP_S
    (renamed,) = tmp_path.glob("grip-*Z.jsonl")
    assert len(renamed.read_text().splitlines()) == 28  # of 1 s
    assert len(path.read_text().splitlines()) == 60 - 28


def test_rotation_restart_continues_the_file_unless_its_period_is_over(tmp_path):
    path, rotation = tmp_path / "grip.csv", Rotation(every_s=86400)
    write(RotatingWriter(path, rotation), readings(0, 5))
    write(RotatingWriter(path, rotation), readings(5, 5))
    assert len(rows_of(path)) == 20 and len(list(tmp_path.iterdir())) == 1
    later = path.stat().st_mtime + 86400
    write(RotatingWriter(path, rotation, now=lambda: later), readings(10, 5))
    (renamed,) = tmp_path.glob("grip-*Z.csv")
    assert len(rows_of(renamed)) == 20 and len(rows_of(path)) == 10


def test_rotation_keep_deletes_only_the_oldest_files_of_its_own(tmp_path):
    path = tmp_path / "grip.csv"
    others = [tmp_path / name for name in ("grip-notes.csv", "gripper-20200101T000000.000Z.csv")]
    for other in others:
        other.write_text("precious")
    oldest = tmp_path / "grip-20200101T000000.000Z.csv"
    oldest.write_text("old")
    write(RotatingWriter(path, Rotation(size_bytes=1000, keep=3)), readings(0, 200))
    renamed = sorted(tmp_path.glob("grip-2*Z*.csv"))
    assert len(renamed) == 3 and oldest not in renamed
    assert all(other.read_text() == "precious" for other in others)
    # The three that are kept, and the last, follow on one another.
    times = sorted({float(row["time_s"]) for row in rows_of(*renamed, path)})
    assert times[-1] == readings(199, 1)[0].time_s
    assert times == [reading.time_s for reading in readings(200 - len(times), len(times), ["arm"])]


@pytest.mark.parametrize(
    ("limits", "keep", "words"),
    [
        (["6"], None, "6h or 100MB"),
        (["0h"], None, "6h or 100MB"),
        (["1h", "2h"], None, "once for time"),
        ([], 3, "--keep"),
    ],
)
def test_rotation_bad_limits_refused(limits, keep, words):
    with pytest.raises(InputError, match=words):
        Rotation.of(limits, keep)


def test_standard_output_and_parquet_cannot_be_continued():
    for option, more in (
        ("append", {"append": True}),
        ("rotate", {"rotation": Rotation.of(["1h"])}),
    ):
        with pytest.raises(InputError, match=f"--{option}: needs a file"):
            open_writer(None, **more)
        with pytest.raises(InputError, match="nothing can be appended to Parquet; use .csv or"):
            open_writer("out.parquet", **more)


@pytest.mark.parametrize("rotation", [Rotation(), Rotation(size_bytes=100)])
def test_open_writer_writes_further_columns_and_no_input(tmp_path, rotation):
    """Readings of two runs in one file could not be distinguished; a scene would be overwritten."""
    scene, path = tmp_path / "scene.csv", tmp_path / "grip.csv"
    scene.write_text("precious")
    with pytest.raises(InputError, match="scene.csv"):
        open_writer(scene, [scene], rotation=rotation)
    assert scene.read_text() == "precious"
    for run in "ab":
        with open_writer(path, [scene], ("run",), True, rotation=rotation) as writer:
            for reading in readings(0, 4):
                writer.write(reading, {"run": run})
    files = sorted(tmp_path.glob("grip*.csv"))
    assert (len(files) > 1) == bool(rotation)
    assert all(file.read_text().splitlines()[0].endswith(",run") for file in files)
    assert sorted(row["run"] for row in rows_of(*files)) == ["a"] * 8 + ["b"] * 8
