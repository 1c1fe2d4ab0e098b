# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings scored against a force gauge: offset in time, zero, and errors."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import minimize_scalar
from scipy.signal import correlate, correlation_lags

from ..errors import InputError
from ..io.files.readings_files import ReadingsFile, frame_rows
from .gauges import GaugeRecord, read_gauge

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class TimedForces:
    """Readings of one sensor (n,), by centres of groups; force 0 untouched, NaN unknown."""

    time_s: np.ndarray
    force_n: np.ndarray
    force_std_n: np.ndarray
    touched: np.ndarray
    clear: np.ndarray

    @property
    def period_s(self) -> float:
        """Time between two readings, over which each is an average."""
        return float(np.median(np.diff(self.time_s)))


@dataclass(frozen=True)
class GaugeComparison:
    """Errors of readings against a gauge.

    ``offset_s`` is the gauge's time at time 0 of the readings, its deviation by jackknife, 0 if
    given; ``other_offset_s`` fits nearly as well. ``sign`` and ``zero_n`` are the gauge's. Steady
    touched readings (m,) without flag are compared; steady groups may be ``flagged``, ``missed``,
    ``false`` or ``unrecorded`` instead.
    """

    offset_s: float
    offset_std_s: float
    other_offset_s: float | None
    correlation: float
    sign: int
    zero_n: float
    time_s: np.ndarray
    force_n: np.ndarray
    force_std_n: np.ndarray
    gauge_n: np.ndarray
    flagged: int
    missed: int
    false: int
    unrecorded: int

    @property
    def error_n(self) -> np.ndarray:
        """Reading minus gauge, in N."""
        return self.force_n - self.gauge_n

    @property
    def coverage(self) -> float:
        """Share of errors within two of the readings' standard deviations."""
        return float(np.mean(np.abs(self.error_n) <= 2 * self.force_std_n))

    @property
    def gain(self) -> float:
        """Force of the readings per force of the gauge, by least squares through zero."""
        return float(self.force_n @ self.gauge_n / (self.gauge_n @ self.gauge_n))

    def report(self) -> dict[str, Any]:
        """Plain values, rounded to what they mean."""
        error = np.abs(self.error_n)
        return {
            "offset_s": round(self.offset_s, 4),
            "offset_std_s": round(self.offset_std_s, 4),
            "other_offset_s": self.other_offset_s,
            "correlation": round(self.correlation, 4),
            "gauge_sign": self.sign,
            "gauge_zero_n": round(self.zero_n, 4),
            "compared": len(error),
            "median_error_n": round(float(np.median(error)), 4),
            "rms_error_n": round(float(np.sqrt(np.mean(error**2))), 4),
            "p90_error_n": round(float(np.quantile(error, 0.9)), 4),
            "bias_n": round(float(np.mean(self.error_n)), 4),
            "gain": round(self.gain, 4),
            "within_2_std": round(self.coverage, 4),
            "flagged": self.flagged,
            "missed": self.missed,
            "false": self.false,
            "unrecorded": self.unrecorded,
        }

    def __str__(self) -> str:
        """The report, a line each."""
        lines = [f"{name:16}{value}" for name, value in self.report().items() if value is not None]
        if self.other_offset_s is not None:
            lines.append("the presses repeat: another offset fits nearly as well; state --offset")
        return "\n".join(lines)


# Readings and gauge must overlap by this share of the shorter one at any offset that is tried.
_LEAST_OVERLAP = 0.5
# Below this correlation the two did not record the same presses. Few presses of other shapes reach
# 0.7, the right offset gives 0.95 and more.
_LEAST_CORRELATION = 0.8
# Another offset, away from the best one by more than a second, whose correlation reaches this share
# of the best: presses that repeat regularly.
_AMBIGUOUS, _ELSEWHERE_S = 0.98, 1.0
# Parts of the recording that are left out in turn for the standard deviation of the offset.
_PARTS = 10
# An interval between two values of the gauge that is longer than so many usual ones is a hole: it
# lacks a value at least. Shorter ones are the jitter of a logger's clock.
_HOLE = 1.75
# Longest record of a gauge, in half groups: some 100 hours at 28 readings per second.
_MOST_STEPS = 20_000_000


