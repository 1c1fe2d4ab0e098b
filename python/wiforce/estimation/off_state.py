# SPDX-License-Identifier: GPL-3.0-or-later
"""The switches' off state: what it does to a phase, and how presses give it away.

An end reads D = G - G_off, so that R = (G - G_off) / (G_0 - G_off): as the phase of G turns, R
runs on a circle that is centred on 0 with radius 1 only when G_off is 0.
"""

import numpy as np

from ..errors import InputError

# Arc below which a circle's centre cannot be told from noise.
_SMALLEST_ARC_DEG = 40.0


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


def estimate_off_reflection(ratios, untouched_deg):
    """G_off / rho of one end from ratios at several presses, by a circle through R = 1.

    Parameters
    ----------
    ratios : ndarray of complex, shape (n,)
        R of one end in touched groups; the forces need not be known.
    untouched_deg : float
        psi_i0 of that end.

    Returns
    -------
    complex

    Raises
    ------
    InputError
        When the presses turn the phase through too small an arc to tell.
    """
    points = np.concatenate([[1.0 + 0j], np.asarray(ratios, complex).ravel()])
    # x^2 + y^2 = 2 a x + 2 b y + c, linear in centre (a, b); R = 1 is known without noise.
    weights = np.r_[np.sqrt(len(points)), np.ones(len(points) - 1)]
    matrix = np.stack([2 * points.real, 2 * points.imag, np.ones(len(points))], axis=1)
    power = np.abs(points) ** 2
    solution, *_ = np.linalg.lstsq(matrix * weights[:, None], power * weights, rcond=None)
    center = solution[0] + 1j * solution[1]
    arc = np.ptp(np.degrees(np.angle((points - center) / (1 - center))))
    if len(points) < 4 or arc < _SMALLEST_ARC_DEG:
        rule = f"needs presses that turn the phase through {_SMALLEST_ARC_DEG:g} deg or more"
        raise InputError("off reflection", rule, round(float(arc), 1))
    untouched = np.exp(1j * np.radians(untouched_deg))
    return complex(center * untouched / (center - 1))
