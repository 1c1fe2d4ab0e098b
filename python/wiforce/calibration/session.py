# SPDX-License-Identifier: GPL-3.0-or-later
"""A guided calibration: its plan, its measurements, their file, and whether they fit."""

import csv
import io
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from ..io.readings import WEAK_PHASE_DEG, Reading
from ..io.text.textfile import (
    MAX_CSV_BYTES,
    cell_number,
    check_output,
    read_bytes,
    read_csv,
    write_text,
)
from ..sensor import line
from ..sensor.curves import CurveModel
from ..sensor.line import MAX_FORCE_N
from ..signal.carrier import same_carrier, wrap_deg
from .calibrate import calibrate
from .data import LEAST_FORCES, unwrap_over_force, without_incomplete
from .gauges import UNITS_N
from .tables import read_tap_csv

# Fewest phase groups of a measurement: halves of four give a drift and its error.
LEAST_GROUPS = 8
# The shorting points must hold still within this distance, half of the location error aimed at.
STEADY_MM = 0.25
# Standard errors by which the means of both halves differ, and standard deviations by which a
# single group differs from the median, by chance in less than 0.1 % of measurements of 14 groups.
_DRIFT_STDS, _JUMP_STDS = 5.0, 6.0
# The noise is estimated from the steps between neighbours without the two largest: a slip causes
# one of them, a single bad group two. For normal noise and n groups the estimate is low by the
# factor 1 + 5 / n.
_LEFT_OUT, _LOW_BY = 2, 5.0
# Flags of RECEPTION. The others state how the scene's provisional model explains the
# phases, which is what the calibration is to replace.
_REFUSED = {
    "reference": "the untouched reference is being measured; release the sensor and wait",
    "gap": "samples were lost",
    "saturated": "the receiver is saturated; lower the gains until nothing is clipped",
    "moved": "the tag or an antenna moved; release the sensor, quit (q) and start again",
    "transition": "the press changed",
}
_REFUSED_UNTOUCHED = {
    **_REFUSED,
    "inconsistent": "its reference was disturbed; release the sensor, quit (q) and start again",
    "weak": "the tag is received too weakly",
}


@dataclass(frozen=True)
class PressMeasurement:
    """Mean phases of a press, or of the untouched sensor, where location and force are NaN and 0.

    ``sweep`` is the run over the forces there, from 1; ``time_utc`` ISO 8601.
    """

    location_mm: float
    force_n: float
    force_std_n: float
    phase_deg: tuple[float, float]
    phase_std_deg: tuple[float, float]
    groups: int
    sweep: int = 1
    time_utc: str = field(
        default_factory=lambda: datetime.now(timezone.utc).isoformat(timespec="seconds")
    )

    @property
    def untouched(self) -> bool:
        return math.isnan(self.location_mm)


def steady_deg(frequency_hz: float, permittivity: float = 1.0) -> float:
    """Largest change of a phase during a measurement, in degrees: that of 0.25 mm of line."""
    return STEADY_MM * line.round_trip_deg_per_mm(frequency_hz, permittivity)


def measure_untouched(readings: Sequence[Reading], largest_change_deg: float) -> PressMeasurement:
    """Mean phases of the untouched sensor, from consecutive readings of it."""
    mean, std = _phases(readings, "untouched sensor", 0, largest_change_deg, _REFUSED_UNTOUCHED)
    return PressMeasurement(math.nan, 0.0, math.nan, mean, std, len(readings))


def measure_press(
    readings: Sequence[Reading],
    location_mm: float,
    force_n: float,
    largest_change_deg: float,
    force_std_n: float = math.nan,
    sweep: int = 1,
) -> PressMeasurement:
    """Mean phases of a press that holds still, from consecutive readings of one sensor."""
    where = f"press at {location_mm:g} mm"
    mean, std = _phases(readings, where, 1, largest_change_deg, _REFUSED)
    return PressMeasurement(location_mm, force_n, force_std_n, mean, std, len(readings), sweep)


