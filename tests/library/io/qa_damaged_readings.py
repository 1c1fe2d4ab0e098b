# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged files of readings and odd files of gauges are refused, and never give other readings."""

import gc
import json
import os

import numpy as np
import pytest
from command_runs import refused, run_command, succeeded
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError, OutputError
from gnuradio.wiforce.io.files.mcap_file import McapWriter
from gnuradio.wiforce.io.files.readings_files import ReadingsFile
from gnuradio.wiforce.io.files.writers import open_writer
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.io.text.textfile import write_whole
from machine import full_disk
from matplotlib.figure import Figure
from wiforce_app.shell.plots import save_picture


def readings(count=300):
    """Readings with distinct values."""
    for group in range(count):
        time_s = round(0.018 + 0.036 * group, 6)
        yield Reading(time_s, "arm", 1, 1 + group / 7, 0.1, 40.0, 0.2, group=group)


@pytest.mark.parametrize("suffix", ["mcap", "parquet"])
def test_export_refuses_changed_bytes_or_gives_the_same_readings(tmp_path, suffix):
    """A bit that a disk has changed must not become another force."""
    path, out = tmp_path / f"a.{suffix}", tmp_path / "out.csv"
    with McapWriter(path) if suffix == "mcap" else open_writer(path) as writer:
        writer.write_all(readings())
    whole = path.read_bytes()
    succeeded("export", path, "-o", out)
    expected = out.read_text()
    refused = 0
    for place in np.linspace(10, len(whole) - 10, 9).astype(int):
        damaged = bytearray(whole)
        damaged[place] ^= 0xFF
        path.write_bytes(damaged)
        out.unlink(missing_ok=True)
        done = run_command("export", path, "-o", out)
        assert done.returncode in (0, 2) and done.stderr.count("\n") == 1, done.stderr
        refused += done.returncode == 2
        assert not out.exists() if done.returncode else out.read_text() == expected
    assert refused > 2


@pytest.mark.parametrize(
    ("suffix", "text", "message"),
    [
        ("jsonl", '{"time_s": 1, "sensor": ["x"]}\n', "sensor must be a text"),
        ("jsonl", '{"time_s": NaN, "sensor": "arm"}\n', "time_s and sensor must be given"),
        ("jsonl", '{"time_s": 1e999, "sensor": "arm"}\n', "time_s must be finite"),
        ("jsonl", '{"time_s": 1, "sensor": "arm", "touch": 0.7}\n', "touch must be an integer"),
        ("jsonl", '{"time_s": 1, "sensor": "arm", "touch": 7}\n', "touch must be 0, 1 or empty"),
        ("jsonl", '{"time_s": -5, "sensor": "arm"}\n', "cannot be converted to mcap"),
        ("jsonl", "[" * 100_000, "is not JSON"),
        ("jsonl", "\udcff", "is not UTF-8"),
        ("csv", "", "must have a first row with the names of its columns"),
        ("csv", "a,b\n", "it has no column time_s"),
        ("csv", "time_s,sensor,force_n,force_n\n1,arm,2,3\n", "must have different names"),
        ("csv", "time_s,sensor\n1,arm\n2,arm,3\n", "line 3: must have as many fields"),
        ("csv", 'time_s,sensor\n1,"arm\n', "is not a CSV file"),
        ("csv", "time_s,sensor\n1,\udcff\n", "is not UTF-8"),
        ("csv", "time_s,sensor,group\n1,arm,1_0\n", "row 1: is no reading"),
    ],
)
def test_export_malformed_row_is_named_in_one_line(tmp_path, suffix, text, message):
    """A file that was cut off, or has other columns, must not become fewer or other readings."""
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(text.encode(errors="surrogateescape"))
    said = refused("export", path, "-o", tmp_path / "a.mcap")
    assert message in said and [file.name for file in tmp_path.iterdir()] == [path.name]


def test_parquet_with_a_damaged_name_of_a_column_is_refused(tmp_path):
    """The names are not covered by any checksum; the command ended with an error of a codec."""
    path = tmp_path / "a.parquet"
    with open_writer(path) as writer:
        writer.write(Reading(1.0, "arm"))
    path.write_bytes(path.read_bytes().replace(b"force_n", b"\xfforce_n", 1))
    with pytest.raises(InputError, match="is not a complete Parquet file"):
        list(ReadingsFile(path).rows())


def test_parquet_file_whose_name_is_not_utf8_is_read(tmp_path):
    """Its name ended the run that joins the readings of all captures of a folder."""
    path = tmp_path / os.fsdecode(b"n\xe9.parquet")
    with open_writer(path) as writer:
        writer.write(Reading(1.0, "arm"))
    assert [row["sensor"] for row in ReadingsFile(path).rows()] == ["arm"]


def test_export_header_alone_gives_a_file_without_readings(tmp_path):
    (tmp_path / "a.csv").write_text("time_s,sensor\n")
    succeeded("export", tmp_path / "a.csv", "--to", "json")
    assert (tmp_path / "a.jsonl").read_text() == ""


