# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensors and captures of one's own, or made by somebody else, through `calibrate` and `read`."""

import csv

import numpy as np
import pytest
from command_runs import run_command
from long_cases import cases
from second_simulator import write_case

# Phase rms in degrees, median force error in newtons, median location error in millimetres.
LIMITS = {
    "leaky": (0.06, 0.15, 0.2),
    "moving": (0.10, 0.15, 0.2),
    "faint": (1.0, 0.5, 0.5),
    "pair": (0.3, 0.2, 0.3),
}


def command(*arguments):
    done = run_command(*arguments)
    assert done.returncode == 0, done.stderr
    return done


def rows_of(path):
    with open(path, newline="") as stream:
        return list(csv.DictReader(stream))


def steady(truth, i):
    """Touched from before to after this group, force changing by less than 0.3 N a group."""
    if not 0 < i < len(truth) - 1:
        return False
    around = truth[i - 1 : i + 2]
    forces = [float(row["force_n"]) for row in around]
    return all(row["touch"] == "1" for row in around) and np.ptp(forces) < 0.6


@pytest.fixture(scope="module", params=cases("moving", long=("pair", "leaky", "faint")))
def outcome(request, tmp_path_factory):
    """A case simulated, calibrated and read; its readings and truth by sensor."""
    folder = tmp_path_factory.mktemp(request.param)
    write_case(request.param, folder)
    for table in folder.glob("*.csv"):
        if table.stem != "truth":
            command("calibrate", table, "-o", table.with_suffix(".yaml"))
    output = folder / "readings.csv"
    command("read", folder / "capture", "--scene", folder / "scene.yaml", "-o", output)
    readings, truth = rows_of(output), rows_of(folder / "truth.csv")
    sensors = {}
    for name in dict.fromkeys(row["sensor"] for row in truth):
        own = [row for row in truth if row["sensor"] == name]
        mine = {round(float(r["time_s"]), 4): r for r in readings if r["sensor"] == name}
        sensors[name] = [
            (mine[round(float(row["time_s"]), 4)], row, steady(own, i))
            for i, row in enumerate(own)
            if round(float(row["time_s"]), 4) in mine
        ]
    return request.param, sensors


def steady_pairs(pairs):
    return [(reading, truth) for reading, truth, is_steady in pairs if is_steady]


def unflagged(pairs):
    return [(reading, truth) for reading, truth in pairs if not reading["flags"]]


def test_phases_are_as_accurate_as_the_signal_allows(outcome):
    case, sensors = outcome
    for name, pairs in sensors.items():
        errors = [
            [float(reading[key]) - float(truth[key]) for key in ("phase1_deg", "phase2_deg")]
            for reading, truth in unflagged(steady_pairs(pairs))
        ]
        errors = (np.array(errors) + 180) % 360 - 180
        # The calibration's own untouched phases carry its noise; every reading shares it.
        errors -= untouched_error(pairs)
        rms = np.sqrt(np.mean(errors**2, axis=0))
        assert np.all(rms <= LIMITS[case][0]), (name, rms)


def untouched_error(pairs):
    """Median phase error while untouched, (2,)."""
    errors = [
        [float(reading[key]) - float(truth[key]) for key in ("phase1_deg", "phase2_deg")]
        for reading, truth, _ in pairs
        if reading["flags"] == "reference"
    ]
    return np.median((np.array(errors) + 180) % 360 - 180, axis=0)


def test_force_and_location_between_calibrated_points(outcome):
    case, sensors = outcome
    _, force_limit, location_limit = LIMITS[case]
    for name, pairs in sensors.items():
        errors = np.array(
            [
                [float(reading[key]) - float(truth[key]) for key in ("force_n", "location_mm")]
                for reading, truth in unflagged(steady_pairs(pairs))
            ]
        )
        force, location = np.median(np.abs(errors), axis=0)
        assert force <= force_limit and location <= location_limit, (name, force, location)


def test_steady_touches_carry_no_flag(outcome):
    _, sensors = outcome
    for name, pairs in sensors.items():
        touches = steady_pairs(pairs)
        assert len(touches) >= 20
        assert len(unflagged(touches)) >= 0.8 * len(touches), name


def test_no_touch_is_invented_and_none_is_missed(outcome):
    _, sensors = outcome
    for name, pairs in sensors.items():
        for reading, truth, is_steady in pairs:
            if is_steady:
                assert reading["touch"] == "1", (name, truth["time_s"])
            elif truth["touch"] == "0" and "transition" not in reading["flags"]:
                assert reading["touch"] == "0" and not reading["force_n"], (name, truth["time_s"])


def test_errors_stay_within_what_the_readings_say(outcome):
    _, sensors = outcome
    within = []
    for pairs in sensors.values():
        for reading, truth in unflagged(steady_pairs(pairs)):
            for key, std in (("force_n", "force_std_n"), ("location_mm", "location_std_mm")):
                within.append(
                    abs(float(reading[key]) - float(truth[key])) <= 2 * float(reading[std])
                )
    # Model error repeats from group to group, so that a few dozen groups are few independent ones.
    assert np.mean(within) >= 0.85
