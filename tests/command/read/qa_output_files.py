# SPDX-License-Identifier: GPL-3.0-or-later
"""MCAP and Parquet files of readings, their ends, and their conversion."""

import errno
import gc
import io
import json
import os
import re
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas
import pytest
from command_runs import refused, rows_of, succeeded
from gnuradio.wiforce.errors import InputError, OutputError
from gnuradio.wiforce.io.files import output_file
from gnuradio.wiforce.io.files.mcap_file import McapWriter, mcap_rows
from gnuradio.wiforce.io.files.output_file import OutputFile
from gnuradio.wiforce.io.files.readings_files import ReadingsFile
from gnuradio.wiforce.io.files.writers import ParquetWriter, open_writer
from gnuradio.wiforce.io.outputs import Outputs
from gnuradio.wiforce.io.readings import Reading
from mcap.reader import make_reader
from pyarrow import parquet
from ros_clients import bag_messages

RUN = {"run": "20260131T235959Z-abcdef"}


def readings(count):
    """Readings of all kinds: untouched, touched, unknown, flagged."""
    rng = np.random.default_rng(5)
    for group in range(count):
        time_s, kind = 0.018 + 0.036 * group, group % 4
        if kind == 0:
            yield Reading(time_s, "arm", 0, None, None, None, None, 1.5, -2.5, 9.25, (), group, 0.0)
        elif kind == 1:
            values = (4 * rng.random(), 0.05, 80 * rng.random(), 0.2, *rng.uniform(-180, 180, 2))
            yield Reading(time_s, "arm", 1, *values, 9.0, (), group, 0.125)
        elif kind == 2:
            yield Reading(time_s, "arm", None, flags=("gap",), group=group)
        else:
            yield Reading(time_s, "arm", 1, 4.0, 0.5, 45.0, 2.0, flags=("weak",), group=group)


def written(path, count=20, also=("run", "time_utc")):
    """A file of readings, with the columns of a live run."""
    with open_writer(path, also=also) as writer:
        for reading in readings(count):
            utc = f"2026-01-31T23:59:{reading.group % 60:02d}.000000Z"
            stamp = {**RUN, "time_utc": utc}
            writer.write(reading, {name: stamp[name] for name in also})
    return path


@pytest.mark.parametrize("suffix", ["parquet", "mcap"])
def test_writer_that_is_refused_keeps_former_file(tmp_path, suffix):
    path = tmp_path / f"out.{suffix}"
    path.write_bytes(b"former")
    writer = (ParquetWriter if suffix == "parquet" else McapWriter)(path)
    with pytest.raises(KeyboardInterrupt), writer:
        raise KeyboardInterrupt
    assert path.read_bytes() == b"former"
    if suffix == "mcap":  # a run whose device never answered
        with Outputs(McapWriter(path)):
            pass
        assert path.read_bytes() == b"former"
    with closing(OutputFile(path, append=True)):
        with pytest.raises(InputError, match="is being written to by another process"):
            writer.begin()


class FullDisk:
    """Lets a file grow to so many bytes, and by the reserve once that is given back."""

    def __init__(self, monkeypatch, room):
        self._room = room
        monkeypatch.setattr(output_file, "_reserved", lambda path, size: self)
        monkeypatch.setattr(output_file, "open", self._open, raising=False)

    def _open(self, path, *_, **__):
        disk, file = self, io.FileIO(path, "a")
        self._path = path

        class Limited(io.FileIO):
            def write(self, data):
                free = disk._room - os.path.getsize(path)
                if free <= 0:
                    raise OSError(errno.ENOSPC, "No space left on device")
                return super().write(memoryview(data)[:free])

        file.close()
        return Limited(path, "a")

    def close(self):
        """What the reserve's space is given back by."""
        self._room += 1_000_000


def test_full_disk_keeps_the_former_file(tmp_path, monkeypatch):
    def full(folder, size):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(output_file, "_reserved", full)
    (tmp_path / "out.csv").write_text("former\n")
    with pytest.raises(OutputError, match="out.csv: cannot be written .No space left"):
        output_file.OutputFile(tmp_path / "out.csv")
    assert (tmp_path / "out.csv").read_text() == "former\n"


@pytest.mark.parametrize("suffix", ["parquet", "mcap"])
def test_full_disk_ends_run_with_all_rows_in_a_valid_file(tmp_path, monkeypatch, suffix):
    """The space held back holds what waits, and the end of the file."""
    path = tmp_path / f"out.{suffix}"
    FullDisk(monkeypatch, 10_000)
    writer = (ParquetWriter if suffix == "parquet" else McapWriter)(path)
    with pytest.raises(OutputError, match="disk full.*until then are kept"), writer:
        for reading in readings(100_000):
            writer.write(reading)
    rows = writer.rows
    assert 0 < rows < 20_000
    if suffix == "parquet":
        assert len(pandas.read_parquet(path)) == rows
    else:
        kept = len(bag_messages(path)["/wiforce/arm/reading"])
        assert kept in (rows, rows + 1)  # the wrench of the last reading may be missing


