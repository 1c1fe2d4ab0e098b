# SPDX-License-Identifier: GPL-3.0-or-later
"""A guided calibration: what to measure next, what is stored, how well it fits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...errors import InputError
from ...sensor.curves import CurveModel
from ...signal.carrier import wrap_deg
from ..calibrate import calibrate
from ..data import complete_locations
from ..gauges.file import UNITS_N
from ..tables import read_tap_csv
from ..validation import location_warnings
from .entry_plausibility import force_warning, press_warnings
from .press_measurement import PressMeasurement
from .session_file import Coverage, SessionFile, SessionPlan, Target

# Untouched phases of runs with the same scene agree within this: their difference is drift.
_UNTOUCHED_DEG = 1.0


class Residual(NamedTuple):
    """How far the measurements at a location are from the curves fitted to all.

    ``largest_deg``: largest residual of either port; ``force_n``: force of that measurement, in N.
    """

    location_mm: float
    rms_deg: tuple[float, float]
    largest_deg: float
    force_n: float


@dataclass
class CalibrationSession:
    """A guided calibration, stored as it proceeds.

    ``path``: table of taps; an existing one is continued (see :class:`~.session_file.SessionFile`);
    ``settings``: arguments of :func:`.calibration.calibrate` for residuals and model, besides those
    of the line.
    """

    plan: SessionPlan
    path: str | Path
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._file = SessionFile(self.path, self.plan.sensor, self.plan.frequency_hz)
        self._skipped: set[Target] = set()

    def __enter__(self) -> "CalibrationSession":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    @property
    def measurements(self) -> Sequence[PressMeasurement]:
        """Everything that is stored, in the order of measurement."""
        return tuple(self._file.measurements)

    @property
    def presses(self) -> Sequence[PressMeasurement]:
        """The same without those of the untouched sensor."""
        return tuple(each for each in self._file.measurements if not each.untouched)

    def next_target(self) -> Target | None:
        """The next planned measurement that is neither taken nor skipped; None at the end."""
        taken = {self._target_of(each) for each in self.presses}
        for target in self.plan.targets():
            if target not in taken and target not in self._skipped:
                return target
        return None

    def _target_of(self, press: PressMeasurement) -> Target:
        return Target(press.location_mm, press.sweep, self.plan.nearest_force(press.force_n))

    def skip(self, target: Target) -> None:
        """Leave out a planned measurement, until the session is opened again."""
        self._skipped.add(target)

    def skip_location(self, location_mm: float) -> None:
        """Leave out the rest of a location."""
        self._skipped.update(t for t in self.plan.targets() if t.location_mm == location_mm)

    def check_force(self, force_n: float) -> None:
        """Check that a force is one that the plan asks for, or near them."""
        low, high = self.plan.force_limits_n
        if low <= force_n <= high:
            return
        rule = f"must be {low:g} to {high:g} N"
        if force_n < 0:
            rule += "; a gauge that shows less than nothing is inverted or was zeroed under load"
        weight = force_n * UNITS_N["g"]
        if low <= weight <= high:
            rule += f" (is it in g? {force_n:g} g are {weight:.2g} N)"
        raise InputError("force_n", rule, force_n)

    def warnings(self, press: PressMeasurement, target: Target | None = None) -> list[str]:
        """Reasons why a press may be an error of the person who measures.

        Returns list of str: a sentence each; empty when it is plausible.

        ``target``: what was asked for.
        """
        plan = self.plan
        asked = force_warning(press.force_n, target.force_n) if target is not None else None
        found = press_warnings(
            press, self.presses, plan.frequency_hz, plan.length_mm, plan.permittivity
        )
        return ([asked] if asked else []) + found

    def add(self, measurement: PressMeasurement) -> None:
        """Store a measurement.

        Raises OutputError when it cannot be written; those before it are kept.
        """
        if measurement.untouched:
            self._check_untouched(measurement)
        else:
            self.check_force(measurement.force_n)
        self._file.append(measurement)

    def _check_untouched(self, measurement: PressMeasurement) -> None:
        """Presses of several runs refer to one untouched sensor."""
        before = [each.phase_deg for each in self._file.measurements if each.untouched]
        if not before:
            return
        change = np.abs(wrap_deg(np.array(measurement.phase_deg) - np.array(before[0]))).max()
        if change > _UNTOUCHED_DEG:
            rule = (
                f"must have the phases of the session's start within {_UNTOUCHED_DEG:g} deg (is "
                "the scene's model still the same?); tare, or begin a new session"
            )
            raise InputError("measurement", rule, round(float(change), 1))

    def undo(self) -> PressMeasurement | None:
        """Remove the last measurement.

        Returns PressMeasurement or None: the one that was removed; None when there is none.
        """
        return self._file.remove_last()

    def coverage(self) -> Coverage:
        """Measurements by location and planned force."""
        plan = self.plan
        others = {each.location_mm for each in self.presses} - set(plan.location_mm)
        places = tuple(sorted({*plan.location_mm, *others}))
        counts = np.zeros((len(places), len(plan.force_n)), int)
        for press in self.presses:
            nearest = plan.nearest_force(press.force_n)
            counts[places.index(press.location_mm), plan.force_n.index(nearest)] += 1
        return Coverage(places, plan.force_n, counts, plan.sweeps)

    def complete_locations(self) -> list[float]:
        """Locations with enough forces for curves, rising."""
        if not self.presses:
            return []
        return complete_locations(read_tap_csv(self.path, self.plan.frequency_hz))

    def model(self, name: str | None = None) -> CurveModel:
        """Calibrate with the locations that have enough forces.

        ``name``: of the model; the sensor's by default.
        """
        plan, places = self.plan, self.complete_locations()
        table = read_tap_csv(self.path, plan.frequency_hz)
        table = table.take(table.untouched | np.isin(table.location_mm, places))
        line = {"length_mm": plan.length_mm, "permittivity": plan.permittivity}
        return calibrate(table, name or plan.sensor, **{**self.settings, **line})

    def location_warnings(self) -> list[str]:
        """Locations that the others contradict, as a wrong mark of the ruler makes them.

        Residuals do not show it, because each location has curves of its own.

        Returns list of str: a sentence each; empty while there are not three locations with enough
        forces.
        """
        return location_warnings(self.model()) if len(self.complete_locations()) > 2 else []

    def residuals(self) -> list[Residual]:
        """Residuals of the measurements against the model of all.

        Returns list of Residual: by location; empty while there are not two locations with enough
        forces.
        """
        places = self.complete_locations()
        if len(places) < 2:
            return []
        model = self.model()
        rows = []
        for place in places:
            here = [each for each in self.presses if each.location_mm == place]
            force = np.array([each.force_n for each in here])
            measured = np.array([each.phase_deg for each in here])
            error = wrap_deg(measured - model.phases_deg(force, place, self.plan.frequency_hz))
            rms = np.sqrt(np.mean(error**2, axis=0))
            worst = int(np.argmax(np.abs(error).max(axis=1)))
            largest = float(np.abs(error[worst]).max())
            rows.append(
                Residual(place, (float(rms[0]), float(rms[1])), largest, float(force[worst]))
            )
        return rows
