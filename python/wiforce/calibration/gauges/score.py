# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of one sensor scored against the record of a force gauge."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...errors import InputError
from ...io.files.readings_files import ReadingsFile, frame_rows
from .comparison import GaugeComparison, TimedForces, compare_with_gauge
from .file import GaugeRecord, gauge_of, read_gauge_file

if TYPE_CHECKING:
    import pandas


def score(
    readings: pandas.DataFrame | str | Path,
    gauge: GaugeRecord | pandas.DataFrame | str | Path,
    *,
    sensor: str | Sequence[str] | None = None,
    touch_n: float = 0.5,
    offset_s: float | None = None,
) -> GaugeComparison:
    """Compare readings with the record of a force gauge or load cell.

    Parameters
    ----------
    readings : DataFrame, or str or Path
        As :func:`read` returns them, or a file of readings.
    gauge : str or Path, DataFrame, or GaugeRecord
        CSV file or frame with columns of times and forces, which are recognised by their names
        (``read_gauge_file`` takes others). It may have any clock, zero and sign.
    sensor : str or sequence of str, optional
        Name of the one that was pressed, where there are several; or the names of those that the
        gauge bears together, whose forces are added.
    touch_n : float
        Force in N from which the gauge shows a press that the sensor must read.
    offset_s : float, optional
        Time of the gauge at time 0 of the readings; estimated from the presses by default.

    Returns
    -------
    GaugeComparison
        ``print`` shows it as ``gr-wiforce score`` does.

    Raises
    ------
    InputError
        (A ValueError) when a file or column is missing or broken, when there are several sensors
        or runs, and as :func:`compare_with_gauge`.

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> files = wiforce.simulate("tabletop", "press")
    >>> found = wiforce.score(wiforce.read("press"), "press.truth.csv")
    >>> bool(abs(found.offset_s) < 0.01), bool(abs(found.error_n).mean() < 0.3)
    (True, True)
    """
    rows: Sequence[Mapping[str, Any]]
    if isinstance(readings, str | Path):
        file = ReadingsFile(readings)
        rows = list(file.rows())
        if file.note:
            warnings.warn(f"{readings}: {file.note}", stacklevel=2)
    elif hasattr(readings, "to_dict"):
        rows = frame_rows(readings)
    else:
        raise InputError("readings", "must be a pandas frame or a file of readings", readings)
    if isinstance(gauge, GaugeRecord):
        record = gauge
    elif isinstance(gauge, str | Path):
        record = read_gauge_file(gauge)
    elif hasattr(gauge, "to_dict"):
        record = gauge_of("gauge", gauge)
    else:
        rule = "must be a CSV file, a pandas frame or a GaugeRecord"
        raise InputError("gauge", rule, type(gauge).__name__)
    return compare_with_gauge(timed_forces(rows, sensor), record, touch_n, offset_s)


def timed_forces(
    rows: Sequence[Mapping[str, Any]], sensor: str | Sequence[str] | None = None
) -> TimedForces:
    """Forces of one sensor, or the sum of those named, with independent errors, from rows."""
    for name in ("time_s", "sensor", "touch", "force_n", "force_std_n", "flags"):
        if len(rows) and name not in rows[0]:
            raise InputError("readings", f"must have the column {name}")
    names = sorted({row["sensor"] for row in rows})
    if not names:
        raise InputError("readings", "holds no readings")
    wanted = names if sensor is None else [sensor] if isinstance(sensor, str) else [*sensor]
    if sensor is None and len(names) != 1:
        raise InputError("sensor", f"must be one of {', '.join(names)}, or several to be added")
    for name in wanted:
        if name not in names:
            raise InputError("sensor", f"must be one of {', '.join(names)}", name)
        if wanted.count(name) > 1:
            raise InputError("sensor", "must not be named twice", name)
    sensors = [_forces_of([row for row in rows if row["sensor"] == name]) for name in wanted]
    time_s = sensors[0].time_s
    if not all(np.array_equal(time_s, other.time_s) for other in sensors):
        raise InputError("readings", "must have the sensors that are added at the same times")
    return TimedForces(
        time_s,
        np.sum([each.force_n for each in sensors], axis=0),
        np.linalg.norm([np.where(s.touched, s.force_std_n, 0.0) for s in sensors], axis=0),
        np.any([each.touched for each in sensors], axis=0),
        np.all([each.clear for each in sensors], axis=0),
    )


def _forces_of(own: Sequence[Mapping[str, Any]]) -> TimedForces:
    times, touch, force, std = (
        np.array([row[name] for row in own], float)  # of None: NaN
        for name in ("time_s", "touch", "force_n", "force_std_n")
    )
    if not np.all(np.diff(times) > 0):
        first = times[1:][np.diff(times) <= 0][0]
        raise InputError("readings", "time_s must increase: score one run at a time", first)
    force = np.where(touch == 1, force, np.where(np.isfinite(touch), 0.0, np.nan))
    unflagged = np.array([not row["flags"] for row in own])
    return TimedForces(times, force, std, touch == 1, np.isfinite(force) & unflagged)
