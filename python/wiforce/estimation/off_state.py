# SPDX-License-Identifier: GPL-3.0-or-later
"""The switches' off state: what it does to a phase, and how presses give it away.

An end reads D = G - G_off, so that R = (G - G_off) / (G_0 - G_off): as the phase of G turns, R
runs on a circle that is centred on 0 with radius 1 only when G_off is 0.
"""

import numpy as np

from ..errors import InputError

# Arc below which a circle's centre cannot be told from noise.
_SMALLEST_ARC_DEG = 40.0
_LARGEST_STD = 0.03


def corrected_phase_deg(ratios, untouched_deg, off_reflection=0.0):
    """Phases psi_i of the ends' reflections, off state taken out.

    G_i = G_off + R_i (G_i0 - G_off); psi_i = psi_i0 + arg(G_i / G_i0).

    Parameters
    ----------
    ratios : ndarray of complex, shape (..., 2)
        R.
    untouched_deg : array_like, shape (2,)
        psi_i0.
    off_reflection : complex or array_like, shape (2,)
        G_off / rho at the reference plane of psi.

    Returns
    -------
    phases_deg : ndarray, shape (..., 2)
        In (-180, 180].
    slope : ndarray, shape (..., 2)
        |d psi / d arg R|: by how much a phase error of R counts.
    """
    untouched = np.exp(1j * np.radians(untouched_deg))
    difference = untouched - np.asarray(off_reflection)
    turned = np.asarray(ratios) * difference
    reflections = np.asarray(off_reflection) + turned
    phases = np.degrees(np.angle(reflections))
    phases = np.where(phases <= -180, phases + 360, phases)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.abs(turned) / np.abs(reflections)
    return phases, slope


def estimate_off_reflection(ratios, untouched_deg, std_deg=1.0):
    """G_off / rho of one end from its ratios in several presses.

    The forces need not be known: with the right off state every |G| = |G_off + R (G_0 - G_off)|
    is the same. Groups in which the press changes are outvoted.

    Parameters
    ----------
    ratios : ndarray of complex, shape (n,)
        R of the end, touched groups among them, the tag standing still.
    untouched_deg : float
        psi_i0 of that end.
    std_deg : float or ndarray, shape (n,)
        Standard deviations of arg R.

    Returns
    -------
    value : complex
    std : float
        Standard deviation of its real and imaginary parts.

    Raises
    ------
    InputError
        When the presses turn the phase through too small an arc to tell.
    """
    from scipy.optimize import least_squares

    ratios = np.asarray(ratios, complex).ravel()
    untouched = np.exp(1j * np.radians(untouched_deg))
    start = _circle_start(ratios, untouched)
    spread = np.radians(np.broadcast_to(std_deg, ratios.shape)) * np.abs(ratios)

    def misfit(parts):
        off = complex(*parts)
        difference = untouched - off
        return (np.abs(off + ratios * difference) - 1) / (spread * np.abs(difference))

    fit = least_squares(misfit, [start.real, start.imag], loss="soft_l1")
    scatter = max(1.4826 * np.median(np.abs(misfit(fit.x))), 1.0)
    std = scatter * np.sqrt(np.trace(np.linalg.pinv(fit.jac.T @ fit.jac)) / 2)
    if not (std < _LARGEST_STD and np.hypot(*fit.x) < 1):
        rule = f"is uncertain by {std:.2g}, above {_LARGEST_STD:g}: press longer and harder"
        raise InputError("off_reflection", rule)
    return complex(*fit.x), float(std)


def _circle_start(ratios, untouched):
    """G_off / rho by the circle on which R runs, through R = 1; its arc must be long enough."""
    points = np.concatenate([[1.0 + 0j], ratios])
    # x^2 + y^2 = 2 a x + 2 b y + c, linear in centre (a, b); R = 1 is known without noise.
    weights = np.r_[np.sqrt(len(points)), np.ones(len(points) - 1)]
    matrix = np.stack([2 * points.real, 2 * points.imag, np.ones(len(points))], axis=1)
    power = np.abs(points) ** 2
    solution, *_ = np.linalg.lstsq(matrix * weights[:, None], power * weights, rcond=None)
    center = solution[0] + 1j * solution[1]
    arc = np.ptp(np.degrees(np.angle((points - center) / (1 - center))))
    # A cloud of noise about 1 fits a circle of its own: R itself must turn.
    arc = min(arc, 2 * np.ptp(np.degrees(np.angle(points))))
    if len(points) < 4 or arc < _SMALLEST_ARC_DEG:
        rule = f"needs presses that turn the phase through {_SMALLEST_ARC_DEG:g} deg or more"
        raise InputError("off_reflection", rule, round(float(arc), 1))
    return complex(center * untouched / (center - 1))
