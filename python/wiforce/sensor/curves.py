# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibrated curves: the phase of each end as a function of force and location.

``psi_i(F, l) = 180 deg - 2 beta d_i0(l) + g_i(F, l)``, with ``d_10 = l`` and ``d_20 = L - l``: the
line's physics carries the location, and ``g_i``, what the calibration adds, is smooth in both
arguments. ``g_i(F, l) = sum_j w_ij(l) sum_k c_ijk B_k(F)``: coefficients c at the calibrated
locations j, basis functions B of force, weights w of location. It is linear in the coefficients, so
their covariance carries over to every phase.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from ..io.text.schema import Derived, ListOf, Mapping, declared, key
from ..io.text.values import (
    LARGEST,
    AnyMapping,
    Choice,
    Integer,
    KeyPath,
    Number,
    Scope,
    Size,
)
from ..io.text.values import Array as Numbers
from ..signal.carrier import wrap_deg
from . import line
from .line import LEAST, LEAST_FREQUENCY_HZ, MAX_FORCE_N, MAX_LENGTH_MM, transfer_std_deg
from .location import SHAPES, LocationInterpolation, Transition
from .model import SensorModel
from .splines import Array, basis_splines

# Knots of a calibrated spline, at equal steps of touch-down. Smoothing limits their freedom.
SPLINE_KNOTS = 8
# Relative step of the force for the slope of a phase.
_SLOPE_STEP = 0.01


def slope_over_force(curve: Callable[[np.ndarray], np.ndarray], force_n: np.ndarray) -> np.ndarray:
    """Slope in deg/N, by central differences, of a curve of phases over forces above 0."""
    step = _SLOPE_STEP * force_n
    change = curve(force_n + step) - curve(force_n - step)
    return change / (2 * step).reshape(step.shape + (1,) * (change.ndim - step.ndim))


class PowerBasis:
    """1, F^(-1/3), F: touch-down of a beam under a point load plus a linear term."""

    size, constant = 3, (1.0, 0.0, 0.0)  # ``constant``: coefficients of 1

    def __init__(self, knots_n: Array | None = None) -> None:
        pass

    @staticmethod
    def knots_of(force_n: Array) -> None:
        """No knots, whatever the calibrated forces (n,) in N."""

    def __call__(self, force_n: ArrayLike) -> Array:
        force = np.asarray(force_n, float)
        return np.stack([np.ones_like(force), np.cbrt(1 / force), force], axis=-1)


class CubicBasis:
    """1, F, F^2, F^3, the paper's fit; straight lines outside the first and the last knot."""

    size, constant = 4, (1.0, 0.0, 0.0, 0.0)

    def __init__(self, knots_n: Array) -> None:
        self._low, self._high = float(knots_n[0]), float(knots_n[-1])

    @staticmethod
    def knots_of(force_n: Array) -> Array:
        """Least and largest of the calibrated forces (n,), in N; shape (2,)."""
        return np.array([np.min(force_n), np.max(force_n)])

    def __call__(self, force_n: ArrayLike) -> Array:
        force = np.asarray(force_n, float)
        inside = np.clip(force, self._low, self._high)
        value = inside[..., None] ** np.arange(4)
        slope = inside[..., None] ** np.array([0, 0, 1, 2]) * np.arange(4)
        return value + (force - inside)[..., None] * slope


class SplineBasis:
    """Cubic B-splines in u = F^(-1/3), in which touch-down is a straight line; linear outside."""

    def __init__(self, knots_n: Array) -> None:
        self._u = np.sort(touch_down(knots_n))
        self._knots = np.concatenate([[self._u[0]] * 3, self._u, [self._u[-1]] * 3])
        self.size = len(self._u) + 2
        self.constant = (1.0,) * self.size  # B-splines sum to one

    @staticmethod
    def knots_of(force_n: Array) -> Array:
        """Knots over the calibrated forces (n,), rising, in N; shape (SPLINE_KNOTS,)."""
        low, high = float(np.min(force_n)), float(np.max(force_n))
        u = np.linspace(touch_down(high), touch_down(low), SPLINE_KNOTS)
        return np.sort(np.clip(u**-3.0, low, high))

    def __call__(self, force_n: ArrayLike) -> Array:
        u = touch_down(force_n)
        inside = np.clip(u, self._u[0], self._u[-1])
        value = basis_splines(self._knots, inside)
        if np.array_equal(u, inside):
            return value
        return value + (u - inside)[..., None] * basis_splines(self._knots, inside, 1)

    def curvatures(self) -> Array:
        """Second derivatives (points, size) over the span of u, whose squares sum to their mean."""
        at = np.linspace(self._u[0], self._u[-1], 8 * len(self._u))
        span = self._u[-1] - self._u[0]
        return span**2 * basis_splines(self._knots, at, 2) / np.sqrt(len(at))


