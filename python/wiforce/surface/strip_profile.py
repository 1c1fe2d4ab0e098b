# SPDX-License-Identifier: GPL-3.0-or-later
"""What the phases of one strip say of the force and location of its own contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..signal.carrier import wrap_deg

if TYPE_CHECKING:
    from ..sensor.model import SensorModel

Array = NDArray[np.float64]

# Forces of a profile, and the standard deviations that they span. The likelihood between two of
# them is constant within 3 %.
_FORCES, _REACH = 25, 4.5
# Steps of Gauss and Newton for the location at each force, from that of the inversion.
_STEPS = 2


@dataclass(frozen=True)
class StripProfile:
    """Profile likelihood over the force of n readings of one strip.

    Attributes
    ----------
    force_n : ndarray, shape (n, k)
        Equally spaced, from the onset or higher.
    log_weight : ndarray, shape (n, k)
        Logarithm of the likelihood integrated over the location and to the next force.
    location_mm, variance_mm2 : ndarray, shape (n, k)
        The location that explains the phases best at each force, and its variance.
    """

    force_n: Array
    log_weight: Array
    location_mm: Array
    variance_mm2: Array


def strip_profile(
    model: SensorModel, frequency_hz: float, phases_deg: Array, std_deg: Array
) -> StripProfile:
    """Profile likelihood of phases over the force on a strip.

    Parameters
    ----------
    model : SensorModel
        Of the strip.
    frequency_hz : float
        Carrier, in Hz.
    phases_deg, std_deg : ndarray, shape (n, 2)
        Of a touched strip, with the standard deviations of their noise.

    Notes
    -----
    The likelihood is that of the single strip (``sensor/inversion.py``): noise and the model's own
    error are normal. The forces are chosen about the press that the inversion finds.
    """
    inverter = model.inverter(frequency_hz)
    forward = inverter.forward
    found = inverter.invert(phases_deg, std_deg)
    low, high = forward.force_n[[0, -1]]
    first = np.clip(found.force_n - _REACH * found.force_std_n, low, high)
    last = np.clip(found.force_n + _REACH * found.force_std_n, low, high)
    last = np.maximum(last, first + 1e-6 * high)
    force = first[:, None] + (last - first)[:, None] * np.linspace(0.0, 1.0, _FORCES)
    covariance = found.covariance
    slope = covariance[:, 0, 1] / np.maximum(covariance[:, 0, 0], 1e-12)
    location = found.location_mm[:, None] + slope[:, None] * (force - found.force_n[:, None])
    shape, (start, stop) = force.shape, forward.location_mm[[0, -1]]
    wanted, noise = phases_deg[:, None], std_deg[:, None] ** 2
    location = np.clip(location, start, stop)
    noise = noise + forward.variances(force.ravel(), location.ravel()).reshape(*shape, 2)
    variance = np.maximum(noise, 1e-9)
    for _ in range(_STEPS):
        at = force.ravel(), location.ravel()
        residual = wrap_deg(wanted - forward.phases(*at).reshape(*shape, 2))
        by_location = forward.slopes(*at)[..., 1].reshape(*shape, 2)
        curvature = np.maximum((by_location**2 / variance).sum(axis=-1), 1e-9)
        step = (by_location * residual / variance).sum(axis=-1) / curvature
        location = np.clip(location + step, start, stop)
    # The residual at the last location but one, less what the last step has taken off it.
    left = (residual**2 / variance).sum(axis=-1) - curvature * step**2
    log_weight = -0.5 * (left + np.log(variance).sum(axis=-1) + np.log(curvature))
    log_weight += np.log((last - first) / (_FORCES - 1))[:, None]
    ruler = (model.ruler_std_mm or 0.0) ** 2
    return StripProfile(force, log_weight, location, 1 / curvature + ruler)
