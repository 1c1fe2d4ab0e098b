# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibrated curves: the phase of each end as a function of force and location.

``psi_i(F, l) = 180 deg - 2 beta d_i0(l) + g_i(F, l)``, with ``d_10 = l`` and ``d_20 = L - l``: the
line's physics carries the location, and ``g_i``, what the calibration adds, is smooth in both
arguments. ``g_i(F, l) = sum_j w_j(l) sum_k c_ijk B_k(F)``: coefficients c at the calibrated
locations j, basis functions B of force, weights w of location. It is linear in the coefficients, so
their covariance carries over to every phase.
"""

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from . import line
from .model import SensorModel

FORMS = ("cubic", "power", "spline")


class PowerBasis:
    """1, F^(-1/3), F: touch-down of a beam under a point load plus a linear term."""

    size = 3

    def __init__(self, knots_n=None):
        pass

    def __call__(self, force_n, derivative=0):
        force = np.asarray(force_n, float)
        one = np.ones_like(force)
        if derivative == 0:
            return np.stack([one, np.cbrt(1 / force), force], axis=-1)
        return np.stack([0 * one, -np.cbrt(1 / force) / (3 * force), one], axis=-1)


class CubicBasis:
    """1, F, F^2, F^3 (the paper's fit); straight lines outside the two knots."""

    size = 4

    def __init__(self, knots_n):
        self._low, self._high = float(knots_n[0]), float(knots_n[-1])

    def __call__(self, force_n, derivative=0):
        force = np.asarray(force_n, float)
        inside = np.clip(force, self._low, self._high)
        slope = inside[..., None] ** np.array([0, 0, 1, 2]) * np.arange(4)
        if derivative:
            return slope
        value = inside[..., None] ** np.arange(4)
        return value + (force - inside)[..., None] * slope


_BASES = {"power": PowerBasis, "cubic": CubicBasis}


def force_basis(form, knots_n=None):
    """The basis functions of force named ``form``.

    Returns
    -------
    callable
        ``basis(force, derivative=0) -> ndarray (..., size)``, derivative 0 or 1.
    """
    return _BASES[form](knots_n)


class LocationWeights:
    """Weights of the calibrated locations at any location: the polynomial through all of them.

    Outside the calibrated span the weights stay those of its nearer end, so that the line's physics
    alone carries the location on.
    """

    def __init__(self, location_mm):
        self._at = np.asarray(location_mm, float)

    def __call__(self, location_mm):
        """Shape (..., number of calibrated locations)."""
        x = np.clip(np.asarray(location_mm, float), self._at[0], self._at[-1])[..., None]
        weights = np.ones((*x.shape[:-1], self._at.size))
        for j, other in enumerate(self._at):
            factor = (x - other) / np.where(self._at == other, 1.0, self._at - other)
            weights *= np.where(np.arange(self._at.size) == j, 1.0, factor)
        return weights


@dataclass(frozen=True)
class Carrier:
    """Curves at one carrier.

    Attributes
    ----------
    frequency_hz : float
    untouched_deg : (float, float)
    location_mm : ndarray, shape (J,)
        Calibrated locations, ascending.
    force_span_n : ndarray, shape (J, 2)
    coefficients_deg : ndarray, shape (2, J, K)
    covariance_deg2 : ndarray, shape (2, J, K, K)
    noise_deg : (float, float)
        Scatter of the calibration data about the curves, per port.
    """

    frequency_hz: float
    untouched_deg: tuple
    location_mm: np.ndarray
    force_span_n: np.ndarray
    coefficients_deg: np.ndarray
    covariance_deg2: np.ndarray
    noise_deg: tuple


@dataclass(frozen=True)
class CurveModel(SensorModel):
    """A sensor known by its calibration.

    Attributes
    ----------
    form : str
        ``cubic``, ``power`` or ``spline``.
    carriers : tuple of Carrier
    knots_n : ndarray or None
        Knots of the force basis, where it has any.
    permittivity : float
    """

    form: str = "power"
    carriers: tuple = ()
    knots_n: np.ndarray = None
    permittivity: float = 1.0

    def _untouched_deg(self, carrier):
        return np.asarray(self.carriers[carrier].untouched_deg, float)

    def _short_deg(self, force, location, carrier):
        curves = self.carriers[carrier]
        basis = force_basis(self.form, self.knots_n)(force)
        weights = LocationWeights(curves.location_mm)(location)
        correction = np.einsum("...j,pjk,...k->...p", weights, curves.coefficients_deg, basis)
        distance = np.stack([location, self.length_mm - location], axis=-1)
        return correction + line.short_phase_deg(distance, curves.frequency_hz, self.permittivity)

    def _model_std_deg(self, force, location, carrier):
        curves = self.carriers[carrier]
        basis = force_basis(self.form, self.knots_n)(force)
        weights = LocationWeights(curves.location_mm)(location)
        variance = np.einsum(
            "...j,...k,pjkm,...m->...p", weights**2, basis, curves.covariance_deg2, basis
        )
        return np.sqrt(variance)


def check_form(where, form):
    """Raises InputError unless ``form`` is one of FORMS."""
    if form not in FORMS:
        raise InputError(where, f"must be one of {', '.join(FORMS)}", form)