def test_parquet_whose_end_is_interrupted_is_ended(tmp_path, monkeypatch):
    """What was left of it wrote to a closed file: a process that SIGTERM ended printed that."""
    printed, path = [], tmp_path / "out.parquet"
    monkeypatch.setattr("sys.unraisablehook", printed.append)
    writer = ParquetWriter(path)
    with pytest.raises(SystemExit), writer:
        for reading in readings(4100):  # more than one row group
            writer.write(reading)
        monkeypatch.setattr(writer, "_flush", lambda: sys.exit(143))
    del writer
    gc.collect()
    assert not printed
    assert len(pandas.read_parquet(path)) == 4096


def test_mcap_cut_anywhere_gives_a_prefix_of_its_readings(tmp_path):
    """Whatever a power failure leaves, what can be read is right."""
    path, cut = tmp_path / "whole.mcap", tmp_path / "cut.mcap"
    with McapWriter(path) as writer:
        for reading in readings(100):
            writer.write(reading)
    data, whole = path.read_bytes(), list(mcap_rows(path))
    assert len(whole) == 100
    counts = []
    for length in np.random.default_rng(3).integers(8, len(data), 40):
        cut.write_bytes(data[:length])
        rows = list(mcap_rows(cut))
        assert rows == whole[: len(rows)]
        counts.append(len(rows))
    assert 0 in counts and len(set(counts)) > 2


def test_export_of_a_cut_mcap_says_what_is_there(tmp_path):
    """It became an empty table, without a word."""
    path, out = tmp_path / "cut.mcap", tmp_path / "out.csv"
    with McapWriter(path) as writer:
        for reading in readings(200):
            writer.write(reading)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    exported = succeeded("export", path, "-o", out)
    kept = len(rows_of(out))
    assert 0 < kept < 200
    assert f"{path}: ends behind reading {kept} without a regular end" in exported.stderr
    path.write_bytes(whole[:1000])
    assert "is cut off before its first reading" in refused("export", path, "-o", out)


def test_mcap_folder_gets_files_of_limited_size_with_all_readings(tmp_path):
    """What a reader that runs for weeks writes to: no run replaces the file of another."""
    for _ in range(2):
        with McapWriter(tmp_path, sensors=["arm"], most_bytes=30_000) as output:
            for reading in readings(1000):
                output.write(reading)
    files = sorted(tmp_path.glob("*Z.mcap"))
    groups = [m.group for path in files for m in bag_messages(path)["/wiforce/arm/reading"]]
    assert groups == 2 * list(range(1000)) and len(files) >= 4


@pytest.mark.parametrize(
    ("stamps", "expected"),
    [
        (("2026-01-31T23:59:59.000000Z", ""), {1769903999 * 10**9}),
        (("", ""), {18 * 10**6, 54 * 10**6}),
    ],
)
def test_mcap_reading_without_utc_has_the_time_before_or_of_the_signal(tmp_path, stamps, expected):
    """The time axis of a viewer would begin in 1970 for one reading."""
    path = tmp_path / "out.mcap"
    with McapWriter(path) as writer:
        for reading, utc in zip(readings(2), stamps, strict=True):
            writer.write(reading, {"time_utc": utc})
    with open(path, "rb") as file:
        times = {message.log_time for _, _, message in make_reader(file).iter_messages()}
    assert times == expected


def test_export_through_every_format_keeps_every_byte(tmp_path):
    """A value that changes on the way would be another measurement."""
    path = written(tmp_path / "press.csv")
    for before, form, after in (
        ("press.csv", "json", "press.jsonl"),
        ("press.jsonl", "parquet", "press.parquet"),
        ("press.parquet", "mcap", "press.mcap"),
        ("press.mcap", "csv", "of_mcap.csv"),
        ("press.parquet", "csv", "of_parquet.csv"),
    ):
        output = tmp_path / after
        done = succeeded("export", tmp_path / before, "--to", form, "-o", output)
        assert done.stdout == ""
        assert done.stderr == f"gr-wiforce: wrote 20 readings to {output}\n"
    for name in ("of_mcap.csv", "of_parquet.csv"):
        assert (tmp_path / name).read_text() == path.read_text()


