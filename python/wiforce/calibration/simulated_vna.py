# SPDX-License-Identifier: GPL-3.0-or-later
"""Simulation of a VNA that measures a sensor's calibration table."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..sensor.model import SensorModel
from .tables import CalibrationTable


def measure_vna(
    model: SensorModel,
    location_mm: Sequence[float] | np.ndarray,
    force_n: Sequence[float] | np.ndarray,
    noise_deg: float = 0.0,
    seed: int = 1,
    untouched_sweeps: int = 10,
) -> CalibrationTable:
    """Simulate the table that a VNA would measure.

    Parameters
    ----------
    model : SensorModel
        The sensor on the bench.
    location_mm, force_n : sequence of float
        Every force in N at every location in mm; untouched rows come first.
    noise_deg : float
        Standard deviation of the phases, in degrees.
    seed : int
        Of the noise.
    untouched_sweeps : int
        Rows of the untouched sensor per port; their noise is common to all readings.

    Returns
    -------
    CalibrationTable

    Examples
    --------
    >>> from gnuradio.wiforce.sensor import load_sensor
    >>> table = measure_vna(load_sensor("line-900mhz"), [30.0, 50.0], [1.0, 2.0, 4.0])
    >>> len(table.row)  # 2 ports: 10 untouched rows and 2 x 3 presses
    32
    """
    rng = np.random.default_rng(seed)
    rows: list[tuple] = []
    for frequency in model.frequencies_hz:
        for port, phase in enumerate(model.untouched_deg(frequency), 1):
            rows += [(0, frequency, math.nan, port, 0.0, phase, "")] * untouched_sweeps
        for location in location_mm:
            phases = model.phases_deg(force_n, location, frequency)
            for port in (1, 2):
                for force, phase in zip(force_n, phases[:, port - 1], strict=True):
                    rows.append((0, frequency, location, port, force, phase, ""))
    table = CalibrationTable.from_rows(f"evaluated {model.name}", rows)
    noisy = table.phase_deg + noise_deg * rng.standard_normal(table.phase_deg.size)
    return replace(table, row=np.arange(2, table.row.size + 2), phase_deg=noisy)
