# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether an entry of a guided calibration is plausible, by those that were taken before it.

The checks find errors of the person who measures: a wrong digit, the wrong mark of the ruler, a
sensor held the other way round. The errors of the sensor are for the calibration to find.
"""

from collections.abc import Sequence

import numpy as np

from ...sensor import line
from ..data import unwrap_over_force
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


def force_warning(force_n: float, asked_n: float) -> list[str]:
    """Warning of a force that is far from the one that was asked for."""
    if abs(force_n - asked_n) <= max(_FORCE_N, _FORCE_PART * asked_n):
        return []
    return [f"the force is {force_n:g} N where about {asked_n:g} N was asked for"]


def press_warnings(
    new: PressMeasurement,
    before: Sequence[PressMeasurement],
    frequency_hz: float,
    length_mm: float,
    permittivity: float,
) -> list[str]:
    """Warnings of a press that those before it, at all locations, contradict; a sentence each."""
    presses = [each for each in before if not each.untouched]
    if not presses:
        return []
    place, force = np.array([(each.location_mm, each.force_n) for each in presses]).T
    slope = line.round_trip_deg_per_mm(frequency_hz, permittivity)
    # Extent of the short towards both ports, up to a constant and half wavelengths: how far the
    # presses lie within the new one, (n, 2).
    at = np.append(place, new.location_mm)[:, None]
    exact = line.short_phase_deg(np.hstack([at, length_mm - at]), frequency_hz, permittivity)
    extent = (np.array([each.phase_deg for each in [*presses, new]]) - exact) / slope
    outward = extent[-1] - extent[:-1]
    step, ratio = np.abs(place - new.location_mm), np.abs(np.log(force / new.force_n))

    def nearest_turn(change_mm: np.ndarray) -> np.ndarray:
        return np.asarray(360.0 / slope * np.round(change_mm * slope / 360.0))

    # The nearest locations first, at each the nearest forces.
    order = np.lexsort((ratio, step))
    first, here = order[0], order[step[order] == 0]
    nearest = outward[first] - nearest_turn(outward[first])
    sweep = [presses[i] for i in np.flatnonzero(step == 0) if presses[i].sweep == new.sweep]
    found = _elsewhere(new, float(step[first]), nearest) or _jump(new, sweep, slope)
    if not found and len(here) >= _LEAST_NEIGHBOURS:
        near = here[:_NEIGHBOURS]
        # Whole turns against the nearest force, since the movement between the two is small.
        turns = nearest_turn(outward[near[0]]) - nearest_turn(outward[near[0]] - outward[near])
        found = _widening(new, force[near], (outward[near] - turns).sum(axis=1))
    return found


def _elsewhere(new: PressMeasurement, step: float, outward: np.ndarray) -> list[str]:
    """Whether the ends of the short (2,) lie where those of a press at another location would.

    With a change of force, whatever its amount, both move outward or both inward: a short only
    widens. Along the line they move the same way.
    """
    moved = float(outward[1] - outward[0]) / 2
    # At one location, an end that moves alone is no slip.
    certain = step > 0 or (outward.prod() < 0 and np.abs(outward).min() > _LEAST_STEP_MM)
    if not certain or abs(moved) <= max(_STEP_PART * step, _LEAST_STEP_MM):
        return []
    cause = "" if step else "; the sensor or the indenter slipped"
    return [
        f"the phases are those of a press at about {new.location_mm + moved:.0f} mm, not at "
        f"{new.location_mm:g} mm{cause}"
    ]


def _jump(new: PressMeasurement, sweep: Sequence[PressMeasurement], slope: float) -> list[str]:
    """What would be refused when the sweep is calibrated."""
    force = np.array([each.force_n for each in [*sweep, new]])
    phases = np.array([each.phase_deg for each in [*sweep, new]])

    def jumps(count: int, port: int) -> bool:
        return bool(unwrap_over_force(force[:count], phases[:count, port - 1], slope)[2].any())

    return [
        f"the phase of port {port} jumps against those at other forces, further than a press can "
        "move the short"
        for port in (1, 2)
        if jumps(len(force), port) and not jumps(len(sweep), port)
    ]


def _widening(new: PressMeasurement, force_n: np.ndarray, wider_mm: np.ndarray) -> list[str]:
    """Whether the width of the short follows from those at other forces (n,), nearest first.

    ``wider_mm`` (n,): by how much it is wider than theirs.
    """
    inverse, own = force_n ** (-1 / 3), new.force_n ** (-1 / 3)
    if np.ptp(inverse) == 0:
        return []
    design = np.column_stack([np.ones(len(inverse)), inverse])
    fitted = np.linalg.lstsq(design, wider_mm, rcond=None)[0]
    wider = float(fitted[0] + fitted[1] * own)
    residual = float(np.sqrt(np.mean((wider_mm - design @ fitted) ** 2)))
    move = abs(fitted[1] * (own - inverse[0]))
    if abs(wider) <= _WIDENING_MM + _WIDENING_PART * move + _WIDENING_STDS * residual:
        return []
    return [
        f"the short is {abs(wider):.1f} mm {'wider' if wider > 0 else 'narrower'} than the other "
        f"forces at {new.location_mm:g} mm suggest for {new.force_n:.2f} N"
    ]