def _phases(
    readings: Sequence[Reading],
    where: str,
    touch: int,
    largest_change_deg: float,
    refused: dict[str, str],
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Mean phases and their standard deviations of readings that pass all checks."""
    if len(readings) < LEAST_GROUPS:
        rule = f"must have at least {LEAST_GROUPS} readings"
        raise InputError(where, rule, len(readings))

    def refuse(broken: Sequence[bool], rule: str) -> None:
        if any(broken):
            raise InputError(where, rule.format(f"{sum(broken)} of {len(readings)} readings"))

    absent = [r.touch is None or r.phase1_deg is None for r in readings]
    refuse(absent, "must be received; the tag was not in {}")
    # A flag explains why the reader takes a press for none.
    for word, reason in refused.items():
        flagged = [word in r.flags for r in readings]
        refuse(flagged, f"must not be flagged; '{word}' in {{}}: {reason}")
    state, found = ("touched", "no touch") if touch else ("released", "a touch")
    refuse([r.touch != touch for r in readings], f"must be {state}; {found} in {{}}")
    phases = np.array([(r.phase1_deg, r.phase2_deg) for r in readings], float)
    centre = np.rad2deg(np.angle(np.mean(np.exp(1j * np.deg2rad(phases)), axis=0)))
    deviations = wrap_deg(phases - centre)
    for port, deviation in enumerate(deviations.T, 1):
        _check_steady(deviation, where, port, largest_change_deg)
    std = deviations.std(axis=0, ddof=1) / math.sqrt(len(readings))
    return (float(centre[0]), float(centre[1])), (float(std[0]), float(std[1]))


def _check_steady(deviation: np.ndarray, where: str, port: int, largest_deg: float) -> None:
    steps = np.sort(np.abs(np.diff(deviation)))[:-_LEFT_OUT]
    noise = float(np.sqrt(np.mean(steps**2) / 2)) * (1 + _LOW_BY / len(deviation))
    if noise > WEAK_PHASE_DEG:
        rule = f"must be received better; the phase of port {port} scatters by {noise:.1f} deg"
        raise InputError(where, rule)
    half = len(deviation) // 2
    drift = abs(float(np.mean(deviation[-half:]) - np.mean(deviation[:half])))
    allowed = largest_deg + _DRIFT_STDS * noise * math.sqrt(2 / half)
    jump = float(np.max(np.abs(deviation - np.median(deviation))))
    if drift > allowed or jump > largest_deg + _JUMP_STDS * noise:
        change = max(drift, jump)
        rule = (
            f"must hold still while it is measured; the phase of port {port} changed by "
            f"{change:.1f} deg ({largest_deg:.1f} allowed)"
        )
        raise InputError(where, rule)


# Part of the asked force, and force in N, by which another force is no slip of the hand.
_FORCE_PART, _FORCE_N = 0.4, 0.5
DEFAULT_LOCATIONS_MM = (20.0, 30.0, 40.0, 50.0, 60.0)
DEFAULT_FORCES_N = (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 6.0, 7.0, 8.0)
# Half a division of a ruler with millimetres, on either side: 1 mm / sqrt(12).
RULER_STD_MM = 0.3
# Forces below half of the lowest or far above the highest planned one are errors of entry.
_LOW_PART, _HIGH_PART = 0.5, 1.25
# Untouched phases of runs with the same scene agree within this: their difference is drift.
_UNTOUCHED_DEG = 1.0
_COLUMNS = (
    "time_utc",
    "sensor",
    "freq_mhz",
    "location_mm",
    "force_n",
    "force_std_n",
    "phase1_deg",
    "phase2_deg",
    "phase1_std_deg",
    "phase2_std_deg",
    "groups",
    "press",
)


class Target(NamedTuple):
    location_mm: float
    sweep: int
    force_n: float


@dataclass(frozen=True)
class SessionPlan:
    """What a guided calibration is to measure: locations in order, forces, rising, sweeps.

    Every second sweep over the forces of a location falls.
    """

    sensor: str
    frequency_hz: float
    location_mm: tuple[float, ...] = DEFAULT_LOCATIONS_MM
    force_n: tuple[float, ...] = DEFAULT_FORCES_N
    sweeps: int = 1
    length_mm: float = 80.0
    permittivity: float = 1.0

    def __post_init__(self) -> None:
        locations, forces = self.location_mm, self.force_n
        if len(locations) < 2 or len(set(locations)) < len(locations):
            raise InputError("location_mm", "must be two or more different ones", locations)
        for location in locations:
            if not 0 < location < self.length_mm:
                rule = f"must lie within the line, 0 to {self.length_mm:g} mm"
                raise InputError("location_mm", rule, location)
        if len(forces) < LEAST_FORCES or any(np.diff(forces) <= 0):
            raise InputError("force_n", f"must be at least {LEAST_FORCES} forces, rising", forces)
        if not 0 < forces[0] < forces[-1] <= MAX_FORCE_N:
            raise InputError("force_n", f"must lie within 0 to {MAX_FORCE_N:g} N", forces)
        if self.sweeps < 1:
            raise InputError("sweeps", "must be 1 or more", self.sweeps)

    def targets(self) -> list[Target]:
        return [
            Target(location, sweep, force)
            for location in self.location_mm
            for sweep in range(1, self.sweeps + 1)
            for force in (self.force_n if sweep % 2 else self.force_n[::-1])
        ]


@dataclass
class CalibrationSession:
    """A guided calibration; each measurement is in its file before the next is taken.

    A file of the same sensor is continued. ``settings`` are those of
    :func:`.calibration.calibrate`.
    """

    plan: SessionPlan
    path: str | Path
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_output(self.path)
        self.measurements: list[PressMeasurement] = []
        self._skipped: set[Target] = set()
        self._data = self._stored()
        lines = self._data.splitlines()
        if lines and lines[0].strip() != ",".join(_COLUMNS).encode():
            rule = "must be a new file, or one that `calibrate --live` has written"
            raise InputError(self.path, rule, lines[0][:60].decode("utf-8", "replace").strip())
        if len(lines) > 1:
            _, rows = read_csv(self.path)
            self.measurements = [self._measurement(number, row) for number, row in rows]

    def _stored(self) -> bytes:
        return read_bytes(self.path, MAX_CSV_BYTES) if Path(self.path).exists() else b""

    @property
    def presses(self) -> Sequence[PressMeasurement]:
        """The measurements without those of the untouched sensor."""
        return tuple(each for each in self.measurements if not each.untouched)

    def next_target(self) -> Target | None:
        """The next planned measurement that is neither taken nor skipped; None at the end."""
        done = self._skipped | self._taken()
        return next((target for target in self.plan.targets() if target not in done), None)

    def _taken(self) -> set[Target]:
        """The planned measurements that were taken, by the nearest force as a ratio."""
        forces = self.plan.force_n
        return {
            Target(p.location_mm, p.sweep, min(forces, key=lambda f: abs(np.log(f / p.force_n))))
            for p in self.presses
        }

    def skip(self, target: Target) -> None:
        """Leave out a planned measurement, until the session is opened again."""
        self._skipped.add(target)

    def skip_location(self, location_mm: float) -> None:
        """Leave out the rest of a location."""
        self._skipped.update(t for t in self.plan.targets() if t.location_mm == location_mm)

    def check_force(self, force_n: float, asked_n: float | None = None) -> None:
        """Check that a force is near those of the plan, and near the one that was asked for."""
        low, high = _LOW_PART * self.plan.force_n[0], _HIGH_PART * self.plan.force_n[-1]
        if not low <= force_n <= high:
            rule = f"must be {low:g} to {high:g} N"
            if force_n < 0:
                rule += "; a gauge that shows less than nothing is inverted"
            weight = force_n * UNITS_N["g"]
            if low <= weight <= high:
                rule += f" (is it in g? {force_n:g} g are {weight:.2g} N)"
            raise InputError("force_n", rule, force_n)
        if asked_n and abs(force_n - asked_n) > max(_FORCE_N, _FORCE_PART * asked_n):
            raise InputError("force_n", f"must be about {asked_n:g} N, as asked for", force_n)

    def add(self, measurement: PressMeasurement) -> None:
        """Store a measurement, or raise OutputError, InputError; those before it are kept."""
        if measurement.untouched:
            self._check_untouched(measurement)
        else:
            self.check_force(measurement.force_n)
            self._check_jump(measurement)
        self._save([*self.measurements, measurement])

    def _check_untouched(self, measurement: PressMeasurement) -> None:
        """Presses of several runs refer to one untouched sensor."""
        for first in [each.phase_deg for each in self.measurements if each.untouched][:1]:
            change = float(np.abs(wrap_deg(np.subtract(measurement.phase_deg, first))).max())
            if change > _UNTOUCHED_DEG:
                rule = (
                    f"must have the phases of the session's start within {_UNTOUCHED_DEG:g} deg "
                    "(is the scene's model still the same?); quit (q) and start "
                    "again, or begin a new table"
                )
                raise InputError("measurement", rule, round(change, 1))

    def _check_jump(self, new: PressMeasurement) -> None:
        """Refuse a press for whose phases the whole table would be refused later."""
        where = new.location_mm, new.sweep
        sweep = [each for each in self.presses if (each.location_mm, each.sweep) == where]
        slope = line.round_trip_deg_per_mm(self.plan.frequency_hz, self.plan.permittivity)

        def jumps(presses: Sequence[PressMeasurement], port: int) -> bool:
            force = np.array([each.force_n for each in presses])
            phase = np.array([each.phase_deg[port - 1] for each in presses])
            return bool(unwrap_over_force(force, phase, slope)[2].any())

        for port in (1, 2):
            if jumps([*sweep, new], port) and not jumps(sweep, port):
                rule = (
                    f"must not jump at port {port} against those at other forces, further than a "
                    "press can move the short; measure again, or remove the one before"
                )
                raise InputError("phases", rule)

    def undo(self) -> PressMeasurement | None:
        """Remove the last measurement, and return it; None when there is none."""
        if not self.measurements:
            return None
        *kept, removed = self.measurements
        self._save(kept)
        return removed

    def done(self) -> tuple[int, int]:
        """Planned measurements that are taken, and all of them."""
        targets, taken = self.plan.targets(), self._taken()
        return sum(target in taken for target in targets), len(targets)

    def model(self, name: str | None = None) -> CurveModel:
        """Calibrate with the locations that have enough forces."""
        if not self.presses:
            raise InputError(self.path, "has no row with a force")
        table = without_incomplete(read_tap_csv(self.path, self.plan.frequency_hz))
        line = {"length_mm": self.plan.length_mm, "permittivity": self.plan.permittivity}
        return calibrate(table, name or self.plan.sensor, **{**self.settings, **line})

    def doubts(self) -> list[str]:
        """Likely mistakes in what is stored, a sentence each, from two complete locations on."""
        forces = Counter(place for place, _ in {(p.location_mm, p.force_n) for p in self.presses})
        if sum(count >= LEAST_FORCES for count in forces.values()) < 2:
            return []
        return self.model().provenance.get("suspicions", [])

    def _save(self, measurements: list[PressMeasurement]) -> None:
        """Replace the file by one with these measurements."""
        if self._stored() != self._data:
            raise InputError(self.path, "was changed by another program since it was written")
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(_COLUMNS)
        fixed = self.plan.sensor, f"{self.plan.frequency_hz / 1e6:.12g}"
        for m in measurements:
            numbers = m.location_mm, m.force_n, m.force_std_n, *m.phase_deg, *m.phase_std_deg
            cells = ["" if math.isnan(number) else f"{number:.8g}" for number in numbers]
            sweep = "" if m.untouched else m.sweep
            writer.writerow([m.time_utc, *fixed, *cells, m.groups, sweep])
        write_text(self.path, text.getvalue())
        self._data, self.measurements = text.getvalue().encode(), measurements

    def _measurement(self, number: int, row: dict[str, str]) -> PressMeasurement:
        where = f"{self.path}: row {number}"
        if row["sensor"] != self.plan.sensor:
            rule = f"must be of the sensor '{self.plan.sensor}', whose calibration is continued"
            raise InputError(f"{where}: sensor", rule, row["sensor"])
        empty = {"location_mm": math.nan, "force_std_n": math.nan, "press": 1.0}
        freq_mhz, location_mm, force_n, force_std_n, first, second, *stds, groups, sweep = (
            cell_number(row, name, where, empty.get(name)) for name in _COLUMNS[2:]
        )
        if not same_carrier(1e6 * freq_mhz, self.plan.frequency_hz):
            rule = f"must be {self.plan.frequency_hz / 1e6:g}, the scene's carrier"
            raise InputError(f"{where}: freq_mhz", rule, row["freq_mhz"])
        return PressMeasurement(
            location_mm,
            force_n,
            force_std_n,
            (first, second),
            (stds[0], stds[1]),
            int(groups),
            int(sweep),
            row["time_utc"],
        )
