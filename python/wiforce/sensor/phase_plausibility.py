# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether phases can be those of a sensor model, or have a mistake."""

import numpy as np

from .model import SensorModel
from .plausibility import TURN_RAD, location_suspicions

# Readings of which so many are unexplained are suspicious, and explained if so few are.
_MOST, _FEW, _ROWS_TRIED = 0.5, 0.1, 200
_UNEXPLAINED = {"inconsistent", "extrapolated"}


def phase_suspicions(
    model: SensorModel,
    phases_deg: np.ndarray,
    std_deg: float,
    location_mm: np.ndarray | None = None,
    frequency_hz: float | None = None,
) -> list[str]:
    """Likely mistakes in the units, ports and signs of phases that a model does not explain.

    Returns list of str: a sentence each, if most readings are inconsistent with the model. A
    mistake is named if nearly all would be consistent without it.

    Parameters
    ----------
    phases_deg : ndarray, shape (n, 2)
    std_deg : float
        Standard deviation of the phases.
    location_mm : ndarray, shape (n,), optional
        Known locations, NaN where unknown.
    frequency_hz : float, optional
        Carrier; the model's only one by default.
    """
    known = np.full(len(phases_deg), np.nan) if location_mm is None else np.asarray(location_mm)
    rows = np.linspace(0, len(phases_deg) - 1, min(len(phases_deg), _ROWS_TRIED)).astype(int)
    phases, known = np.asarray(phases_deg, float)[rows], known[rows]
    found = []
    if np.isfinite(known).any() and (farthest := float(np.nanmax(known))) > 0:
        found += location_suspicions(farthest, model.length_mm)

    def share(changed: np.ndarray) -> float:
        return _unexplained(model, changed, std_deg, known, frequency_hz)

    if found or share(phases) <= _MOST:
        return found
    if np.max(np.abs(phases)) <= TURN_RAD and share(np.degrees(phases)) <= _FEW:
        return ["the phases would fit the sensor in radians: are they not in degrees?"]
    for changed, text in (
        (phases[:, ::-1], "with the ports swapped the phases would fit the sensor"),
        (-phases, "with the opposite sign the phases would fit the sensor (arg S11, arg S22)"),
    ):
        if share(changed) <= _FEW:
            found.append(f"{text}; now most of them do not")
    if not found and (~model.is_untouched(phases, std_deg, frequency_hz)).any():
        found = ["most phases do not fit the sensor: are they of another line or carrier?"]
    return found


def _unexplained(
    model: SensorModel,
    phases: np.ndarray,
    std_deg: float,
    known: np.ndarray,
    frequency_hz: float | None,
) -> float:
    """Share of touched readings that the model does not explain; 1 where none is touched."""
    touched = ~model.is_untouched(phases, std_deg, frequency_hz)
    bad = []
    for given in (True, False):
        chosen = touched & (np.isfinite(known) == given)
        if chosen.any():
            places = known[chosen] if given else None
            result = model.invert(phases[chosen], std_deg, places, frequency_hz)
            bad += [bool(_UNEXPLAINED & set(flags)) for flags in result.flags]
    return float(np.mean(bad)) if bad else 1.0
