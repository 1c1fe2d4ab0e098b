# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of readings that outlive a run: appended to, renamed by time or size."""

import csv
import json

import pytest
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.files.writers import RotatingWriter, Rotation, open_rotating, open_writer
from gnuradio.wiforce.io.readings import COLUMNS, Reading

GROUP_S = 0.036


def readings(first, count, sensors=("left", "right")):
    return [
        Reading(round(GROUP_S * (first + group + 0.5), 6), sensor, 0)
        for group in range(count)
        for sensor in sensors
    ]


def rows_of(*paths):
    rows = []
    for path in paths:
        with open(path, newline="") as stream:
            rows += list(csv.DictReader(stream))
    return rows


def write(writer, found):
    with writer:
        for reading in found:
            writer.write(reading)


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


@pytest.mark.parametrize("append", [False, True])
@pytest.mark.parametrize("rotation", [Rotation(), Rotation(size_bytes=10_000)])
def test_output_of_a_running_writer_refused_and_unchanged(tmp_path, append, rotation):
    """A second live reader with the same output emptied the file of the first one."""
    path = tmp_path / "grip.csv"
    with open_writer(path) as writer:
        for reading in readings(0, 10):
            writer.write(reading)
        before = path.read_bytes()
        with pytest.raises(InputError, match="is being written to by another process"):
            open_rotating(path, rotation, append=append).begin()
        assert path.read_bytes() == before
        writer.write(readings(10, 1)[0])
    assert len(rows_of(path)) == 21
    write(open_rotating(path, rotation, append=True), readings(11, 1))
    assert len(rows_of(path)) == 23


def test_append_to_standard_output_refused():
    with pytest.raises(InputError, match="--append: needs a file"):
        open_rotating(None, Rotation(), append=True)


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
@pytest.mark.parametrize("content", ["a,b\n1,2\n", "dear diary", "time_s,sensor\n1,arm\n", "[1]\n"])
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
        (["-5MB"], None, "6h or 100MB"),
        ([], 3, "--keep"),
    ],
)
def test_rotation_bad_limits_refused(limits, keep, words):
    with pytest.raises(InputError, match=words):
        Rotation.of(limits, keep)


def test_rotation_of_standard_output_refused():
    with pytest.raises(InputError, match="--rotate: needs a file"):
        open_rotating(None, Rotation.of(["1h"]))


@pytest.mark.parametrize("rotation", [Rotation(), Rotation(size_bytes=100)])
def test_open_rotating_writes_further_columns_and_no_input(tmp_path, rotation):
    """Readings of two runs in one file could not be distinguished; a scene would be overwritten."""
    scene, path = tmp_path / "scene.csv", tmp_path / "grip.csv"
    scene.write_text("precious")
    with pytest.raises(InputError, match="scene.csv"):
        open_rotating(scene, rotation, [scene])
    assert scene.read_text() == "precious"
    for run in "ab":
        with open_rotating(path, rotation, [scene], ("run",), append=True) as writer:
            for reading in readings(0, 4):
                writer.write(reading, {"run": run})
    files = sorted(tmp_path.glob("grip*.csv"))
    assert (len(files) > 1) == bool(rotation)
    assert all(file.read_text().splitlines()[0].endswith(",run") for file in files)
    assert sorted(row["run"] for row in rows_of(*files)) == ["a"] * 8 + ["b"] * 8