def touch_down(force_n: ArrayLike) -> Array:
    """F^(-1/3)."""
    return np.cbrt(1 / np.asarray(force_n, float))


Basis = PowerBasis | CubicBasis | SplineBasis
# The simplest first.
_BASES: dict[str, type[Basis]] = {"power": PowerBasis, "cubic": CubicBasis, "spline": SplineBasis}
FORMS = tuple(_BASES)


def force_basis(form: str, knots_n: Array | None = None) -> Basis:
    """The basis functions of force named ``form``: ``basis(force) -> ndarray (..., size)``."""
    return _BASES[form](cast("Array", knots_n))


def force_knots(form: str, force_n: Array) -> Array | None:
    """Knots of a form over calibrated forces (n,), rising, in N; None for a form without them."""
    return _BASES[form].knots_of(force_n)


_LOCATIONS = Size("locations", lambda scope: len(scope["location_mm"]))
_COEFFICIENTS = Size(
    "coefficients", lambda scope: force_basis(scope["form"], scope["knots_n"]).size
)


def _check_knots(knots_n: np.ndarray | None, scope: Scope) -> str | None:
    if scope["form"] == "power":
        return None if knots_n is None else "must be left out where form is 'power'"
    if knots_n is None or len(knots_n) < 2 or np.any(np.diff(knots_n, prepend=0) < LEAST):
        return f"must be at least two rising positive forces, {LEAST:g} apart"
    return None


def _check_locations(location_mm: np.ndarray, scope: Scope) -> str | None:
    if len(location_mm) < 2 or np.any(np.diff(location_mm) < LEAST):
        return f"must be at least two rising locations, {LEAST:g} apart"
    if location_mm[0] < 0 or location_mm[-1] > scope["length_mm"]:
        return f"must lie from 0 to {scope['length_mm']:g}"
    return None


def _check_covariances(matrices: np.ndarray, scope: Scope) -> str | None:
    """Symmetric and without negative eigenvalues, except for rounding."""
    size = np.abs(matrices).max(axis=(-2, -1))
    asymmetry = np.abs(matrices - np.swapaxes(matrices, -2, -1)).max(axis=(-2, -1))
    least = np.linalg.eigvalsh(matrices)[..., 0]
    if np.all((asymmetry <= 1e-6 * size) & (least >= -1e-6 * size)):
        return None
    return "must hold symmetric, non-negative matrices"


def _check_transitions(transitions: tuple[Transition, ...], scope: Scope) -> str | None:
    total = sum(transition.probability for transition in transitions)
    if abs(total - 1) > 1e-6:
        return f"must have probabilities that sum to 1, not to {total:g}"
    return None


# The columns of a transition before version 1.0, when it was a row of numbers; the shape was its
# position in SHAPES.
_COLUMNS = "shape fade_mm shift_mm residual_length_mm probability residual_variance".split()


class _TransitionMapping(Mapping):
    """A transition, which may be the row of numbers that it was before version 1.0."""

    def _read(self, value: Any, where: KeyPath, scope: Scope) -> Any:
        if isinstance(value, list):
            if len(value) != len(_COLUMNS):
                rule = f"must be a row of {len(_COLUMNS)} numbers, as before version 1.0"
                raise where.error(rule, value)
            if value[0] not in range(len(SHAPES)):
                rule = f"must begin with the number of a shape, 0 to {len(SHAPES) - 1}"
                raise where.error(rule, value[0])
            named = dict(zip(_COLUMNS, [SHAPES[int(value[0])], *value[1:]], strict=True))
            value = named | {"fade_relative_std": 0.0, "shift_std_mm": 0.0}
        return super()._read(value, where, scope)