def compare_with_gauge(
    readings: TimedForces,
    gauge: GaugeRecord,
    touch_n: float = 0.5,
    offset_s: float | None = None,
) -> GaugeComparison:
    """Align readings and a gauge in time, and compare their forces.

    A reading is compared with the gauge's mean over its group, without holes. The offset explains
    most of the clear readings, by FFT (masked cross-correlation, Padfield 2012) on half groups,
    then continuously; gain and zero do not matter. Groups are steady between pressed neighbours.
    ``touch_n`` is the force from which a press must be read.
    """
    _check_times(readings, gauge)
    if not np.any(readings.clear):
        raise InputError("readings", "must hold some without flags to be compared")
    average = _Average(gauge, readings.period_s)
    other, std_s = None, 0.0
    if offset_s is None:
        offset_s, other = _coarse_offset(readings, gauge, average)
        offset_s, std_s = _fine_offset(readings, average, offset_s)
    expected = average.at(readings.time_s + offset_s)
    correlation = _correlation(readings.force_n, expected, readings.clear)
    if not abs(correlation) >= _LEAST_CORRELATION:
        raise InputError(
            "gauge",
            f"must agree with the readings: the correlation is {correlation:.2f} at best, at an "
            f"offset of {offset_s:.3f} s; check that both are of one run, begin before the first "
            "press and end after it, the columns, the sensor and the offset",
        )
    sign = 1 if correlation > 0 else -1
    covered = np.isfinite(expected)
    idle = covered & readings.clear & ~readings.touched
    zero_n = float(np.median(expected[idle])) if np.any(idle) else 0.0
    force = sign * (expected - zero_n)
    with np.errstate(invalid="ignore"):
        pressed = force >= touch_n
    steady = pressed & _neighbours(pressed)
    compared = steady & readings.clear & readings.touched
    if not np.any(compared):
        raise InputError("gauge", f"must show steady presses of {touch_n:g} N that are read")
    none = covered & ~pressed & _neighbours(covered & ~pressed)
    return GaugeComparison(
        offset_s,
        std_s,
        other,
        correlation,
        sign,
        zero_n,
        readings.time_s[compared],
        readings.force_n[compared],
        readings.force_std_n[compared],
        force[compared],
        flagged=int(np.sum(steady & ~readings.clear)),
        missed=int(np.sum(steady & readings.clear & ~readings.touched)),
        false=int(np.sum(none & readings.clear & readings.touched)),
        unrecorded=int(np.sum(readings.clear & average.in_hole(readings.time_s + offset_s))),
    )


def _check_times(readings: TimedForces, gauge: GaugeRecord) -> None:
    """Refuse what would take minutes and gigabytes, and gauges that cannot show a press."""
    if len(readings.time_s) < 2:
        raise InputError("readings", "must be two or more", len(readings.time_s))
    span_s = np.ptp(readings.time_s)
    most_s = _MOST_STEPS * readings.period_s / 2
    for name, each_s in (("readings", span_s), ("gauge", np.ptp(gauge.time_s))):
        if each_s > most_s:
            raise InputError(name, f"must span at most {most_s:.0f} s")
    interval_s = float(np.median(np.diff(gauge.time_s)))
    if interval_s > span_s:
        rule = f"must hold several values while the readings last, {span_s:.3g} s"
        raise InputError("gauge", f"{rule}; it has one in {interval_s:.3g} s")


class _Average:
    """Means of the gauge's force over windows of one group."""

    def __init__(self, gauge: GaugeRecord, window_s: float) -> None:
        self._time_s, self._half_s = gauge.time_s, window_s / 2
        self._integral = cumulative_trapezoid(gauge.force_n, gauge.time_s, initial=0)
        interval_s = np.diff(gauge.time_s)
        # Over less than a window, what was not recorded hardly changes the mean.
        hole = interval_s > max(_HOLE * float(np.median(interval_s)), window_s)
        self._holes_s = gauge.time_s[:-1][hole], gauge.time_s[1:][hole]

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Means around times of the gauge's clock; NaN where it did not record all of a window."""
        first, last = time_s - self._half_s, time_s + self._half_s
        upto = (np.interp(at, self._time_s, self._integral) for at in (last, first))
        values = np.subtract(*upto) / (2 * self._half_s)
        inside = (first >= self._time_s[0]) & (last <= self._time_s[-1]) & ~self.in_hole(time_s)
        return np.where(inside, values, np.nan)

    def in_hole(self, time_s: np.ndarray) -> np.ndarray:
        """Whether the gauge has a hole in the window around each of its times."""
        starts, ends = self._holes_s
        begun = np.searchsorted(starts, time_s + self._half_s)
        ended = np.searchsorted(ends, time_s - self._half_s, side="right")
        return begun > ended


