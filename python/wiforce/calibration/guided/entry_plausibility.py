# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether an entry of a guided calibration is plausible, by those that were taken before it.

The checks find errors of the person who measures: a wrong digit, the wrong mark of the ruler, a
sensor held the other way round. The errors of the sensor are for the calibration to find.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...sensor import line
from ..data import continuous_phase
from ..tables import CalibrationTable
from .press_measurement import PressMeasurement

# The widening of the short is compared with what the five nearest forces at this location suggest
# by a line over F^(-1/3), which describes a soft beam. With gauge errors of 1 % and 0.03 N it stays
# within these limits for all shipped sensors; half the force does not, and twice the force rarely.
_NEIGHBOURS, _LEAST_NEIGHBOURS = 5, 3
_WIDENING_MM, _WIDENING_PART, _WIDENING_STDS = 0.75, 0.5, 3.0
# The contact law moves the middle of the short by up to 4 mm from a location to the next, 10 mm
# away; a wrong mark of the ruler by the whole step or more. In the published sweeps an end moves by
# up to 3 mm the wrong way when the force rises; in a slip both ends move by all of it.
_STEP_PART, _LEAST_STEP_MM = 0.6, 4.0
# Part of the asked force, and force in N, by which another force is no slip of the hand.
_FORCE_PART, _FORCE_N = 0.4, 0.5


class _Line(NamedTuple):
    """The line that was pressed, at its carrier."""

    frequency_hz: float
    length_mm: float
    permittivity: float

    @property
    def slope(self) -> float:
        """Change of the phase along it, in deg/mm."""
        return line.round_trip_deg_per_mm(self.frequency_hz, self.permittivity)

    def added_mm(self, press: PressMeasurement) -> np.ndarray:
        """Extent of the short towards both ports (2,), up to a constant and half wavelengths."""
        distances = np.array([press.location_mm, self.length_mm - press.location_mm])
        exact = line.short_phase_deg(distances, self.frequency_hz, self.permittivity)
        return np.asarray((np.array(press.phase_deg) - exact) / self.slope)

    def nearest_turn(self, change_mm: np.ndarray) -> np.ndarray:
        """The whole turns of the phase that are nearest to a change, in mm."""
        turn = 360.0 / self.slope
        return np.asarray(turn * np.round(change_mm / turn))


def force_warning(force_n: float, asked_n: float) -> str | None:
    """Warning of a force that is far from the one that was asked for."""
    if abs(force_n - asked_n) <= max(_FORCE_N, _FORCE_PART * asked_n):
        return None
    return f"the force is {force_n:g} N where about {asked_n:g} N was asked for"


def press_warnings(
    new: PressMeasurement,
    before: Sequence[PressMeasurement],
    frequency_hz: float,
    length_mm: float,
    permittivity: float,
) -> list[str]:
    """Warnings of a press that those before it contradict.

    Returns list of str: a sentence each; empty when it is plausible.

    ``before``: of all locations.
    """
    presses = [each for each in before if not each.untouched]
    here = [each for each in presses if each.location_mm == new.location_mm]
    own = _Line(frequency_hz, length_mm, permittivity)
    return _elsewhere(new, presses, own) or _jump(new, here, own) or _widening(new, here, own)


def _elsewhere(new: PressMeasurement, presses: Sequence[PressMeasurement], own: _Line) -> list[str]:
    """Whether the ends of the short lie where those of a press at another location would.

    With a change of force, whatever its amount, both move outward or both inward: a short only
    widens. Along the line they move the same way.
    """

    def distance(each: PressMeasurement) -> tuple[float, float]:
        step_mm = abs(each.location_mm - new.location_mm)
        return step_mm, abs(float(np.log(each.force_n / new.force_n)))

    if not presses:
        return []
    nearest = min(presses, key=distance)
    outward = own.added_mm(new) - own.added_mm(nearest)
    outward -= own.nearest_turn(outward)
    step = abs(new.location_mm - nearest.location_mm)
    moved = float(outward[1] - outward[0]) / 2
    # At one location, an end that moves alone is no slip.
    certain = step > 0 or (outward.prod() < 0 and np.abs(outward).min() > _LEAST_STEP_MM)
    if not certain or abs(moved) <= max(_STEP_PART * step, _LEAST_STEP_MM):
        return []
    place = new.location_mm + moved
    cause = "" if step else "; the sensor or the indenter slipped"
    return [
        f"the phases are those of a press at about {place:.0f} mm, not at {new.location_mm:g} mm"
        f"{cause}"
    ]


def _jump(new: PressMeasurement, here: Sequence[PressMeasurement], own: _Line) -> list[str]:
    """What would be refused when the sweep is calibrated."""
    sweep = [each for each in here if each.sweep == new.sweep]
    return [
        f"the phase of port {port} jumps against those at other forces, further than a press can "
        "move the short"
        for port in (1, 2)
        if _continues(sweep, port, own) and not _continues([*sweep, new], port, own)
    ]


def _continues(sweep: Sequence[PressMeasurement], port: int, own: _Line) -> bool:
    """Whether a calibration accepts the phases of one port."""
    rows = [
        (0, own.frequency_hz, each.location_mm, port, each.force_n, each.phase_deg[port - 1], "")
        for each in sweep
    ]
    try:
        if rows:
            continuous_phase(CalibrationTable.from_rows("", rows), own.permittivity)
    except InputError:
        return False
    return True


def _widening(new: PressMeasurement, here: Sequence[PressMeasurement], own: _Line) -> list[str]:
    """Whether the width of the short follows from those at other forces."""
    near = sorted(here, key=lambda each: abs(np.log(each.force_n / new.force_n)))[:_NEIGHBOURS]
    inverse = np.array([each.force_n for each in near]) ** (-1 / 3)
    if len(near) < _LEAST_NEIGHBOURS or np.ptp(inverse) == 0:
        return []
    added = np.array([own.added_mm(each) for each in near])
    latest = own.added_mm(new)
    # Whole turns against the nearest force, since the movement between the two is small.
    added -= own.nearest_turn(added - added[0])
    latest = latest - own.nearest_turn(latest - added[0])
    width, own_width = added.sum(axis=1), float(latest.sum())
    design = np.column_stack([np.ones(len(near)), inverse])
    fitted = np.linalg.lstsq(design, width, rcond=None)[0]
    expected = float(fitted[0] + fitted[1] * new.force_n ** (-1 / 3))
    residual = float(np.sqrt(np.mean((width - design @ fitted) ** 2)))
    move = abs(fitted[1] * (new.force_n ** (-1 / 3) - inverse[0]))
    allowed = _WIDENING_MM + _WIDENING_PART * move + _WIDENING_STDS * residual
    if abs(own_width - expected) <= allowed:
        return []
    more = "wider" if own_width > expected else "narrower"
    return [
        f"the short is {abs(own_width - expected):.1f} mm {more} than the other forces at "
        f"{new.location_mm:g} mm suggest for {new.force_n:.2f} N"
    ]
