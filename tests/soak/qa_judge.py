# SPDX-License-Identifier: GPL-3.0-or-later
"""The soak test: its judge finds what the reader never does; a minute of it finds nothing."""

import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from judge import Judge
from loops import RATE_HZ
from world import LOST, Run

GROUP = 200_000  # samples, 0.16 s
GROUPS = 40
UTC_S = 1.8e9


class OneLoop:
    """A press of 4 N at 40 mm in the second half of a loop of 20 groups."""

    length, onset_n, loops = 20 * GROUP, 0.5, [None]

    def truth(self, loop, position):
        pressed = np.asarray(position) >= self.length // 2
        return np.where(pressed, 4.0, 0.0), np.where(pressed, 40.0, np.nan)


def played(lost=()):
    """A run of the loop, with some of its groups lost."""
    run = Run(begun_s=0.0)
    for group in range(GROUPS):
        at = group * GROUP
        run.total = at
        run.note(LOST if group in lost else 0, 0 if group in lost else at % OneLoop.length)
        run.gaps += group in lost
    run.total = GROUPS * GROUP
    run.utc.append((0, UTC_S))
    run.status = 0
    return run


def rows_of(lost=()):
    """Readings without a fault."""
    group = np.arange(GROUPS)
    time_s = (group + 0.5) * GROUP / RATE_HZ
    pressed = group % 20 >= 10
    absent, edge = np.isin(group, lost), np.isin(group % 20, (9, 10, 19, 0))
    return pd.DataFrame(
        {
            "run": "a",
            "time_s": time_s,
            "time_utc": pd.to_datetime(time_s + UTC_S, unit="s", utc=True).strftime(
                "%Y-%m-%dT%H:%M:%S.%fZ"
            ),
            "touch": np.where(absent, np.nan, pressed),
            "force_n": np.where(pressed & ~absent, 4.0, np.nan),
            "force_std_n": np.where(pressed & ~absent, 0.05, np.nan),
            "location_mm": np.where(pressed & ~absent, 40.0, np.nan),
            "location_std_mm": np.where(pressed & ~absent, 0.1, np.nan),
            "flags": np.select([absent, edge], ["gap", "transition"], ""),
            "group": group,
        }
    )


def problems_of(tmp_path, rows, lost=()):
    rows.to_csv(tmp_path / "readings.csv", index=False)
    world = SimpleNamespace(loops=OneLoop(), group=GROUP, runs={"a": played(lost)})
    judge = Judge(tmp_path / "readings.csv", world)
    judge.read_all()
    return judge.problems


@pytest.mark.parametrize("lost", [(), (5, 14)])
def test_readings_without_a_fault_are_no_problem(tmp_path, lost):
    assert problems_of(tmp_path, rows_of(lost), lost) == []


@pytest.mark.parametrize(
    ("column", "value", "problem"),
    [
        ("force_n", 4.6, "wrong without a flag"),
        ("location_mm", 41.2, "wrong without a flag"),
        ("touch", 0, "wrong without a flag"),
        ("flags", "gap", "received, but flagged gap"),
        ("time_utc", "2001-01-01T00:00:00.000000Z", "wrong time_utc"),
    ],
)
def test_one_fault_in_a_reading_is_a_problem(tmp_path, column, value, problem):
    rows = rows_of()
    rows.loc[15, column] = value
    (found,) = problems_of(tmp_path, rows)
    assert problem in found and "'group': 15" in found


def test_a_wrong_force_with_a_flag_or_a_large_deviation_is_no_problem(tmp_path):
    rows = rows_of()
    rows.loc[[14, 15], "force_n"] = 6.0
    rows.loc[14, "flags"], rows.loc[15, "force_std_n"] = "weak", 1.0
    assert problems_of(tmp_path, rows) == []


def test_a_loss_that_is_not_flagged_is_a_problem(tmp_path):
    found = problems_of(tmp_path, rows_of(), lost=(5, 6, 7))
    assert any("lost, but not flagged gap" in each and "'group': 6" in each for each in found)


@pytest.mark.parametrize("drop", [15, 0])
def test_a_group_that_is_missing_is_a_problem(tmp_path, drop):
    assert "follows by 2" in problems_of(tmp_path, rows_of().drop(index=drop))[0]


def test_readings_that_end_early_are_a_problem(tmp_path):
    assert problems_of(tmp_path, rows_of()[:30]) == ["run a: 30 groups instead of 40"]


@pytest.mark.long
@pytest.mark.timeout(300)
def test_live_reader_with_whatever_happens_to_it_is_right_or_says_that_it_is_not():
    """A robot acts on readings without a flag, and on the state; nobody looks for weeks."""
    command = [sys.executable, Path(__file__).with_name("run.py"), "--short", "--loops", "1"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "device lost and found 1 times" in done.stdout and "\n0 problems" in done.stdout
    # It has compared something.
    assert int(re.search(r"'unflagged touched': (\d+)", done.stdout)[1]) > 30
    assert int(re.search(r"(\d+) checks", done.stdout)[1]) >= 10