def test_export_keeps_keys_that_only_later_lines_have(tmp_path):
    """Joined logs of two runs: the columns of the second one were dropped without a word."""
    rows = [{"time_s": 1, "sensor": "a"}, {"time_s": 2, "sensor": "a", "note": {"by": True}}]
    (tmp_path / "a.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    succeeded("export", tmp_path / "a.jsonl", "--to", "csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines[0].endswith(",note") and lines[2].endswith(',"{""by"": true}"')
    done = run_command("export", tmp_path / "a.jsonl", "--to", "mcap")
    assert "columns without a field in MCAP are left out: note" in done.stderr


def test_mcap_sensors_that_would_share_topics_are_refused(tmp_path):
    """Their wrenches would be published on one topic."""
    rows = [{"time_s": 1, "sensor": name} for name in ("a/b c", "a b/c")]
    (tmp_path / "a.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    rule = "sensor 'a b/c': has the same ROS topic as 'a/b c', /wiforce/a_b_c/reading"
    assert rule in refused("export", tmp_path / "a.jsonl", "--to", "mcap")
    assert len(list(tmp_path.iterdir())) == 1
    with pytest.raises(InputError, match="has the same ROS topic"):
        McapWriter(tmp_path / "b.mcap", sensors=["a/b c", "a b/c"])


@pytest.mark.parametrize("suffix", ["csv", "parquet", "mcap"])
def test_export_full_disk_names_the_output_and_keeps_the_former_one(tmp_path, monkeypatch, suffix):
    def full(self, data):
        self._failure = OutputError(self._path, "cannot be written further (disk full); rows kept")
        raise self._failure

    with open_writer(tmp_path / "a.jsonl") as writer:
        writer.write_all(readings(5))
    out = tmp_path / f"out.{suffix}"
    out.write_text("former")
    monkeypatch.setattr("gnuradio.wiforce.io.files.output_file.OutputFile.write", full)
    done = run_command("export", tmp_path / "a.jsonl", "-o", out)
    assert done.returncode == 1
    assert done.stderr == f"gr-wiforce: {out}: cannot be written (disk full)\n"
    assert out.read_text() == "former" and len(list(tmp_path.iterdir())) == 2


def test_replacing_keeps_pipes_and_the_target_of_a_link(tmp_path):
    """A run as root replaced /dev/full by a file, and a link to another disk by its content."""
    target, link, pipe = tmp_path / "target.csv", tmp_path / "link.csv", tmp_path / "pipe.csv"
    target.write_text("former")
    link.symlink_to(target)
    write_whole(link, "new")
    assert link.is_symlink() and target.read_text() == "new"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_whole(pipe, "new")
    assert os.read(reader, 10) == b"new" and pipe.is_fifo()
    os.close(reader)


def test_picture_on_a_full_disk_is_named_and_not_left_in_part(tmp_path):
    """That of a PDF was called an inconsistent stream."""
    canvas = Figure()
    canvas.subplots().plot(np.random.default_rng(1).random(1000))
    with full_disk(1000), pytest.raises(OutputError, match="a.pdf: cannot be written"):
        save_picture(canvas, tmp_path / "a.pdf")
    assert not list(tmp_path.iterdir())


@pytest.mark.filterwarnings("error")
def test_simulated_packets_on_a_full_disk_are_named_without_a_traceback(tmp_path):
    """The archive, which nobody had closed, printed one."""
    with full_disk(10_000), pytest.raises(OutputError, match="a: cannot be written"):
        wiforce.simulate("wifi_packets", tmp_path / "a")
    gc.collect()
    assert not list(tmp_path.iterdir())


def test_export_accepts_integers_as_pandas_writes_them(tmp_path):
    """Columns with empty fields become 1.0 when a file is read and written by pandas."""
    path = tmp_path / "a.csv"
    path.write_text("time_s,sensor,touch,force_n,group\n1,arm,1.0,nan,3.0\n")
    succeeded("export", path, "--to", "json")
    row = json.loads((tmp_path / "a.jsonl").read_text())
    assert (row["touch"], row["force_n"], row["group"]) == (1, None, 3)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ([], "a.jsonl: holds no readings"),
        ([1.0], "a.jsonl: must be two or more, got 1"),
        ([1.0, 1.036, 1.072, 1e9], "a.jsonl: must span at most"),
    ],
)
def test_score_readings_of_no_or_endless_time_are_refused(tmp_path, times, message):
    """A wrong time in one row took all memory of the machine."""
    with open_writer(tmp_path / "a.jsonl") as writer:
        for time_s in times:
            writer.write(Reading(time_s, "arm", 0))
    (tmp_path / "g.csv").write_text("time_s,force_n\n0,0\n0.1,2\n")
    said = refused("score", tmp_path / "a.jsonl", "--against", tmp_path / "g.csv")
    assert message in said
