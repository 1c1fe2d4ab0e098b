# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor files, declared key by key.

Keys have the names of the models' attributes (:mod:`.model`, :mod:`.curves`, :mod:`.line`), so that
:mod:`.file` copies between the two.
"""

from typing import Any

import numpy as np

from ..io.text.schema import DRAFT_7, Derived, ListOf, Mapping, declared, json_schema, key
from ..io.text.values import (
    LARGEST,
    AnyMapping,
    Array,
    Choice,
    Date,
    Number,
    Scope,
    Size,
    Text,
    Texts,
)
from .curves import FORMS, force_basis
from .location import SHAPES
from .model import LEAST, LEAST_FREQUENCY_HZ, MAX_FORCE_N, MAX_LENGTH_MM, MAX_PERMITTIVITY

_LOCATIONS = Size("locations", lambda scope: len(scope["location_mm"]))
_COEFFICIENTS = Size(
    "coefficients", lambda scope: force_basis(scope["form"], scope["knots_n"]).size
)


def _check_span(span: tuple[float, float], scope: Scope) -> str | None:
    return None if span[0] < span[1] else "must be two rising numbers"


def _check_location_span(span: tuple[float, float], scope: Scope) -> str | None:
    if span[0] < span[1] <= scope["length_mm"]:
        return None
    return f"must be two rising numbers from 0 to {scope['length_mm']:g}"


def _check_width(width_mm: float, scope: Scope) -> str | None:
    inside = width_mm <= scope["length_mm"]
    return None if inside else f"must not be wider than length_mm, {scope['length_mm']:g}"


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


def _check_transitions(transitions: tuple["TransitionKeys", ...], scope: Scope) -> str | None:
    total = sum(transition.probability for transition in transitions)
    if abs(total - 1) > 1e-6:
        return f"must have probabilities that sum to 1, not to {total:g}"
    return None


@declared
class Provenance:
    """Where a sensor model comes from."""

    source: str = key(Text(limit=2000), doc="The data that the model was made from.")
    date: str = key(Date(), doc="When it was made.")
    assumed: list[str] = key(
        Texts(),
        derived=Derived("an empty list", lambda scope: []),
        doc="What was assumed because the data did not contain it.",
    )
    suspicions: list[str] = key(
        Texts(),
        derived=Derived("an empty list", lambda scope: []),
        doc="Likely mistakes in the data that whoever calibrated has accepted; `plan` and `read` "
        "repeat them.",
    )


@declared
class Contact:
    """How a soft beam touches the line (`sensor/line.py`)."""

    decay_length_mm: float = key(
        Number(unit="mm", low=LEAST, high=LARGEST),
        doc="1/k of the beam on its elastic foundation.",
    )
    asymmetry: float = key(
        Number(low=0, high=0.99),
        doc="Tilt of the short towards the nearer end, far from the middle of the line.",
    )
    fade_mm: float = key(
        Number(unit="mm", low=LEAST, high=LARGEST),
        doc="Distance from the middle over which the tilt builds up.",
    )
    width_mm: float = key(
        Number(unit="mm", low=0, high=MAX_LENGTH_MM),
        default=0.0,
        check=_check_width,
        doc="Width of the object that presses, evenly loaded; 0 for a point.",
    )


@declared
class TransitionKeys:
    """One way in which the contact may change along the line (`sensor/location.py`)."""

    shape: str = key(Choice(words=SHAPES), doc="Form of the transition between its two levels.")
    probability: float = key(
        Number(low=LEAST, high=1), doc="Those of all transitions of a carrier sum to 1."
    )
    fade_mm: float = key(
        Number(unit="mm", low=LEAST, high=LARGEST), doc="Length over which the contact changes."
    )
    fade_relative_std: float = key(
        Number(low=0, high=10), doc="Its standard deviation, relative to it."
    )
    shift_mm: float = key(
        Number(unit="mm", low=-LARGEST, high=LARGEST),
        doc="Distance of the transition from the middle of the line, away from the port.",
    )
    shift_std_mm: float = key(Number(unit="mm", low=0, high=LARGEST), doc="Its standard deviation.")
    residual_length_mm: float = key(
        Number(unit="mm", low=LEAST, high=LARGEST),
        doc="Correlation length of what the shape does not explain.",
    )
    residual_variance: float = key(
        Number(low=0, high=LARGEST),
        doc="Variance of that, relative to the variance over the calibrated locations.",
    )


@declared
class CarrierCurves:
    """Calibrated curves at one carrier (`sensor/curves.py`)."""

    frequency_hz: float = key(
        Number(unit="Hz", low=LEAST_FREQUENCY_HZ, high=LARGEST), doc="Carrier frequency."
    )
    untouched_deg: tuple[float, float] = key(
        Array(shape=(2,), unit="deg", as_tuple=True),
        doc="Phases of the untouched sensor, per port.",
    )
    location_mm: np.ndarray = key(
        Array(shape=(None,), unit="mm"),
        check=_check_locations,
        doc="Calibrated locations, rising.",
    )
    force_span_n: np.ndarray = key(
        Array(shape=(_LOCATIONS, 2), unit="N"), doc="Lowest and highest force at each location."
    )
    coefficients_deg: np.ndarray = key(
        Array(shape=(2, _LOCATIONS, _COEFFICIENTS), unit="deg"),
        doc="Coefficients of the functions of force, per port and location.",
    )
    covariance_deg2: np.ndarray = key(
        Array(shape=(2, _LOCATIONS, _COEFFICIENTS, _COEFFICIENTS), unit="deg^2"),
        check=_check_covariances,
        doc="Covariance of the coefficients.",
    )
    noise_deg: tuple[float, float] = key(
        Array(shape=(2,), unit="deg", as_tuple=True),
        doc="Standard deviation of the calibration data about the curves, per port.",
    )
    misfit_deg: tuple[float, float] = key(
        Array(shape=(2,), unit="deg", as_tuple=True),
        doc="The part of it that is not noise but the curves' form, per port.",
    )
    interpolation: tuple[TransitionKeys, ...] = key(
        # As many as calibrations before version 1.0 stored (earlier_files.py); now at most 16.
        ListOf(of=TransitionKeys, least=1, most=64),
        check=_check_transitions,
        doc="Ways in which the curves may change between the calibrated locations.",
    )
    hysteresis_n: float | None = key(
        Number(unit="N", low=0, high=MAX_FORCE_N, optional=True),
        default=None,
        doc="Half of the largest difference between loading and unloading; null where the "
        "calibration did not hold both.",
    )


@declared
class SensorFile:
    """Keys of every sensor file."""

    name: str = key(Text(), doc="Name of the sensor.")
    kind: str = key(
        Choice(words=("line", "curves")),
        doc="`line`: a physical model. `curves`: calibrated curves.",
    )
    length_mm: float = key(
        Number(unit="mm", low=0, above=True, high=MAX_LENGTH_MM), doc="Length of the line."
    )
    onset_force_n: float = key(
        Number(unit="N", low=LEAST, high=MAX_FORCE_N),
        doc="Force at which the line is first shorted, below the highest calibrated force.",
    )
    force_span_n: tuple[float, float] = key(
        Array(shape=(2,), unit="N", low=0, high=MAX_FORCE_N, as_tuple=True),
        check=_check_span,
        doc="Lowest and highest calibrated force. Readings outside are flagged `extrapolated`.",
    )
    location_span_mm: tuple[float, float] = key(
        Array(shape=(2,), unit="mm", low=0, high=MAX_LENGTH_MM, as_tuple=True),
        check=_check_location_span,
        doc="First and last calibrated location, from port 1.",
    )
    permittivity: float = key(
        Number(low=1, high=MAX_PERMITTIVITY),
        doc="Effective relative permittivity of the line; 1 for a line in air.",
    )
    provenance: Provenance = key(Mapping(of=Provenance), doc="Where the model comes from.")
    transferred_from_hz: float | None = key(
        Number(unit="Hz", low=LEAST_FREQUENCY_HZ, high=LARGEST, optional=True),
        default=None,
        doc="Carrier of the calibration, where `gr-wiforce transfer` made the file.",
    )
    transfer_std_deg: float | None = key(
        Number(unit="deg", low=0, high=180, optional=True),
        default=None,
        doc="Standard deviation of each phase that the transfer adds.",
    )
    ruler_std_mm: float | None = key(
        Number(unit="mm", low=0, high=MAX_LENGTH_MM, optional=True),
        default=None,
        doc="Standard deviation of the calibrated locations; enters that of every location read.",
    )


@declared
class LineFile(SensorFile):
    """A sensor evaluated by physics."""

    kind: str = key(Choice(words=("line",)), doc="A physical model.")
    frequencies_hz: tuple[float, ...] = key(
        Array(shape=(None,), unit="Hz", low=LEAST_FREQUENCY_HZ, as_tuple=True),
        doc="Carriers that the model holds.",
    )
    port_offset_deg: tuple[float, float] = key(
        Array(shape=(2,), unit="deg", as_tuple=True), doc="Constant phase per port."
    )
    contact: Contact = key(Mapping(of=Contact), doc="How the beam touches the line.")


@declared
class CurvesFile(SensorFile):
    """A sensor known by its calibration."""

    kind: str = key(Choice(words=("curves",)), doc="Calibrated curves.")
    cross_validation: dict[str, Any] = key(
        AnyMapping(),
        derived=Derived("an empty mapping", lambda scope: {}),
        doc="Errors of curves against data that they had not seen.",
    )
    form: str = key(Choice(words=FORMS), doc="The functions of force.")
    knots_n: np.ndarray | None = key(
        Array(shape=(None,), unit="N", optional=True),
        default=None,
        check=_check_knots,
        doc="Knots of the functions of force; left out for `power`.",
    )
    carriers: tuple[CarrierCurves, ...] = key(
        ListOf(of=CarrierCurves, least=1, most=16), doc="The curves at each carrier."
    )


FILES: dict[str, type[SensorFile]] = {"line": LineFile, "curves": CurvesFile}


def sensor_json_schema() -> dict[str, Any]:
    """JSON Schema of sensor files, draft 7, for completion and checks in editors."""
    return {
        "$schema": DRAFT_7,
        "title": "gr-wiforce sensor",
        "type": "object",
        "properties": {"kind": {"enum": list(FILES)}},
        "required": ["kind"],
        "allOf": [
            {"if": {"properties": {"kind": {"const": kind}}}, "then": json_schema(cls)}
            for kind, cls in FILES.items()
        ],
    }
