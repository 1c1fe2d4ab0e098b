# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether phases are those of the touched or of the untouched sensor, or could be both."""

import numpy as np

from ..signal.carrier import wrap_deg
from .model import SensorModel

_SIGMAS = 3.0
# Presses that a reading is compared with: finer steps than the 20 deg that separate neighbours
# change nothing where standard deviations are large enough for the question to arise.
_FORCES, _LOCATIONS = 12, 41


def touch_of(
    model: SensorModel,
    phases_deg: np.ndarray,
    std_deg: float,
    frequency_hz: float | None = None,
) -> np.ndarray:
    """Tell touched (1) from untouched (0) phases (n, 2), where their standard deviation allows it.

    0 for phases within three standard deviations of the untouched ones, 1 for others, -1 for phases
    that lie within three standard deviations of a press as well.
    """
    phases = np.asarray(phases_deg, float)
    touch = np.where(model.is_untouched(phases, std_deg, frequency_hz), 0, 1)
    pressed = _pressed_deg(model, frequency_hz)
    untouched = np.array(model.untouched_deg(frequency_hz))
    if np.max(np.abs(wrap_deg(pressed - untouched)), axis=1).min() > 2 * _SIGMAS * std_deg:
        return touch
    for row in np.flatnonzero(touch == 0):
        away = np.max(np.abs(wrap_deg(pressed - phases[row])), axis=1)
        if away.min() <= _SIGMAS * std_deg:
            touch[row] = -1
    return touch


def _pressed_deg(model: SensorModel, frequency_hz: float | None) -> np.ndarray:
    """Phases of presses all over the line, up to the highest calibrated force; (m, 2)."""
    forces = np.geomspace(model.onset_force_n, model.force_span_n[1], _FORCES)
    places = np.linspace(model.location_span_mm[0], model.location_span_mm[1], _LOCATIONS)
    force, place = (axis.ravel() for axis in np.meshgrid(forces, places))
    return np.asarray(model.phases_deg(force, place, frequency_hz))
