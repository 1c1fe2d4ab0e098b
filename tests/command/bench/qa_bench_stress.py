# SPDX-License-Identifier: GPL-3.0-or-later
"""Numerical extremes: cases that the stress benchmark found.

Limits are those of the project; `gr-wiforce bench stress` covers every path.
"""

import json

import numpy as np
import pytest
from command_runs import run_command
from gnuradio.wiforce.errors import InputError
from wiforce_app.bench import stress
from wiforce_app.bench.stress import read_case
from wiforce_app.shell.tables import table

# All rows but those of the JSON test and of clutter between others.
LEFT_OUT = [f"static clutter +{db} dB" for db in (40, 60, 80)]
ROWS = [
    pytest.param(task, id=f"{task.name}-{task.path}")
    for task in stress.tasks()
    if task.name not in LEFT_OUT
]
# Groups that a stress may cost: those that are hurt, or read before a clock is acquired again.
DISCARDED = {"samples that are not": 1, "level 10^4 times up": 6, "a week between": 8}


def case(**changes):
    return stress.quiet_case("stress", **{"groups": 4, **changes})


@pytest.mark.parametrize("task", ROWS)
def test_row_is_within_its_limit_and_hides_nothing(task):
    row = task.row()
    assert row["good"]
    allowed = (n for start, n in DISCARDED.items() if task.name.startswith(start))
    assert row["worst"] > 0 and row["discarded"] <= next(allowed, 0)


@pytest.mark.parametrize("gamma_db", [20.0, 60.0, 140.0])
def test_clock_after_a_week_without_samples_is_acquired_again(gamma_db):
    made = case(gamma_db=gamma_db, groups=20)
    path = "file-fc32" if gamma_db == 60 else "double"
    errors, std, unread = read_case(made, path, pause=stress.WEEK_GROUPS)
    # until then there are no readings
    assert 5 <= len(errors) and unread == 20 - len(errors)
    values = stress.values_of(errors, std, unread)
    assert values["undetected"] == 0 and np.all(std[-2:] < 0.2)
    if gamma_db >= 60:
        assert values["worst"] <= 0.01


@pytest.mark.parametrize("second_hz", [1000.3, 998.32, 1001.5, 1500.0, 2003.0, 500.7])
def test_clocks_without_own_lines_are_refused(second_hz):
    """Half a turn of a clock would swap its ends: 60 deg off, stated as half a degree."""
    with pytest.raises(InputError, match="clocks?_hz"):
        read_case(case(clocks_hz=(1000.0, second_hz), levels_db=(0.0, 0.0)))


def test_stress_json_holds_every_path():
    done = run_command("bench", "stress", "--json", "--only", "clutter +60")
    assert (done.returncode, done.stderr) == (0, "")
    rows = json.loads(done.stdout)["rows"]
    assert [row["path"] for row in rows] == ["double", *stress._BLOCKS]
    assert all(row["good"] and row["limit"] == 0.02 for row in rows)
    _, _, *lines = table(rows, stress.COLUMNS).splitlines()
    assert [line.split("|")[2].strip() for line in lines] == [row["path"] for row in rows]
