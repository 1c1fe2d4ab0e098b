# SPDX-License-Identifier: GPL-3.0-or-later
"""The accuracy benchmark: its rows, its arithmetic, its interface."""

import csv
import json
from pathlib import Path

import numpy as np
from command_runs import succeeded
from wiforce_app.bench import accuracy
from wiforce_app.bench.accuracy import Case, cases, run_case

SHORT = Case("short", 10.0, groups=12, estimators=("harmonic", "paper, offset removed"))


def test_runs_repeat_and_differ_from_one_another():
    first, again, other = (run_case(SHORT, run)["harmonic"] for run in (0, 0, 1))
    assert np.array_equal(first.errors_deg, again.errors_deg)
    assert not np.array_equal(first.errors_deg, other.errors_deg)
    assert first.errors_deg.shape == (12, 2) and first.unread == 0
    assert np.all(np.abs(first.errors_deg) < 6 * first.bound_deg)


def test_every_case_stands_in_the_documented_table():
    text = (Path(__file__).parents[3] / "docs" / "data" / "accuracy.csv").read_text()
    rows = csv.reader(text.splitlines())
    assert {case.name for case in cases(full=True)} <= {row[0] for row in rows}


def test_json_rows_have_the_documented_keys(monkeypatch, long_run):
    runs = 10 if long_run else 1
    monkeypatch.setattr(accuracy, "_QUICK_RUNS", runs)
    done = succeeded("bench", "accuracy", "--json", "--case", "N_g 63", "--jobs", 1)
    rows = json.loads(done.stdout)["rows"]
    assert [row["estimator"] for row in rows] == [
        "harmonic", "sideband", "paper", "paper, offset removed",
    ]  # fmt: skip
    keys = {"case", "estimator", "rms_deg", "bound_deg", "loss_db", "within_2_std", "n"}
    assert all(keys <= set(row) and row["n"] == 100 * runs for row in rows)
    assert max(rows[0]["loss_db"]) < 1.5 < min(rows[2]["loss_db"])
