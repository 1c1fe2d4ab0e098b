# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensors and captures of one's own, or made by somebody else, through `calibrate` and `read`."""

import csv

import pytest
from command_runs import run_command
from long_cases import cases
from rooms.judge import failures, judge
from rooms.rooms import Room
from second_simulator import write_case

# Phase rms in degrees, median force error in newtons, median location error in millimetres.
LIMITS = {
    "leaky": (0.06, 0.15, 0.2),
    "moving": (0.10, 0.15, 0.2),
    "faint": (1.0, 0.5, 0.5),
    "pair": (0.3, 0.2, 0.3),
}


@pytest.mark.parametrize("name", cases("moving", long=("pair", "leaky", "faint")))
def test_capture_of_somebody_else_is_read_within_its_limits(name, tmp_path):
    """Phases, force, location and their deviations; no touch is invented, missed or flagged."""
    case, (phase_deg, force_n, location_mm) = write_case(name, tmp_path), LIMITS[name]
    for tag in case.tags:
        table = tmp_path / f"{tag.name}.csv"
        assert run_command("calibrate", table, "-o", table.with_suffix(".yaml")).returncode == 0
    output = tmp_path / "readings.csv"
    capture, scene = tmp_path / "capture", tmp_path / "scene.yaml"
    assert run_command("read", capture, "--scene", scene, "-o", output).returncode == 0
    with open(output, newline="") as stream:
        rows = list(csv.DictReader(stream))
    for tag in case.tags:
        room = Room(phase_deg=phase_deg, force_n=force_n, presses=tag.presses)
        figures = judge(room, [row for row in rows if row["sensor"] == tag.name]).summary()
        assert figures["steady"] >= 20 and failures(room, figures) == []
        assert figures["location_median_mm"] <= location_mm
        assert figures["location_within_2"] >= 0.85