def test_export_from_mcap_keeps_surfaces(tmp_path):
    """y became empty, and the torque of lines in the same table unknown, without a word."""
    table = (
        "time_s,sensor,touch,force_n,location_mm,flags,y_mm,y_std_mm,cov_x_y,device_time_s\n"
        "0.018,low,1,2.0,45.0,,,,,3.5\n"
        "0.018,skin,1,4.0,45.0,,12.5,0.4,,3.5\n"
        "0.054,skin,0,,,,,,,\n"
    )
    (tmp_path / "a.csv").write_text(table)
    for source, out in (("a.csv", "b.mcap"), ("b.mcap", "c.csv"), ("c.csv", "d.mcap")):
        done = succeeded("export", tmp_path / source, "-o", tmp_path / out)
        assert "left out" not in done.stderr
    rows = list(ReadingsFile(tmp_path / "c.csv").rows())
    assert [row["y_mm"] for row in rows] == [None, 12.5, None]
    assert [row["y_std_mm"] for row in rows] == [None, 0.4, None]
    assert [row["device_time_s"] for row in rows] == [3.5, 3.5, None]
    for name in ("b.mcap", "d.mcap"):
        found = bag_messages(tmp_path / name)
        torque = found["/wiforce/skin/wrench"][0].wrench.torque
        assert (torque.x, torque.y) == pytest.approx((-0.05, 0.18))
        torque = found["/wiforce/low/wrench"][0].wrench.torque
        assert (torque.x, torque.y) == pytest.approx((0, 0.09))


def test_export_to_mcap_holds_the_scene_and_run(tmp_path):
    path, bag = written(tmp_path / "press.csv"), tmp_path / "press.mcap"
    succeeded("export", path, "--to", "mcap", "--scene", "demo")
    assert bag_messages(bag)["/wiforce/arm/reading"][1].run == RUN["run"]
    with open(bag, "rb") as file:
        (described,) = [each.metadata for each in make_reader(file).iter_metadata()]
    assert json.loads(described["wiforce:scene"])["reference_s"] == 0.5
    assert sorted(tmp_path.iterdir()) == [path, bag]


@pytest.mark.parametrize(
    ("name", "content", "rule"),
    [
        ("in.txt", "", "readings must be in a .csv, .jsonl, .parquet or .mcap file"),
        ("in.jsonl", '{"time_s": 0.1, "sensor": "arm"}\n{"time', "line 2: is not JSON"),
        ("in.parquet", "PAR1", "is not a complete Parquet file"),
        ("in.mcap", "MCAP", "is not an MCAP file"),
        ("missing.mcap", None, "cannot be read"),
        ("missing.csv", None, "cannot be read"),
        ("missing.parquet", None, "cannot be read"),
    ],
)
def test_export_of_broken_file_is_refused_in_one_line(tmp_path, name, content, rule):
    if content is not None:
        (tmp_path / name).write_text(content)
    said = refused("export", tmp_path / name, "-o", tmp_path / "out.csv")
    assert rule in said and str(tmp_path / name) in said
    said = refused("export", tmp_path / name, "-o", tmp_path / "out.json")
    assert "must end in .csv or .jsonl or .parquet or .mcap, got" in said
    assert not (tmp_path / "out.csv").exists() and len(list(tmp_path.iterdir())) < 2


def test_export_to_a_link_goes_by_the_name_that_was_given(tmp_path):
    """A CSV file became an MCAP file, or was refused by an option that the command lacks."""
    source, link = written(tmp_path / "a.csv"), tmp_path / "out.csv"
    link.symlink_to(tmp_path / "target.txt")
    succeeded("export", source, "-o", link)
    assert (tmp_path / "target.txt").read_text() == source.read_text()
    link.unlink()
    link.symlink_to("/dev/full")
    said = refused("export", source, "-o", link)
    assert said.endswith("out.csv: must not be a link to a device or a pipe: /dev/full")


def test_export_reads_parquet_of_several_captures_with_their_names(tmp_path):
    path = written(tmp_path / "in.parquet", also=("run", "time_utc"))
    table = parquet.read_table(path)
    parquet.write_table(table.append_column("capture", [["day/1"] * 20]), path)
    rows = list(ReadingsFile(path).rows())
    assert rows[3]["capture"] == "day/1" and rows[3]["flags"] == "weak" and rows[2]["touch"] is None


PAGE = (Path(__file__).resolve().parents[3] / "docs/outputs.md").read_text(encoding="utf-8")


def test_examples_run_on_a_press(tmp_path, monkeypatch, capsys):
    """In their order, as one program, on the scene that is simulated fastest."""
    monkeypatch.chdir(tmp_path)
    succeeded("simulate", "tabletop", "press")
    words = ["read", "press", "-o", "press.parquet", "--mcap", "press.mcap"]
    succeeded(*words)
    # The stream of LSL is a live one, and its test is with the live run; a folder of captures is
    # read in qa_docs.py.
    elsewhere = ("pylsl", 'read("captures")')
    blocks = [
        block
        for block in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
        if not any(part in block for part in elsewhere)
    ]
    assert len(blocks) == 4
    names = {}
    exec("\n".join(blocks), names)
    error_n, reference_s, *forces = capsys.readouterr().out.split("max")[1].splitlines()[1:]
    assert float(error_n) < 0.2 and float(reference_s) > 0 and len(forces) > 50
    assert len(names["both"]) == len(names["clear"]) == len(forces)
