# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings against the truth of a simulated capture."""

import csv
from dataclasses import dataclass

import numpy as np

from ..signal.carrier import wrap_deg


@dataclass(frozen=True)
class Score:
    """Errors over the steady touched groups of one sensor.

    A group is steady when truth and reading say touched and neither the group nor a neighbour is
    one in which the true touch changes.

    Attributes
    ----------
    sensor : str
    force_error_n, location_error_mm : ndarray, shape (n,)
        Reading minus truth.
    phase_error_deg : ndarray, shape (n, 2)
    flagged : int
        Steady groups that carry a flag.
    missed, false : int
        Groups touched in truth but not read as such, and the other way round, beside steady ones.
    """

    sensor: str
    force_error_n: np.ndarray
    location_error_mm: np.ndarray
    phase_error_deg: np.ndarray
    flagged: int
    missed: int
    false: int

    @property
    def median_force_n(self):
        return float(np.median(np.abs(self.force_error_n)))

    @property
    def median_location_mm(self):
        return float(np.median(np.abs(self.location_error_mm)))

    @property
    def phase_rms_deg(self):
        """Root mean square phase error of both ends; shape (2,)."""
        return np.sqrt(np.mean(self.phase_error_deg**2, axis=0))


def read_truth(path):
    """Rows of a simulated capture's truth file, numbers parsed, empty cells as None."""
    with open(path, encoding="utf-8", newline="") as stream:
        return [
            {key: value if key == "sensor" else _number(value) for key, value in row.items()}
            for row in csv.DictReader(stream)
        ]


def _number(cell):
    return float(cell) if cell else None


def score(readings, truth, sensor):
    """Scores one sensor's readings.

    Parameters
    ----------
    readings : sequence of Reading
    truth : sequence of dict
        Rows of a truth file, numbers parsed (see :func:`read_truth`).
    sensor : str

    Returns
    -------
    Score
    """
    rows = {round(row["time_s"], 4): row for row in truth if row["sensor"] == sensor}
    own = [reading for reading in readings if reading.sensor == sensor]
    touches = {time: row["touch"] for time, row in rows.items()}
    times = sorted(rows)
    steady_times = {
        times[i]
        for i in range(1, len(times) - 1)
        if touches[times[i - 1]] == touches[times[i]] == touches[times[i + 1]] == 1
    }
    force, location, phase = [], [], []
    flagged = missed = false = 0
    for reading in own:
        time = round(reading.time_s, 4)
        if time not in rows:
            continue
        row = rows[time]
        if time in steady_times:
            if reading.touch != 1 or reading.force_n is None:
                missed += 1
                continue
            flagged += bool(reading.flags)
            force.append(reading.force_n - row["force_n"])
            location.append(reading.location_mm - row["location_mm"])
            measured = np.array([reading.phase1_deg, reading.phase2_deg])
            phase.append(wrap_deg(measured - [row["phase1_deg"], row["phase2_deg"]]))
        elif row["touch"] == 0 and reading.touch == 1 and not reading.flags:
            false += 1
    return Score(
        sensor,
        np.array(force),
        np.array(location),
        np.array(phase).reshape(-1, 2),
        flagged,
        missed,
        false,
    )
