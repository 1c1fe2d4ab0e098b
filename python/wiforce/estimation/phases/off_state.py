# SPDX-License-Identifier: GPL-3.0-or-later
"""Off state of the switches: its correction, and its estimation from presses.

The channel of an end is proportional to D = G - G_off, so that R = (G - G_off) / (G_0 - G_off). As
the phase of G changes, R moves along a circle, whose centre is 0 only if G_off is 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...errors import InputError
from ..groups import Array

# Arc of R below which the centre of its circle is not determined: with 40 deg and a noise of 1 deg
# a hundred groups leave a standard deviation of 0.04, three hundred 0.02.
_SMALLEST_ARC_DEG = 40.0
# An off state that is wrong by this causes phase errors of up to 1.7 deg.
_LARGEST_STD = 0.03


def corrected_phase_deg(
    ratios: Array, untouched_deg: ArrayLike, off_reflection: ArrayLike = 0.0
) -> tuple[Array, Array]:
    """Phases psi_i of R (..., 2), corrected for the off state G_off / rho, and |d psi / d arg R|.

    G_i = G_off + R_i (G_i0 - G_off), psi_i = psi_i0 + arg(G_i / G_i0) (docs/theory.md).
    """
    off = np.asarray(off_reflection)
    switched = ratios * (np.exp(1j * np.radians(untouched_deg)) - off)
    reflections = off + switched
    phases = np.degrees(np.arctan2(reflections.imag, reflections.real))
    phases[phases <= -180] += 360
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.abs(switched) / np.abs(reflections)
    return phases, slope


def estimate_off_reflection(
    ratios: ArrayLike, untouched_deg: float, std_deg: ArrayLike = 1.0
) -> tuple[complex, float]:
    """Estimate G_off / rho of one end, and the std of its parts, from R (n,) of several presses.

    With the correct one |G_off + R (G_0 - G_off)| is the same in all presses, whatever their force;
    a robust loss ignores groups in which a press changes. InputError where it is not determined.
    """
    from scipy.optimize import least_squares

    values = np.asarray(ratios, complex).ravel()
    untouched = np.exp(1j * np.radians(untouched_deg))
    start = _circle_start(values, untouched)
    spread = np.radians(np.broadcast_to(std_deg, values.shape)) * np.abs(values)

    def residual(parts: Array) -> Array:
        off = complex(*parts)
        difference = untouched - off
        return (np.abs(off + values * difference) - 1) / (spread * np.abs(difference))

    fit = least_squares(residual, [start.real, start.imag], loss="soft_l1")
    scatter = max(1.4826 * np.median(np.abs(residual(fit.x))), 1.0)
    std = scatter * np.sqrt(np.trace(np.linalg.pinv(fit.jac.T @ fit.jac)) / 2)
    if not (std < _LARGEST_STD and np.hypot(*fit.x) < 1):
        rule = f"is uncertain by {std:.2g}, above {_LARGEST_STD:g}: press longer and harder"
        raise InputError("off_reflection", rule)
    return complex(*fit.x), float(std)


class OffCircle(NamedTuple):
    """Off state by the circle of touched ratios."""

    off: complex  # G_off / rho
    std: float  # of its real and imaginary parts, by the scatter about the circle


def off_circle(ratios: Array, untouched_deg: float) -> OffCircle | None:
    """G_off / rho from touched R (n,) alone; a lossy contact may scale all. None below 40 deg."""
    middle = np.mean(ratios)
    arc = np.ptp(np.degrees(np.angle(ratios / middle))) if middle else 0.0
    if len(ratios) < 6 or arc < _SMALLEST_ARC_DEG:
        return None
    matrix = np.stack([2 * ratios.real, 2 * ratios.imag, np.ones(len(ratios))], axis=1)
    power = np.abs(ratios) ** 2
    solution = np.linalg.lstsq(matrix, power, rcond=None)[0]
    center = complex(solution[0], solution[1])
    residual = power - matrix @ solution
    variance = residual @ residual / (len(ratios) - 3)
    spread = np.sqrt(variance * np.trace(np.linalg.inv(matrix.T @ matrix)[:2, :2]) / 2)
    if not abs(center) < 1:
        return None
    untouched = np.exp(1j * np.radians(untouched_deg))
    off = complex(center * untouched / (center - 1))
    return OffCircle(off, float(spread / abs(center - 1) ** 2))


def _circle_start(ratios: Array, untouched: complex) -> complex:
    """G_off / rho from the circle through R = 1 on which R lies; its arc must be long enough."""
    points = np.concatenate([[1.0 + 0j], ratios])
    # x^2 + y^2 = 2 a x + 2 b y + c, linear in centre (a, b); R = 1 is known without noise.
    weights = np.r_[np.sqrt(len(points)), np.ones(len(points) - 1)]
    matrix = np.stack([2 * points.real, 2 * points.imag, np.ones(len(points))], axis=1)
    power = np.abs(points) ** 2
    solution, *_ = np.linalg.lstsq(matrix * weights[:, None], power * weights, rcond=None)
    center = solution[0] + 1j * solution[1]
    arc = np.ptp(np.degrees(np.angle((points - center) / (1 - center))))
    # Noise about R = 1 fits a circle of its own: the phase of R itself must change.
    arc = min(arc, 2 * np.ptp(np.degrees(np.angle(points))))
    if len(points) < 4 or arc < _SMALLEST_ARC_DEG:
        rule = f"needs presses that turn the phase through {_SMALLEST_ARC_DEG:g} deg or more"
        raise InputError("off_reflection", rule, round(float(arc), 1))
    return complex(center * untouched / (center - 1))
