# SPDX-License-Identifier: GPL-3.0-or-later
"""Curves of phase over force at each location, and the model of a carrier that they make."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import lsq_linear

from ..sensor import curves, line
from ..sensor.location import LocationInterpolation, learn_interpolation
from ..signal.carrier import wrap_deg
from .data import CarrierData, compared_forces

# Weights of the smoothing of the spline, among which cross-validation chooses.
_SMOOTHING = np.geomspace(1e-8, 1.0, 17)
# Relative weight of the coefficients' size, small enough to have no effect where data exist.
_RIDGE = 1e-6

Samples = Sequence[tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class ForceCurve:
    """One fitted curve: coefficients (K,) of its basis, covariance (K, K) at unit noise.

    ``residual`` (n,), in deg, is by rising force. ``freedom`` is tr((I - A)^2) of the smoother A,
    the sum of squares at unit noise (T. Hastie and R. Tibshirani, *Generalized Additive Models*,
    1990, section 3.5).
    """

    basis: curves.Basis
    force_n: np.ndarray  # rising
    coefficients: np.ndarray
    unit_covariance: np.ndarray
    residual: np.ndarray
    freedom: float

    @cached_property
    def slope(self) -> np.ndarray:
        """In deg/N at its forces, (n,); curves that are only tried need none."""
        return curves.slope_over_force(self.value, self.force_n)

    def value(self, force_n: np.ndarray | float) -> np.ndarray:
        """Phases in degrees at forces in N."""
        return self.basis(force_n) @ self.coefficients


class CurveFitter:
    """Fits curves of one form, with one smoothing for all of a sensor.

    By generalised cross-validation (P. Craven and G. Wahba, Numer. Math. 31, 1979).
    """

    def __init__(self, form: str, knots_n: np.ndarray | None, samples: Samples) -> None:
        self.basis = curves.force_basis(form, knots_n)
        self.size = self.basis.size
        # Rows appended to the least squares, per root of the number of samples: curvature and, so
        # that every coefficient is determined, a small ridge.
        self._penalty = np.zeros((0, self.size))
        if isinstance(self.basis, curves.SplineBasis):
            curvatures, ridge = self.basis.curvatures(), _RIDGE * np.eye(self.size)
            choices = [np.vstack([np.sqrt(w) * curvatures, ridge]) for w in _SMOOTHING]
            bases = [(self.basis(force), value) for force, value in samples]
            scores = [self._score(bases, penalty) for penalty in choices]
            self._penalty = choices[int(np.argmin(scores))]

    @staticmethod
    def _score(samples: Samples, penalty: np.ndarray) -> float:
        """Generalised cross-validation of curves, by their basis (n, K) and values (n,)."""
        squares, count, freedom = 0.0, 0, 0.0
        for basis, value in samples:
            inverse = np.linalg.inv(_penalised_normal(basis, penalty))
            squares += np.sum((value - basis @ (inverse @ (basis.T @ value))) ** 2)
            freedom += len(value) - np.trace(inverse @ basis.T @ basis)
            count += len(value)
        return count * squares / max(freedom, 1e-9) ** 2

    def coefficients(
        self, basis: np.ndarray, value_deg: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients (K,) by samples (n,), of which ``basis`` is (n, K); and what is left free.

        That is a basis (K, f) of the directions that no bound holds.
        """
        if not len(self._penalty):
            return np.linalg.lstsq(basis, value_deg, rcond=None)[0], np.eye(self.size)
        return _monotone(basis, self._penalty, value_deg)

    def fit(self, force_n: np.ndarray, value_deg: np.ndarray) -> ForceCurve:
        """Fit a curve to samples (n,)."""
        basis = self.basis(force_n)
        coefficients, free = self.coefficients(basis, value_deg)
        precision = _penalised_normal(basis, self._penalty)
        # As small a matrix as A has columns or rows, with the same squares.
        triangle = np.asarray(np.linalg.qr(basis @ free, mode="r"))
        smoother = triangle @ np.linalg.solve(free.T @ precision @ free, triangle.T)
        left = np.sum((np.eye(len(triangle)) - smoother) ** 2)
        # A curve through all samples leaves rounding errors, which must not be divided by 0.
        freedom = max(len(force_n) - len(triangle) + left, np.finfo(float).eps)
        order = np.argsort(force_n, kind="stable")
        residual = (value_deg - basis @ coefficients)[order]
        own = self.basis, force_n[order], coefficients, np.linalg.inv(precision)
        return ForceCurve(*own, residual, float(freedom))


