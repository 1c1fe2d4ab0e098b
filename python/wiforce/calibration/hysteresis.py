# SPDX-License-Identifier: GPL-3.0-or-later
"""Difference between loading and unloading, from calibration data that hold both.

A soft beam opens later than it closed, and creeps while it is held: at the same force, its contact
is that of a larger force while unloading.
"""

from collections.abc import Sequence

import numpy as np

from ..sensor.curves import slope_over_force
from .data import ContactCurve
from .fit import CurveFitter, ForceCurve

# The difference is a polynomial of this degree in force.
_DEGREE = 2
# Fewest rows of loading, and of unloading, that show a difference.
_LEAST_ROWS = 12
# Standard deviations beyond which a difference is not noise: one in 370 at a single force.
_CERTAIN = 3.0
# Forces at which the largest difference is sought.
_FORCES = 50


def find_hysteresis(
    contacts: Sequence[ContactCurve], fits: Sequence[ForceCurve], fitter: CurveFitter
) -> float | None:
    """Compare loading and unloading over all locations and ports of a carrier.

    Returns float or None: largest difference within the calibrated forces, in N: what must be added
    to a force while loading for the contact that it has while unloading. 0 where it is not
    distinguished from noise, None where the data do not hold both branches.

    The residual of a curve, divided by its slope over force, is a deviation in N that all ports and
    locations have in common. Its part of opposite sign in the two branches is fitted by a
    polynomial in force, with weights by the squared slope.

    ``fits``: the curve through each, which lies between its two branches.
    """
    own = [
        (contact, fit)
        for contact, fit in zip(contacts, fits, strict=True)
        if not contact.copied and contact.direction is not None
    ]
    if not own:
        return None
    force, residual, slope, direction = (
        np.concatenate(parts) for parts in zip(*(_rows(*each, fitter) for each in own), strict=True)
    )
    if min(np.sum(direction > 0), np.sum(direction < 0)) < _LEAST_ROWS:
        return None
    low, high = force.min(), force.max()
    powers = _powers(force, low, high) * slope[:, None]
    # The first columns are what both branches have in common, which the curve did not fit.
    design = np.hstack([powers, -direction[:, None] / 2 * powers])
    found, *_ = np.linalg.lstsq(design, residual, rcond=None)
    rest = residual - design @ found
    variance = np.sum(rest**2) / max(len(rest) - len(found), 1)
    covariance = variance * np.linalg.pinv(design.T @ design)
    at = np.linspace(low, high, _FORCES)
    shape = _powers(at, low, high)
    differences = shape @ found[_DEGREE + 1 :]
    std = np.sqrt(np.einsum("fa,ab,fb->f", shape, covariance[_DEGREE + 1 :, _DEGREE + 1 :], shape))
    certain = np.abs(differences) - _CERTAIN * std
    largest = int(np.argmax(certain))
    return float(abs(differences[largest])) if certain[largest] > 0 else 0.0


def _rows(
    contact: ContactCurve, fit: ForceCurve, fitter: CurveFitter
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Forces, residuals, slopes in deg/N and directions of the rows of known direction."""
    assert contact.direction is not None
    known = contact.direction != 0
    force = contact.force_n[known]
    residual = contact.added_deg[known] - fitter.value(fit, force)
    slope = slope_over_force(lambda force_n: fitter.value(fit, force_n), force)
    return force, residual, slope, contact.direction[known]


def _powers(force: np.ndarray, low: float, high: float) -> np.ndarray:
    """Powers of the force, scaled to +-1 within the calibrated ones; shape (n, degree + 1)."""
    scaled = (2 * force - low - high) / max(high - low, 1e-9)
    return scaled[:, None] ** np.arange(_DEGREE + 1)
