# SPDX-License-Identifier: GPL-3.0-or-later
"""The accuracy benchmark: its rows, its arithmetic, its interface."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from command_runs import run_command
from gnuradio.wiforce.planning.room.report import NOISE_WEIGHTS, UNLISTED_TAGS
from wiforce_app.bench import accuracy
from wiforce_app.bench.accuracy import RoomCase, room_cases, room_table
from wiforce_app.bench.cases import Case, cases, run_case

SHORT = Case("short", 10.0, groups=12, estimators=("harmonic", "paper, offset removed"))


def test_runs_repeat_and_differ_from_one_another():
    first, again, other = (run_case(SHORT, run)["harmonic"] for run in (0, 0, 1))
    assert np.array_equal(first.errors_deg, again.errors_deg)
    assert not np.array_equal(first.errors_deg, other.errors_deg)
    assert first.errors_deg.shape == (12, 2) and first.unread == 0
    assert np.all(np.abs(first.errors_deg) < 6 * first.bound_deg)


def test_every_case_stands_in_the_documented_table():
    data = Path(__file__).parents[3] / "docs" / "data"
    texts = [(data / name).read_text() for name in ("accuracy.csv", "rooms_survey.csv")]
    rows = [row for text in texts for row in csv.reader(text.splitlines())]
    names = {case.name for case in [*cases(full=True), *room_cases()]}
    assert names <= {row[0] for row in rows}


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A short scene with a neighbour's tag that it does not list, read twice."""
    path = tmp_path_factory.mktemp("room") / "short.yaml"
    press = {"start_s": 0.45, "hold_s": 0.5, "rise_s": 0.03, "force_n": 4.0, "location_mm": 36.0}
    other = {"clock_hz": 1730, "level_db": -5, "delay_s": 20e-9}
    scene = {
        "sensors": [{"name": "arm", "model": "line-900mhz-calibrated", "clock_hz": 1035}],
        "reference_s": 0.4,
        "simulation": {
            "truth_model": "line-900mhz", "duration_s": 1.1, "other_tags": [other],
            "presses": [press],
        },
    }  # fmt: skip
    path.write_text(yaml.safe_dump(scene))
    case = RoomCase(str(path), 1)
    found = case.run(0, seed=1)
    return [case.summarise(name, [found[name]]) for name in case.estimators]


def test_room_row_compares_readings_with_and_without_survey(room):
    """The survey must show what it gains, or nobody knows whether a room needs it."""
    surveyed, plain = room
    # Thirteen readings share one reference, so that the loss scatters by some decibels.
    assert max(surveyed["loss_db"]) < 5 and max(plain["loss_db"]) > 10, (surveyed, plain)
    assert surveyed["n"] == plain["n"] >= 12 and surveyed["wrong"] == 0
    assert surveyed["seconds_per_second"] > plain["seconds_per_second"] > 0


def test_room_row_states_what_survey_added_and_skipped(room):
    surveyed, plain = room
    assert surveyed["added"] == ["adds the tag"] and UNLISTED_TAGS not in surveyed["skipped"]
    assert plain["added"] == [] and UNLISTED_TAGS in plain["skipped"]
    text = room_table(room)
    assert "added: adds the tag" in text and f"skipped: {NOISE_WEIGHTS}" in text


def test_json_rows_have_the_documented_keys(monkeypatch, long_run):
    runs = 10 if long_run else 2
    monkeypatch.setattr(accuracy, "_QUICK_RUNS", runs)
    done = run_command("bench", "accuracy", "--json", "--case", "N_g 63", "--jobs", 1)
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)["rows"]
    assert [row["estimator"] for row in rows] == [
        "harmonic", "sideband", "paper", "paper, offset removed",
    ]  # fmt: skip
    keys = {"case", "estimator", "rms_deg", "bias_deg", "bound_deg", "loss_db"}
    keys |= {"loss_interval_db", "seconds_per_second", "n"}
    assert all(keys <= set(row) and row["n"] == 100 * runs for row in rows)
    assert max(rows[0]["loss_db"]) < 1.5 < min(rows[2]["loss_db"])