def _penalised_normal(basis: np.ndarray, penalty: np.ndarray) -> np.ndarray:
    rows = np.sqrt(len(basis)) * penalty
    return basis.T @ basis + rows.T @ rows


def _monotone(
    basis: np.ndarray, penalty: np.ndarray, value: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Penalised least squares of rising or falling coefficients (K,), and a basis (K, f) left free.

    A short widens with force; falling curves are allowed as measured sensors' far ends have them.
    """
    size = basis.shape[1]
    system = np.vstack([basis, np.sqrt(len(basis)) * penalty])
    right = np.concatenate([value, np.zeros(len(penalty))])
    # coefficients = first + cumulative sum of steps of one sign
    cumulate = np.tril(np.ones((size, size)))
    fits = []
    for low, high in ((0.0, np.inf), (-np.inf, 0.0)):
        lower, upper = np.full(size, low), np.full(size, high)
        lower[0], upper[0] = -np.inf, np.inf
        fits.append(lsq_linear(system @ cumulate, right, (lower, upper), method="bvls"))
        if not fits[-1].active_mask.any():
            break  # no bound holds it, so that none fits better
    best = min(fits, key=lambda fit: fit.cost)
    return cumulate @ best.x, cumulate[:, best.active_mask == 0]


def noise_and_misfit(fits: Sequence[ForceCurve]) -> tuple[float, float]:
    """Scatter about the curves, and the part by products of neighbouring residuals, in deg."""
    total = sum(np.sum(fit.residual**2) for fit in fits)
    noise = np.sqrt(total / sum(fit.freedom for fit in fits))
    products = np.concatenate([fit.residual[1:] * fit.residual[:-1] for fit in fits])
    return float(noise), float(np.sqrt(max(np.mean(products), 0.0)))


# No press is so wide that it moves a short by more than this beyond what the line does.
_LARGEST_EXTENT_MM = 30.0


@dataclass(frozen=True)
class ContactValues:
    """Phases (2, J, n) that the contact adds at J locations and some forces; variance (2, J)."""

    data: CarrierData
    location_mm: np.ndarray
    added_deg: np.ndarray
    variance_deg2: np.ndarray

    def without(self, index: int) -> "ContactValues":
        """Those of all locations but one."""
        place, added = np.delete(self.location_mm, index), np.delete(self.added_deg, index, axis=1)
        return ContactValues(self.data, place, added, np.delete(self.variance_deg2, index, axis=1))

    def interpolation(self) -> LocationInterpolation:
        """How to go between these locations."""
        slope = line.round_trip_deg_per_mm(self.data.frequency_hz)
        return learn_interpolation(
            self.location_mm,
            self.data.length_mm,
            self.added_deg,
            np.mean(self.variance_deg2),
            np.ptp(self.added_deg, axis=1).max() < _LARGEST_EXTENT_MM * slope,
        )


@dataclass(frozen=True)
class CarrierFit:
    """Fitted curves of one carrier, their contact, and what a sensor model holds of them."""

    data: CarrierData
    fitter: CurveFitter
    fits: list[ForceCurve]  # of the data's curves
    contact: ContactValues
    carrier: curves.Carrier


def fit_carrier(data: CarrierData, form: str, knots: np.ndarray | None) -> CarrierFit:
    """Fit the curves of one carrier's data."""
    fitter = CurveFitter(form, knots, [(c.force_n, c.added_deg) for c in data.curves])
    fits = [fitter.fit(c.force_n, c.added_deg) for c in data.curves]
    count, size = len(data.location_mm), fitter.size
    noise, misfit = zip(*map(noise_and_misfit, (fits[:count], fits[count:])), strict=True)
    coefficients = np.reshape([fit.coefficients for fit in fits], (2, count, size))
    covariance = np.reshape([fit.unit_covariance for fit in fits], (2, count, size, size))
    covariance = covariance * np.square(noise)[:, None, None, None]
    basis = fitter.basis(compared_forces(data))
    contact = ContactValues(
        data,
        data.location_mm,
        np.einsum("pjk,fk->pjf", coefficients, basis),
        np.einsum("fk,pjkm,fm->pj", basis, covariance, basis) / len(basis),
    )
    untouched = data.untouched_deg
    if untouched is None:
        psi = line.open_phase_deg(data.length_mm, data.frequency_hz, data.permittivity)
        untouched = (float(wrap_deg(psi)),) * 2
    spans = np.reshape([curve.force_n[[0, -1]] for curve in data.curves], (2, -1, 2))
    difference_n = find_hysteresis(data, fits)
    carrier = curves.Carrier(
        frequency_hz=data.frequency_hz,
        untouched_deg=untouched,
        location_mm=data.location_mm,
        force_span_n=np.column_stack([spans[..., 0].max(axis=0), spans[..., 1].min(axis=0)]),
        coefficients_deg=coefficients,
        covariance_deg2=covariance,
        noise_deg=noise,
        misfit_deg=misfit,
        interpolation=contact.interpolation().transitions,
        hysteresis_n=None if difference_n is None else difference_n / 2,
    )
    return CarrierFit(data, fitter, fits, contact, carrier)


# The difference between loading and unloading is a polynomial of this degree in force.
_DEGREE = 2
# Fewest rows of loading, and of unloading, that show a difference.
_LEAST_ROWS = 12
# Standard deviations beyond which a difference is not noise: one in 370 at a single force.
_CERTAIN = 3.0
# Forces at which the largest difference is sought.
_FORCES = 50


def find_hysteresis(data: CarrierData, fits: Sequence[ForceCurve]) -> float | None:
    """What must at most be added to a force, in N, for the contact that it has while unloading.

    A soft beam opens later than it closed, and creeps: residuals over the slope, of opposite sign
    in the two branches, are fitted by a polynomial in force. 0 within noise, None without both.
    """
    rows = [
        (c.force_n, fit.residual, fit.slope, c.direction)
        for c, fit in zip(data.curves, fits, strict=True)
        if not c.copied
    ]
    columns = np.concatenate([np.array(row, float) for row in rows], axis=1)
    force, residual, slope, direction = columns[:, columns[3] != 0]
    if min(np.sum(direction > 0), np.sum(direction < 0)) < _LEAST_ROWS:
        return None
    low, high = force.min(), force.max()

    def powers(force: np.ndarray) -> np.ndarray:
        scaled = (2 * force - low - high) / max(high - low, 1e-9)
        return scaled[:, None] ** np.arange(_DEGREE + 1)

    common = powers(force) * slope[:, None]
    # The first columns are what both branches have in common, which the curve did not fit.
    design = np.hstack([common, -direction[:, None] / 2 * common])
    found, *_ = np.linalg.lstsq(design, residual, rcond=None)
    rest = residual - design @ found
    variance = np.sum(rest**2) / max(len(rest) - len(found), 1)
    covariance = variance * np.linalg.pinv(design.T @ design)[_DEGREE + 1 :, _DEGREE + 1 :]
    shape = powers(np.linspace(low, high, _FORCES))
    difference = np.abs(shape @ found[_DEGREE + 1 :])
    certain = difference - _CERTAIN * np.sqrt(np.sum(shape @ covariance * shape, axis=1))
    largest = int(np.argmax(certain))
    return float(difference[largest]) if certain[largest] > 0 else 0.0
