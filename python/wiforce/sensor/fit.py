# SPDX-License-Identifier: GPL-3.0-or-later
"""Curves of phase against force at one location: least squares, smoothing monotone spline."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from . import curves

SPLINE_KNOTS = 8
_SMOOTHING = np.geomspace(1e-8, 1.0, 17)
_RIDGE = 1e-6


@dataclass(frozen=True)
class ForceCurve:
    """One fitted curve: coefficients (K,), their covariance without the noise variance (K, K),

    residuals in order of force, and the degrees of freedom left.
    """

    coefficients: np.ndarray
    unit_covariance: np.ndarray
    residual: np.ndarray
    freedom: float


def force_knots(form, forces):
    """Knots of the basis for calibrations at these forces; None for the power law."""
    low, high = float(np.min(forces)), float(np.max(forces))
    if form == "power":
        return None
    if form == "cubic":
        return np.array([low, high])
    u = np.linspace(curves.touch_down(high), curves.touch_down(low), SPLINE_KNOTS)
    return np.sort(np.clip(u**-3.0, low, high))


class CurveFitter:
    """Fits curves of one form; the spline's smoothing is common to all curves of a sensor.

    Parameters
    ----------
    form : str
        Of :data:`curves.FORMS`.
    knots_n : ndarray or None
    samples : sequence of (force_n, value_deg)
        All curves of the sensor, from which the smoothing is chosen by generalised
        cross-validation (P. Craven and G. Wahba, Numer. Math. 31, 1979).
    """

    def __init__(self, form, knots_n, samples):
        self._basis = curves.force_basis(form, knots_n)
        self.size = self._basis.size
        # rows appended to the least squares, per root of the number of samples
        self._penalty = None
        if form == "spline":
            choices = [np.sqrt(weight) * self._basis.bends() for weight in _SMOOTHING]
            scores = [self._score(samples, penalty) for penalty in choices]
            self._penalty = choices[int(np.argmin(scores))]

    def _score(self, samples, penalty):
        misfit, count, freedom = 0.0, 0, 0.0
        for force, value in samples:
            basis = self._basis(force)
            inverse = _penalised_inverse(basis, penalty)
            misfit += np.sum((value - basis @ (inverse @ (basis.T @ value))) ** 2)
            freedom += len(force) - np.trace(inverse @ basis.T @ basis)
            count += len(force)
        return count * misfit / max(freedom, 1e-9) ** 2

    def fit(self, force_n, value_deg):
        """The curve through the samples.

        Parameters
        ----------
        force_n, value_deg : ndarray, shape (n,)

        Returns
        -------
        ForceCurve
        """
        basis = self._basis(force_n)
        normal = basis.T @ basis
        if self._penalty is None:
            inverse = np.linalg.inv(normal)
            coefficients = np.linalg.lstsq(basis, value_deg, rcond=None)[0]
        else:
            inverse = _penalised_inverse(basis, self._penalty)
            coefficients = _monotone(basis, self._penalty, value_deg)
        freedom = max(len(force_n) - np.trace(inverse @ normal), 1.0)
        residual = (value_deg - basis @ coefficients)[np.argsort(force_n, kind="stable")]
        return ForceCurve(coefficients, inverse, residual, float(freedom))

    def value(self, fit, force_n):
        """The fitted curve at other forces."""
        return self._basis(force_n) @ fit.coefficients


def _penalised_inverse(basis, penalty):
    rows = _penalty_rows(basis, penalty)
    return np.linalg.inv(basis.T @ basis + rows.T @ rows)


def _penalty_rows(basis, penalty):
    """Bends and, so that every coefficient is determined, a trace of its size."""
    rows = np.vstack([penalty, _RIDGE * np.eye(basis.shape[1])])
    return np.sqrt(len(basis)) * rows


def _monotone(basis, penalty, value):
    """Penalised least squares with coefficients that only rise or only fall.

    B-splines with monotone coefficients are monotone. A short widens with force, so a phase rises;
    the far end of a measured sensor may fall all the same, and is then left to.
    """
    size = basis.shape[1]
    rows = _penalty_rows(basis, penalty)
    system = np.vstack([basis, rows])
    right = np.concatenate([value, np.zeros(len(rows))])
    # coefficients = first + cumulative sum of steps of one sign
    cumulate = np.tril(np.ones((size, size)))
    fits = []
    for low, high in ((0.0, np.inf), (-np.inf, 0.0)):
        lower, upper = np.full(size, low), np.full(size, high)
        lower[0], upper[0] = -np.inf, np.inf
        fits.append(lsq_linear(system @ cumulate, right, (lower, upper), method="bvls"))
    return cumulate @ min(fits, key=lambda fit: fit.cost).x


def noise_and_misfit(fits):
    """Standard deviations (deg) of the noise about curves, and of the part of it that is no noise.

    A form that does not fit leaves residuals that are alike at neighbouring forces; noise does not.
    Their product averages to the square of the misfit.

    Parameters
    ----------
    fits : sequence of ForceCurve
    """
    total = sum(np.sum(fit.residual**2) for fit in fits)
    noise = np.sqrt(total / sum(fit.freedom for fit in fits))
    products = np.concatenate([fit.residual[1:] * fit.residual[:-1] for fit in fits])
    return float(noise), float(np.sqrt(max(np.mean(products), 0.0)))