def _coarse_offset(
    readings: TimedForces, gauge: GaugeRecord, average: _Average
) -> tuple[float, float | None]:
    """The offset with the largest correlation on a grid, and another that is nearly as good."""
    step_s = readings.period_s / 2
    start_s = readings.time_s[0]
    places = np.round((readings.time_s - start_s) / step_s).astype(int)
    ours = np.full(places[-1] + 1, np.nan)
    ours[places] = np.where(readings.clear, readings.force_n, np.nan)
    grid_s = np.arange(gauge.time_s[0], gauge.time_s[-1], step_s)
    lags, correlation, explained = _masked_correlation(ours, average.at(grid_s))
    best = int(np.argmax(explained))
    offsets = grid_s[0] + lags * step_s - start_s
    away = np.abs(offsets - offsets[best]) > _ELSEWHERE_S
    correlation *= np.sign(correlation[best])
    rival = int(np.argmax(np.where(away, correlation, -1)))
    ambiguous = away[rival] and correlation[rival] > _AMBIGUOUS * correlation[best]
    return float(offsets[best]), float(offsets[rival]) if ambiguous else None


def _masked_correlation(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lags, correlation of ``a[i]`` and ``b[i + lag]`` but NaN, and what of ``a`` it explains."""
    a_known, b_known = (np.isfinite(each).astype(float) for each in (a, b))
    a, b = np.where(a_known, a, 0.0), np.where(b_known, b, 0.0)

    def products(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return correlate(y, x, method="fft")

    count = np.maximum(np.round(products(a_known, b_known)), 0)
    sum_a, sum_b = products(a, b_known), products(a_known, b)
    safe = np.maximum(count, 1)
    covariance = products(a, b) - sum_a * sum_b / safe
    power_a = products(a**2, b_known) - sum_a**2 / safe
    power_b = products(a_known, b**2) - sum_b**2 / safe
    least = _LEAST_OVERLAP * min(np.sum(a_known), np.sum(b_known) / 2)
    # Where one of them hardly changes, rounding would decide.
    floor = 1e-9 * max(np.max(power_a), 0) * max(np.max(power_b), 0)
    valid = (count >= least) & (power_a * power_b > floor)
    correlation, explained = np.zeros((2, len(count)))
    correlation[valid] = covariance[valid] / np.sqrt((power_a * power_b)[valid])
    explained[valid] = correlation[valid] ** 2 * power_a[valid]
    return correlation_lags(len(b), len(a)), correlation, explained


def _fine_offset(readings: TimedForces, average: _Average, near_s: float) -> tuple[float, float]:
    """The offset that maximises the correlation, and its jackknife standard deviation."""
    reach_s = 2 * readings.period_s

    def best(used: np.ndarray) -> float:
        # Of the distance, since the optimiser's tolerance grows with its variable: dates since 1970
        # would not be refined at all.
        def loss(distance_s: float) -> float:
            expected = average.at(readings.time_s[used] + (near_s + distance_s))
            return -abs(_correlation(readings.force_n[used], expected, readings.clear[used]))

        bounds = (-reach_s, reach_s)
        found = minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 1e-6})
        return near_s + float(found.x)

    count = len(readings.time_s)
    part = np.arange(count) * _PARTS // count
    without = np.array([best(part != each) for each in range(_PARTS)])
    variance = (_PARTS - 1) / _PARTS * np.sum((without - without.mean()) ** 2)
    return best(np.ones(count, bool)), float(np.sqrt(variance))


def _correlation(a: np.ndarray, b: np.ndarray, clear: np.ndarray) -> float:
    both = clear & np.isfinite(a) & np.isfinite(b)
    a, b = a[both], b[both]
    if len(a) < 2 or not (np.ptp(a) and np.ptp(b)):
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def _neighbours(values: np.ndarray) -> np.ndarray:
    """Whether a condition holds before and after each place."""
    padded = np.concatenate([[False], values, [False]])
    return padded[:-2] & padded[2:]


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
        (``read_gauge`` takes others). It may have any clock, zero and sign.
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
    record = gauge if isinstance(gauge, GaugeRecord) else read_gauge(gauge)
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
