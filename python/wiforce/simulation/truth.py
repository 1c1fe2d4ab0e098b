# SPDX-License-Identifier: GPL-3.0-or-later
"""Truth of simulated captures: groups, whole files, and readings that are scored against it."""

import csv
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..io.readings import Reading, rounded
from ..scene import Scene
from ..signal.carrier import wrap_deg
from .presses import PressedSensor, surface_truth

TRUTH_COLUMNS = (
    "time_s", "sensor", "touch", "force_n", "location_mm", "phase1_deg", "phase2_deg",
)  # fmt: skip


def frame_count(scene: Scene) -> int:
    """Number of whole sounding frames, or of packets on average, in the scene's duration."""
    return int(scene.simulation.duration_s / scene.snapshot_period_s + 1e-9)


def group_centers(scene: Scene) -> np.ndarray:
    """Centres of the whole phase groups of a scene's capture, in s from the first sample."""
    groups = frame_count(scene) // scene.phase_group.snapshots
    return (np.arange(groups) + 0.5) * scene.group_period_s


def truth_rows(scene: Scene) -> list[dict[str, Any]]:
    """The state at the centre of each phase group, a row per group and sensor.

    ``force_n`` also below the onset; surfaces have rows with x in ``location_mm``, and ``y_mm``.
    """
    times = group_centers(scene)
    states = [PressedSensor(scene, index).state(times) for index in range(len(scene.sensors))]
    of_surface = surface_truth(scene, times)
    rows: list[dict[str, Any]] = []
    for i, time_s in enumerate(times.tolist()):
        at = {"time_s": rounded("time_s", time_s)}
        for name, state in zip(scene.sensor_names, states, strict=True):
            numbers = (state.force_n[i], state.location_mm[i], *state.phases_deg[i])
            found = {k: rounded(k, x) for k, x in zip(TRUTH_COLUMNS[3:], numbers, strict=True)}
            rows.append({**at, "sensor": name, "touch": int(state.touch[i]), **found})
        for row in of_surface[i]:
            cells = {k: round(x, 4) if isinstance(x, float) else x for k, x in row.items()}
            rows.append({**at, **cells})
    return rows


def write_truth(scene: Scene, path: str | Path) -> None:
    """Write the truth of a scene's capture as CSV."""
    columns = TRUTH_COLUMNS if scene.surface is None else (*TRUTH_COLUMNS, "y_mm")
    with open(path, "w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(truth_rows(scene))


@contextmanager
def all_or_nothing(paths: Sequence[Path]) -> Iterator[list[Path]]:
    """Files that appear in order when all are complete, or not at all; temporary before that."""
    with tempfile.TemporaryDirectory(prefix=".simulate-", dir=paths[0].parent) as folder:
        temporary = [Path(folder) / path.name for path in paths]
        yield temporary
        for source, target in zip(temporary, paths, strict=True):
            os.replace(source, target)


@dataclass(frozen=True)
class Score:
    """Errors over the steady touched groups of one sensor, touched before and after as well.

    ``force_error_n``, ``location_error_mm`` (n,) and ``phase_error_deg`` (n, 2) of those read as
    touched; ``missed`` are not, ``false`` untouched groups are, without a flag.
    """

    sensor: str
    force_error_n: np.ndarray
    location_error_mm: np.ndarray
    phase_error_deg: np.ndarray
    flagged: int  # of those read as touched
    missed: int
    false: int

    @property
    def median_force_n(self) -> float:
        """Median absolute error of the force, in N."""
        return float(np.median(np.abs(self.force_error_n)))

    @property
    def median_location_mm(self) -> float:
        """Median absolute error of the location, in mm."""
        return float(np.median(np.abs(self.location_error_mm)))


def read_truth(path: str | Path) -> list[dict[str, Any]]:
    """Read the truth file of a simulated capture; numbers as float, empty cells as None."""
    with open(path, encoding="utf-8", newline="") as stream:
        return [
            {key: x if key == "sensor" else float(x) if x else None for key, x in row.items()}
            for row in csv.DictReader(stream)
        ]


def steady_rows(rows: Sequence[Mapping]) -> list[Mapping]:
    """Rows of one sensor's truth, in time, that are touched like the rows before and after."""
    rows = sorted(rows, key=lambda row: row["time_s"])
    return [
        row
        for before, row, after in zip(rows, rows[1:], rows[2:], strict=False)
        if before["touch"] == row["touch"] == after["touch"] == 1
    ]


def score(readings: Sequence[Reading], truth: Sequence[Mapping], sensor: str) -> Score:
    """Compare one sensor's readings with the rows of a truth file."""
    rows = {round(row["time_s"], 4): row for row in truth if row["sensor"] == sensor}
    own = [reading for reading in readings if reading.sensor == sensor]
    steady_times = {round(row["time_s"], 4) for row in steady_rows(list(rows.values()))}
    force, location, phase = [], [], []
    flagged = missed = false = 0
    for reading in own:
        time = round(reading.time_s, 4)
        row = rows.get(time)
        if row is None:
            continue
        if time not in steady_times:
            false += row["touch"] == 0 and reading.touch == 1 and not reading.flags
        elif reading.touch != 1 or reading.force_n is None or reading.location_mm is None:
            missed += 1
        else:
            flagged += bool(reading.flags)
            force.append(reading.force_n - row["force_n"])
            location.append(reading.location_mm - row["location_mm"])
            measured = np.array([reading.phase1_deg, reading.phase2_deg], float)
            phase.append(wrap_deg(measured - [row["phase1_deg"], row["phase2_deg"]]))
    errors = np.array(force), np.array(location), np.array(phase).reshape(-1, 2)
    return Score(sensor, *errors, flagged, missed, false)
