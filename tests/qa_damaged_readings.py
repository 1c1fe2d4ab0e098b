# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged files of readings and odd files of gauges are refused, and never give other readings."""

import json

import numpy as np
import pytest
from command_runs import run_command
from gnuradio.wiforce.io.mcap_file import McapWriter
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.io.writers import open_writer


def readings(count=300):
    """Readings with distinct values."""
    for group in range(count):
        time_s = round(0.018 + 0.036 * group, 6)
        yield Reading(time_s, "arm", 1, 1 + group / 7, 0.1, 40.0, 0.2, group=group)


@pytest.mark.parametrize("suffix", ["mcap", "parquet"])
def test_export_refuses_changed_bytes_or_gives_the_same_readings(tmp_path, suffix):
    """A bit that a disk has changed must not become another force."""
    pytest.importorskip({"mcap": "mcap_ros2", "parquet": "pyarrow"}[suffix])
    path, out = tmp_path / f"a.{suffix}", tmp_path / "out.csv"
    with McapWriter(path) if suffix == "mcap" else open_writer(path) as writer:
        for reading in readings():
            writer.write(reading)
    whole = path.read_bytes()
    assert run_command("export", path, "-o", out).returncode == 0
    expected = out.read_text()
    refused = 0
    for place in np.linspace(10, len(whole) - 10, 25).astype(int):
        damaged = bytearray(whole)
        damaged[place] ^= 0xFF
        path.write_bytes(damaged)
        out.unlink(missing_ok=True)
        done = run_command("export", path, "-o", out)
        assert done.returncode in (0, 2) and done.stderr.count("\n") == 1, done.stderr
        refused += done.returncode == 2
        assert not out.exists() if done.returncode else out.read_text() == expected
    assert refused > 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"time_s": 1, "sensor": ["x"]}\n', "sensor must be a text"),
        ('{"time_s": NaN, "sensor": "arm"}\n', "time_s and sensor must be given"),
        ('{"time_s": 1e999, "sensor": "arm"}\n', "time_s must be finite"),
        ('{"time_s": 1, "sensor": "arm", "touch": 0.7}\n', "touch must be an integer"),
        ('{"time_s": 1, "sensor": "arm", "touch": 7}\n', "touch must be 0, 1 or empty"),
        ('{"time_s": -5, "sensor": "arm"}\n', "cannot be converted to mcap"),
        ("[" * 100_000, "is not JSON"),
        ("\udcff", "is not UTF-8"),
    ],
)
def test_export_malformed_row_is_named_in_one_line(tmp_path, text, message):
    pytest.importorskip("mcap_ros2")
    path, out = tmp_path / "a.jsonl", tmp_path / "a.mcap"
    path.write_bytes(text.encode(errors="surrogateescape"))
    done = run_command("export", path, "-o", out)
    assert done.returncode == 2 and message in done.stderr, done.stderr
    assert done.stderr.count("\n") == 1 and [file.name for file in tmp_path.iterdir()] == [
        path.name
    ]


def test_export_accepts_integers_as_pandas_writes_them(tmp_path):
    """Columns with empty fields become 1.0 when a file is read and written by pandas."""
    path = tmp_path / "a.csv"
    path.write_text("time_s,sensor,touch,force_n,group\n1,arm,1.0,nan,3.0\n")
    assert run_command("export", path, "--to", "json").returncode == 0
    row = json.loads((tmp_path / "a.jsonl").read_text())
    assert (row["touch"], row["force_n"], row["group"]) == (1, None, 3)


def test_score_offset_of_a_gauge_with_unix_times_is_as_exact_as_of_small_ones(tmp_path):
    """Most loggers write seconds since 1970, where the offset was not refined."""
    times = 0.018 + 0.036 * np.arange(200)
    force = np.where((times > 2) & (times < 4), times, 0.0)
    rows = [f"{t},arm,{int(f > 0)},{f},0.1,40,," for t, f in zip(times, force, strict=True)]
    head = "time_s,sensor,touch,force_n,force_std_n,location_mm,flags,group"
    (tmp_path / "a.csv").write_text("\n".join([head, *rows]) + "\n")
    fine = np.arange(0, 7.2, 0.004)
    shown = np.where((fine > 2) & (fine < 4), fine, 0.0)
    for start in (0.0, 1.7e9):
        lines = [f"{start + t - 0.007:.6f},{f}" for t, f in zip(fine, shown, strict=True)]
        (tmp_path / "g.csv").write_text("\n".join(["time_s,force_n", *lines]) + "\n")
        done = run_command("score", tmp_path / "a.csv", "--against", tmp_path / "g.csv", "--json")
        assert done.returncode == 0, done.stderr
        assert abs(json.loads(done.stdout)["offset_s"] - start + 0.007) < 0.005


@pytest.mark.parametrize("text", ["time_s,force_n\n", "time_s,force_n\n1,0\n1,2\n"])
def test_score_gauge_without_time_span_is_refused(tmp_path, text):
    with open_writer(tmp_path / "a.csv") as writer:
        for reading in readings(50):
            writer.write(reading)
    (tmp_path / "g.csv").write_text(text)
    done = run_command("score", tmp_path / "a.csv", "--against", tmp_path / "g.csv")
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert "g.csv: " in done.stderr