@declared
class Carrier:
    """Curves at one carrier, for J calibrated locations and K functions of force."""

    frequency_hz: float = key(
        Number(unit="Hz", low=LEAST_FREQUENCY_HZ, high=LARGEST), doc="Carrier frequency."
    )
    untouched_deg: tuple[float, float] = key(
        Numbers(shape=(2,), unit="deg", as_tuple=True),
        doc="Phases of the untouched sensor, per port.",
    )
    location_mm: np.ndarray = key(
        Numbers(shape=(None,), unit="mm"),
        check=_check_locations,
        doc="Calibrated locations, rising.",
    )
    force_span_n: np.ndarray = key(
        Numbers(shape=(_LOCATIONS, 2), unit="N"), doc="Lowest and highest force at each location."
    )
    coefficients_deg: np.ndarray = key(
        Numbers(shape=(2, _LOCATIONS, _COEFFICIENTS), unit="deg"),
        doc="Coefficients of the functions of force, per port and location.",
    )
    covariance_deg2: np.ndarray = key(
        Numbers(shape=(2, _LOCATIONS, _COEFFICIENTS, _COEFFICIENTS), unit="deg^2"),
        check=_check_covariances,
        doc="Covariance of the coefficients.",
    )
    noise_deg: tuple[float, ...] = key(
        Numbers(shape=(2,), unit="deg", as_tuple=True),
        doc="Standard deviation of the calibration data about the curves, per port.",
    )
    misfit_deg: tuple[float, ...] = key(
        Numbers(shape=(2,), unit="deg", as_tuple=True),
        doc="The part of it that is not noise but the curves' form, per port.",
    )
    interpolation: tuple[Transition, ...] = key(
        # As many as calibrations before version 1.0 stored; now at most 16.
        ListOf(of=_TransitionMapping(of=Transition), least=1, most=64),
        check=_check_transitions,
        doc="Ways in which the curves may change between the calibrated locations.",
    )
    hysteresis_n: float | None = key(
        Number(unit="N", low=0, high=MAX_FORCE_N, optional=True),
        doc="Half of the largest difference between loading and unloading; null where the "
        "calibration did not hold both.",
    )


_MOST_CARRIERS, _MOST_LEFT_OUT = 16, 10_000
_CARRIER = Number(unit="MHz", low=LEAST_FREQUENCY_HZ / 1e6, high=LARGEST / 1e6)
_PLACE = Number(unit="mm", low=0, high=MAX_LENGTH_MM)
_ERROR = Number(unit="deg", low=0, high=LARGEST)


@declared
class LeftOut:
    """A location as the others predict it, at one port."""

    frequency_mhz: float = key(_CARRIER, doc="Carrier.")
    location_mm: float = key(_PLACE, doc="The location.")
    port: int = key(Integer(low=1, high=2), doc="The port.")
    rms_deg: float = key(_ERROR, doc="Difference from the prediction.")
    expected_deg: float = key(_ERROR, doc="The difference that the model expects.")


@declared
class WrongLocation:
    """A location that the others contradict."""

    frequency_mhz: float = key(_CARRIER, doc="Carrier.")
    location_mm: float = key(_PLACE, doc="The location.")
    exchanged_mm: float | None = key(
        replace(_PLACE, optional=True), doc="The location that it was exchanged with."
    )
    port: int | None = key(Integer(low=1, high=2, optional=True), doc="The only port of these.")
    fits_mm: float | None = key(replace(_PLACE, optional=True), doc="Where it would fit.")


def _check_both_ports(validation: dict[str, Any], scope: Scope) -> str | None:
    first, second = (
        {
            (row["frequency_mhz"], row["location_mm"])
            for row in validation.get("locations", ())
            if row["port"] == port
        }
        for port in (1, 2)
    )
    return None if first == second else "must hold each of its locations at both ports"


