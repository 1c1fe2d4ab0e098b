# SPDX-License-Identifier: GPL-3.0-or-later
"""Fit of phase over force at one location: least squares, or a smoothing monotone spline."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from ..sensor import curves

# Knots of the spline, at equal steps of touch-down. Their freedom is limited by smoothing, whose
# weight is chosen among these by cross-validation.
SPLINE_KNOTS = 8
_SMOOTHING = np.geomspace(1e-8, 1.0, 17)
# Relative weight of the coefficients' size, small enough to have no effect where data exist.
_RIDGE = 1e-6

Samples = Sequence[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class ForceCurve:
    """One fitted curve.

    ``coefficients`` (K,): in degrees; ``unit_covariance`` (K, K): of the coefficients, for noise of
    unit variance; ``residual`` (n,): in degrees, in order of force; ``freedom``: remaining degrees
    of freedom.
    """

    coefficients: np.ndarray
    unit_covariance: np.ndarray
    residual: np.ndarray
    freedom: float


def force_knots(form: str, forces: np.ndarray) -> np.ndarray | None:
    """Knots of the functions of force.

    Returns ndarray or None: in N, rising; None for the power law.

    ``forces``: calibrated forces, in N.
    """
    low, high = float(np.min(forces)), float(np.max(forces))
    if form == "power":
        return None
    if form == "cubic":
        return np.array([low, high])
    u = np.linspace(curves.touch_down(high), curves.touch_down(low), SPLINE_KNOTS)
    return np.sort(np.clip(u**-3.0, low, high))


class CurveFitter:
    """Fits curves of one form; the spline's smoothing is common to all curves of a sensor.

    ``samples``: all curves of the sensor, from which the smoothing is chosen by generalised
    cross-validation (P. Craven and G. Wahba, Numer. Math. 31, 1979).
    """

    def __init__(self, form: str, knots_n: np.ndarray | None, samples: Samples) -> None:
        self._basis = curves.force_basis(form, knots_n)
        self.size = self._basis.size
        # rows appended to the least squares, per root of the number of samples
        self._penalty: np.ndarray | None = None
        if form == "spline":
            choices = [np.sqrt(weight) * self._basis.curvatures() for weight in _SMOOTHING]
            scores = [self._score(samples, penalty) for penalty in choices]
            self._penalty = choices[int(np.argmin(scores))]

    def _score(self, samples: Samples, penalty: np.ndarray) -> float:
        squares, count, freedom = 0.0, 0, 0.0
        for force, value in samples:
            basis = self._basis(force)
            inverse = _penalised_inverse(basis, penalty)
            squares += np.sum((value - basis @ (inverse @ (basis.T @ value))) ** 2)
            freedom += len(force) - np.trace(inverse @ basis.T @ basis)
            count += len(force)
        return count * squares / max(freedom, 1e-9) ** 2

    def fit(self, force_n: np.ndarray, value_deg: np.ndarray) -> ForceCurve:
        """Fit a curve to samples.

        ``force_n``, ``value_deg`` (n,).
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

    def value(self, fit: ForceCurve, force_n: np.ndarray | float) -> np.ndarray:
        """Evaluate a fitted curve, in degrees, at forces in N."""
        return self._basis(force_n) @ fit.coefficients


def _penalised_inverse(basis: np.ndarray, penalty: np.ndarray) -> np.ndarray:
    rows = _penalty_rows(basis, penalty)
    return np.linalg.inv(basis.T @ basis + rows.T @ rows)


def _penalty_rows(basis: np.ndarray, penalty: np.ndarray) -> np.ndarray:
    """Curvature and, so that every coefficient is determined, a small ridge."""
    rows = np.vstack([penalty, _RIDGE * np.eye(basis.shape[1])])
    return np.sqrt(len(basis)) * rows


def _monotone(basis: np.ndarray, penalty: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Penalised least squares with coefficients that only rise or only fall.

    B-splines with monotone coefficients are monotone. A short widens with force, so a phase rises
    in theory; falling curves are allowed because the far end of measured sensors has them.
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


def noise_and_misfit(fits: Iterable[ForceCurve]) -> tuple[float, float]:
    """Standard deviation of the samples about the curves, and its systematic part.

    Returns noise_deg and misfit_deg, in degrees.

    Noise is independent at neighbouring forces, a misfit of the form is not. The mean product of
    neighbouring residuals therefore is the square of the misfit.
    """
    fits = list(fits)
    total = sum(np.sum(fit.residual**2) for fit in fits)
    noise = np.sqrt(total / sum(fit.freedom for fit in fits))
    products = np.concatenate([fit.residual[1:] * fit.residual[:-1] for fit in fits])
    return float(noise), float(np.sqrt(max(np.mean(products), 0.0)))
