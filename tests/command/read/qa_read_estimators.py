# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures read with another estimator, and captures that no estimator can read."""

import csv

import pytest
import yaml
from command_runs import run_command


def run(*arguments):
    done = run_command(*arguments)
    assert done.returncode == 0, done.stderr
    return done


def readings(folder, phase_group=None, **tag):
    """Rows read from a capture with one press from .6 s on, simulated in ``folder``."""
    press = {
        "start_s": 0.6, "rise_s": 0.03, "hold_s": 0.5, "force_n": 4.0, "location_mm": 40.0,
    }  # fmt: skip
    simulation = {"duration_s": 1.1, "snr_db": 15, "static_clutter_db": 50, "presses": [press]}
    scene = {
        "sensors": [{"name": "arm", "model": "line-900mhz"}],
        "reference_s": 0.3,
        "phase_group": phase_group or {},
        "simulation": simulation | tag,
    }
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(scene))
    run("simulate", path, folder / "air")
    return list(csv.DictReader(run("read", folder / "air", "--scene", path).stdout.splitlines()))


def test_read_overlapping_pulses_are_flagged_and_not_read(tmp_path):
    rows = readings(tmp_path, tags=[{"sensor": "arm", "clock2_duty": "overlapping"}])
    assert len(rows) == 30
    assert all(set(row["flags"].split()) <= {"inconsistent", "reference"} for row in rows)
    assert all("inconsistent" in row["flags"] for row in rows)
    assert all(row["touch"] == row["force_n"] == row["phase1_deg"] == "" for row in rows)


@pytest.mark.parametrize("estimator", ["paper", "sideband"])
def test_read_scene_with_another_estimator_finds_the_press(tmp_path, estimator):
    """With an exact clock and a still scene the paper's own reads the press as well.

    At 40 mm no end turns by more than 90 deg, beyond which half the angle is ambiguous.
    """
    rows = readings(tmp_path, {"estimator": estimator}, clock_offset_ppm=0, clock_drift_ppm_per_s=0)
    held = [row for row in rows if 0.72 < float(row["time_s"]) < 1.0]
    assert len(held) == 8 and all(row["touch"] == "1" for row in held)
    assert all(abs(float(row["location_mm"]) - 40) < 0.5 for row in held)
    untouched = [row for row in rows if float(row["time_s"]) < 0.55]
    assert all(row["touch"] == "0" for row in untouched)