@declared
class CurveModel(SensorModel):
    """A sensor known by its calibration: curves of one form at each carrier."""

    kind: str = key(Choice(words=("curves",)), default="curves", doc="Calibrated curves.")
    cross_validation: dict[str, Any] = key(
        AnyMapping(
            known={
                "locations": ListOf(of=LeftOut, most=_MOST_LEFT_OUT),
                "wrong": ListOf(of=WrongLocation, most=_MOST_CARRIERS),
            }
        ),
        check=_check_both_ports,
        derived=Derived("an empty mapping", lambda scope: {}),
        doc="Errors of curves against data that they had not seen.",
        compare=False,
    )
    form: str = key(Choice(words=FORMS), doc="The functions of force.")
    knots_n: np.ndarray | None = key(
        Numbers(shape=(None,), unit="N", optional=True),
        check=_check_knots,
        doc="Knots of the functions of force; left out for `power`.",
    )
    carriers: tuple[Carrier, ...] = key(
        ListOf(of=Carrier, least=1, most=_MOST_CARRIERS), doc="The curves at each carrier."
    )

    @cached_property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Carriers of the curves."""
        return tuple(carrier.frequency_hz for carrier in self.carriers)

    @cached_property
    def _basis(self) -> Basis:
        return force_basis(self.form, self.knots_n)

    @cached_property
    def interpolations(self) -> list[LocationInterpolation]:
        """Of each carrier."""
        return [
            LocationInterpolation(c.location_mm, self.length_mm, c.interpolation)
            for c in self.carriers
        ]

    def noise_deg(self, frequency_hz: float | None = None) -> tuple[float, ...]:
        """Scatter of the calibration data about the curves, per port."""
        return self.carriers[self.carrier_index(frequency_hz)].noise_deg

    @cached_property
    def calibrated(self) -> tuple[Array, Array, Array]:
        """See :attr:`SensorModel.calibrated`; what all carriers have in common."""
        places = np.concatenate([self.location_span_mm, *(c.location_mm for c in self.carriers)])
        places = np.unique(np.clip(places, *self.location_span_mm))
        spans = [
            [np.interp(places, c.location_mm, span) for span in c.force_span_n.T]
            for c in self.carriers
        ]
        return places, np.max(spans, axis=0)[0], np.min(spans, axis=0)[1]

    def _untouched_deg(self, carrier: int) -> Array:
        return np.asarray(self.carriers[carrier].untouched_deg, float)

    def _at_locations(self, force: Array, carrier: int) -> Array:
        """g at the calibrated locations; shape (..., 2, J)."""
        curves, basis = self.carriers[carrier].coefficients_deg, self._basis(force)
        values = basis @ curves.reshape(-1, curves.shape[-1]).T
        return values.reshape(*basis.shape[:-1], *curves.shape[:-1])

    def short_deg(self, force: Array, location: Array, carrier: int) -> Array:
        weights = self.interpolations[carrier].weights(location)
        added = np.sum(weights * self._at_locations(force, carrier), axis=-1)
        distance = line.distances_mm(location, self.length_mm)
        frequency = self.carriers[carrier].frequency_hz
        return added + line.short_phase_deg(distance, frequency, self.permittivity)

    def _model_std_deg(self, force: Array, location: Array, carrier: int) -> Array:
        curves, interpolation = self.carriers[carrier], self.interpolations[carrier]
        basis, covariance = self._basis(force), curves.covariance_deg2
        along = basis @ np.moveaxis(covariance, 2, 0).reshape(len(covariance[0, 0]), -1)
        along = along.reshape(*basis.shape[:-1], *covariance.shape[:2], -1)
        fit = np.einsum("...pjm,...m->...pj", along, basis)
        fit = np.maximum(fit, 0.0)  # a file's digits end somewhere
        values = self._at_locations(force, carrier)
        variance = np.sum(interpolation.weights(location) ** 2 * fit, axis=-1)
        variance += interpolation.variance(location, values) + np.square(curves.misfit_deg)
        if curves.hysteresis_n:
            variance += self._hysteresis_deg(force, location, carrier) ** 2
        return np.sqrt(variance)

    def _hysteresis_deg(self, force: Array, location: Array, carrier: int) -> Array:
        """Standard deviation of each phase by which force is as uncertain as by hysteresis.

        Force follows from the sum of both phases: independent errors are scaled so that theirs is
        it.
        """
        slope = np.abs(
            slope_over_force(lambda force_n: self.short_deg(force_n, location, carrier), force)
        )
        total = slope.sum(axis=-1, keepdims=True)
        factor = total / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-12)
        return self.carriers[carrier].hysteresis_n * factor * slope

    def _scaled(self, index: int, frequency_hz: float) -> dict[str, Any]:
        """Fields that change at another carrier."""
        from_hz = self.transferred_from_hz or self.frequencies_hz[index]
        return {
            "carriers": (self._scaled_carrier(index, frequency_hz),),
            "cross_validation": {},  # it is that of the calibrated carrier
            "transferred_from_hz": from_hz,
            "transfer_std_deg": transfer_std_deg(
                self.length_mm, self.permittivity, from_hz, frequency_hz
            ),
        }

    def _scaled_carrier(self, index: int, frequency_hz: float) -> Carrier:
        """The curves of one carrier, their phases scaled to another frequency."""
        carrier = self.carriers[index]
        ratio = frequency_hz / carrier.frequency_hz
        lines = [
            line.open_phase_deg(self.length_mm, hz, self.permittivity)
            for hz in (carrier.frequency_hz, frequency_hz)
        ]
        # What ports add to the phases of the line, less than half a turn.
        ports = wrap_deg(np.asarray(carrier.untouched_deg) - lines[0])
        coefficients = carrier.coefficients_deg - self._whole_turns(index, ports)
        untouched = wrap_deg(lines[1] + ratio * ports)
        return replace(
            carrier,
            frequency_hz=frequency_hz,
            untouched_deg=tuple(untouched.tolist()),
            coefficients_deg=ratio * coefficients,
            covariance_deg2=ratio**2 * carrier.covariance_deg2,
            noise_deg=tuple(ratio * value for value in carrier.noise_deg),
            misfit_deg=tuple(ratio * value for value in carrier.misfit_deg),
        )

    def _whole_turns(self, index: int, ports_deg: Array) -> Array:
        """Turns of 360 deg in the curves, as coefficients (2, 1, K), which would not stay whole."""
        values = self._at_locations(np.linspace(*self.force_span_n, 8), index)
        turns = 360.0 * np.round((values.mean(axis=(0, 2)) - ports_deg) / 360.0)
        return turns[:, None, None] * np.array(self._basis.constant)
