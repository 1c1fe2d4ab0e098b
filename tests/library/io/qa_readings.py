# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings, their flags and their files: what a script that parses them relies on."""

import csv
import json
import os
from concurrent.futures import ThreadPoolExecutor

import pytest
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.files.writers import open_writer
from gnuradio.wiforce.io.readings import COLUMNS, Flag, GroupCounts, Reading

TOUCHED = Reading(0.018, "arm", 1, 4.123456, 0.05, 45.0, 0.1, 91.5, -12.25, 9.876, ("gap", "weak"))
UNKNOWN = Reading(0.054, "arm", None, None, None, None, None, None, None, None, ("gap",))


def test_columns_equal_documented_order():
    assert ",".join(COLUMNS) == (
        "time_s,sensor,touch,force_n,force_std_n,location_mm,location_std_mm,"
        "phase1_deg,phase2_deg,snr_db,flags,group,interference"
    )


def test_flag_words_equal_documented_order():
    """Scripts look for these words; their order in a cell is that of the documentation."""
    documented = (
        "reference gap transition weak ambiguous force-unobservable inconsistent extrapolated "
        "moved saturated"
    )
    assert " ".join(flag.word for flag in Flag) == documented
    assert Flag(2 ** len(Flag) - 1).words == tuple(documented.split())
    assert Flag(0).words == ()


def test_csv_writer_unknown_values_are_empty_and_rows_flushed(tmp_path):
    path = tmp_path / "out.csv"
    writer = open_writer(path)
    writer.write(TOUCHED)
    writer.write(UNKNOWN)
    with open(path, newline="") as stream:
        rows = list(csv.DictReader(stream))
    writer.close()
    assert rows[0]["force_n"] == "4.1235" and rows[0]["flags"] == "gap weak"
    assert rows[0]["touch"] == "1" and rows[0]["snr_db"] == "9.88"
    assert rows[1]["touch"] == "" and rows[1]["force_n"] == ""


def test_json_writer_unknown_values_are_null(tmp_path):
    path = tmp_path / "out.jsonl"
    writer = open_writer(path)
    writer.write(Reading(0.018, "arm", 1, float("nan"), snr_db=float("-inf")))
    writer.close()
    row = json.loads(path.read_text())
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


def test_writer_closed_without_reading_leaves_header_only(earlier):
    with open_writer(earlier):
        pass
    assert earlier.read_text() == ",".join(COLUMNS) + "\n"


def test_writer_failing_after_begin_leaves_header_only(earlier):
    with pytest.raises(InputError), open_writer(earlier) as writer:
        assert writer.begin() is writer
        raise InputError("a device", "is lost")
    assert earlier.read_text() == ",".join(COLUMNS) + "\n"


def test_writer_pipe_is_opened_at_once(tmp_path):
    pipe = tmp_path / "out.csv"
    os.mkfifo(pipe)
    with ThreadPoolExecutor(1) as pool:
        listener = pool.submit(pipe.open)
        writer = open_writer(pipe)
        with listener.result(timeout=60) as stream:
            writer.close()
            assert stream.read() == ",".join(COLUMNS) + "\n"


@pytest.mark.parametrize("name", ["out.txt", "out", "missing/out.csv", "x" * 300 + "out.csv"])
def test_open_writer_unusable_path_is_named(tmp_path, name):
    with pytest.raises(InputError, match="out"):
        open_writer(tmp_path / name)


def test_group_counts_name_groups_with_interference():
    """What `read` prints at the end tells that other transmitters are in the room."""
    counts = GroupCounts()
    counts.note([Reading(0.018, "arm", interference=0.0)])
    assert str(counts) == "1 group: 1 usable"
    counts.note([Reading(0.054, "arm", interference=0.25)])
    assert str(counts).startswith(
        "2 groups: 2 usable; 1 group (50%) lacked snapshots hit by another"
    )
    assert Reading(0.054, "arm", interference=0.25).row()["interference"] == 0.25


def test_group_counts_name_saturation_first():
    """Nobody pressed: the summary of a receiver that clipped spoke of 70 groups of presses."""
    counts = GroupCounts()
    counts.note([Reading(0.018, "arm", flags=("saturated", "transition"))])
    counts.note([Reading(0.054, "arm", flags=("saturated", "reference"))])
    assert str(counts) == "2 groups: 0 usable, 2 doubtful (2 saturated)"
