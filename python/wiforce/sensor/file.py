# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models as YAML files: load by name or path, and write."""

import os
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, name_rule
from ..io.text.schema import (
    DRAFT_7,
    Derived,
    ListOf,
    Mapping,
    declared,
    json_schema,
    key,
    keys,
    plain,
    read,
)
from ..io.text.textfile import MAX_BYTES, parse_yaml, read_bytes, write_yaml
from ..io.text.values import (
    LARGEST,
    AnyMapping,
    Array,
    Choice,
    Date,
    Integer,
    KeyPath,
    Number,
    Scope,
    Size,
    Text,
    Texts,
)
from .curves import FORMS, Carrier, CurveModel, force_basis
from .line import ContactLaw
from .location import SHAPES, Transition
from .model import (
    LEAST,
    LEAST_FREQUENCY_HZ,
    MAX_FORCE_N,
    MAX_LENGTH_MM,
    MAX_PERMITTIVITY,
    LineModel,
    SensorModel,
    check_onset,
)

# The columns of a row of `interpolation`, which had no names: the shape as its position in SHAPES,
# fade and shift in mm, correlation length and relative variance of the residual.
_COLUMNS = (
    "shape",
    "fade_mm",
    "shift_mm",
    "residual_length_mm",
    "probability",
    "residual_variance",
)


def with_present_keys(content: dict[str, Any], top: KeyPath) -> dict[str, Any]:
    """The content of a sensor file of any version with present keys: rows become transitions."""
    carriers = content.get("carriers")
    if not isinstance(carriers, list) or not any(map(_has_rows, carriers)):
        return content
    where = top.key("carriers")
    return content | {
        "carriers": [_with_transitions(each, where.item(i)) for i, each in enumerate(carriers)]
    }


def _has_rows(carrier: Any) -> bool:
    rows = carrier.get("interpolation") if isinstance(carrier, dict) else None
    return isinstance(rows, list) and any(isinstance(row, list) for row in rows)


def _with_transitions(carrier: Any, path: KeyPath) -> Any:
    if not _has_rows(carrier):
        return carrier
    where = path.key("interpolation")
    rows = enumerate(carrier["interpolation"])
    return carrier | {"interpolation": [_transition(row, where.item(i)) for i, row in rows]}


def _transition(row: Any, where: KeyPath) -> dict[str, Any]:
    if not isinstance(row, list) or len(row) != len(_COLUMNS):
        raise where.error(f"must be a row of {len(_COLUMNS)} numbers, as before version 1.0", row)
    values = dict(zip(_COLUMNS, row, strict=True))
    if row[0] not in range(len(SHAPES)):
        rule = f"must begin with the number of a shape, 0 to {len(SHAPES) - 1}"
        raise where.error(rule, row[0])
    shape = SHAPES[int(row[0])]
    return values | {"shape": shape, "fade_relative_std": 0.0, "shift_std_mm": 0.0}


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
        # As many as calibrations before version 1.0 stored (``_COLUMNS``); now at most 16.
        ListOf(of=TransitionKeys, least=1, most=64),
        check=_check_transitions,
        doc="Ways in which the curves may change between the calibrated locations.",
    )
    hysteresis_n: float | None = key(
        Number(unit="N", low=0, high=MAX_FORCE_N, optional=True),
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
        doc="Carrier of the calibration, where `gr-wiforce transfer` made the file.",
    )
    transfer_std_deg: float | None = key(
        Number(unit="deg", low=0, high=180, optional=True),
        doc="Standard deviation of each phase that the transfer adds.",
    )
    ruler_std_mm: float | None = key(
        Number(unit="mm", low=0, high=MAX_LENGTH_MM, optional=True),
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
class CurvesFile(SensorFile):
    """A sensor known by its calibration."""

    kind: str = key(Choice(words=("curves",)), doc="Calibrated curves.")
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
    )
    form: str = key(Choice(words=FORMS), doc="The functions of force.")
    knots_n: np.ndarray | None = key(
        Array(shape=(None,), unit="N", optional=True),
        check=_check_knots,
        doc="Knots of the functions of force; left out for `power`.",
    )
    carriers: tuple[CarrierCurves, ...] = key(
        ListOf(of=CarrierCurves, least=1, most=_MOST_CARRIERS), doc="The curves at each carrier."
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


def shipped_sensors() -> list[str]:
    """Names of the sensors that are shipped, sorted."""
    return sorted(path.stem for path in _shipped_folder().glob("*.yaml"))


def _shipped_folder() -> Path:
    from .._config import DATA_DIR

    return Path(DATA_DIR) / "sensors"


def load_sensor(
    name_or_path: str | os.PathLike,
    relative_to: str | os.PathLike | None = None,
    frequency_hz: float | None = None,
) -> SensorModel:
    """Load a sensor model.

    Parameters
    ----------
    name_or_path : str or path
        Name of a shipped sensor, or path of a YAML file (ends in ``.yaml`` or ``.yml``).
    relative_to : path, optional
        Folder that a relative path starts from; the current one by default.
    frequency_hz : float, optional
        Carrier to use the model at, in Hz. Where the model does not hold it, its phases are
        transferred from the nearest carrier (see :meth:`.model.SensorModel.at_carrier`).

    Returns
    -------
    SensorModel

    Raises
    ------
    InputError
        Naming file, dotted key, rule and value; or for a carrier too far from those held.

    Examples
    --------
    >>> load_sensor("line-900mhz").length_mm
    80.0
    >>> load_sensor("wiforce-900mhz", frequency_hz=915e6).transferred_from_hz
    900000000.0
    """
    model = _load(name_or_path, relative_to)
    return model if frequency_hz is None else model.at_carrier(frequency_hz)


def _load(name_or_path: str | os.PathLike, relative_to: str | os.PathLike | None) -> SensorModel:
    if not isinstance(name_or_path, str | os.PathLike):
        rule = "must be the name of a shipped sensor or the path of a sensor file"
        raise InputError("sensor", rule, name_or_path)
    text = os.fspath(name_or_path)
    if text.lower().endswith((".yaml", ".yml")):
        path = Path(relative_to or ".") / text
    elif text in shipped_sensors():
        path = _shipped_folder() / f"{text}.yaml"
    else:
        raise InputError("sensor", name_rule("sensor", shipped_sensors(), text), text)
    return _model_in(path, read_bytes(path, MAX_BYTES))


# The models of a file share one object, and with it the table of its inversion.
@lru_cache(maxsize=8)
def _model_in(path: Path, data: bytes) -> SensorModel:
    """The model of a file that holds ``data``."""
    content = parse_yaml(path, data)
    if "sensors" in content and "kind" not in content:
        raise InputError(path, "is a scene; a sensor model is needed, such as those it lists")
    return sensor_from_dict(content, path)


def sensor_from_dict(content: dict[str, Any], where: str | Path = "sensor") -> SensorModel:
    """The model that the content of a sensor file describes; errors name file and key."""
    top = KeyPath(str(where))
    if not isinstance(content, dict):
        raise top.error("must be a mapping of keys to values", content)
    content = with_present_keys(content, top)
    kind = Choice(words=tuple(FILES)).read(content.get("kind"), top.key("kind"), Scope())
    file = read(FILES[kind], content, top)
    check_onset(top.key("onset_force_n"), file.onset_force_n, file.force_span_n[1])
    return _model_of(file)


def _model_of(file: SensorFile) -> SensorModel:
    provenance = plain(Provenance, file.provenance)
    if not provenance["suspicions"]:
        del provenance["suspicions"]  # as of a model that was never in a file
    values = vars(file) | {"provenance": provenance}
    model, convert = _MODELS[values.pop("kind")]
    return model(**convert(values))


def _with_contact(values: dict[str, Any]) -> dict[str, Any]:
    contact = ContactLaw(onset_force_n=values["onset_force_n"], **vars(values["contact"]))
    return values | {"contact": contact}


def _with_carriers(values: dict[str, Any]) -> dict[str, Any]:
    carriers = tuple(map(_carrier_of, values["carriers"]))
    frequencies_hz = tuple(carrier.frequency_hz for carrier in carriers)
    return values | {"carriers": carriers, "frequencies_hz": frequencies_hz}


def _carrier_of(curves: CarrierCurves) -> Carrier:
    transitions = tuple(Transition(**vars(row)) for row in curves.interpolation)
    return Carrier(**vars(curves) | {"interpolation": transitions})


# Of each kind of sensor file: the model that it describes, and what makes the model's attributes of
# the file's keys.
_MODELS: dict[str, tuple[type[SensorModel], Callable[[dict[str, Any]], dict[str, Any]]]] = {
    "line": (LineModel, _with_contact),
    "curves": (CurveModel, _with_carriers),
}


def write_sensor(model: SensorModel, path: str | Path) -> None:
    """Write a model as YAML, completely or not at all.

    Parameters
    ----------
    model : SensorModel
    path : str or path

    Raises
    ------
    InputError
        When the file cannot be written, or could not be read again, for example because the name
        is not printable.
    OutputError
        When the disk is full.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "arm.yaml"
    >>> write_sensor(load_sensor("line-900mhz"), path)
    >>> load_sensor(path).name
    'line-900mhz'
    """
    content = sensor_to_dict(model)
    sensor_from_dict(content, path)
    write_yaml(path, content, "# SPDX-License-Identifier: GPL-3.0-or-later\n")


def sensor_to_dict(model: SensorModel) -> dict[str, Any]:
    """The content of a model's file as plain values with nine significant digits."""
    kind = next(kind for kind, (cls, _) in _MODELS.items() if isinstance(model, cls))
    content: dict[str, Any] = {}
    for name, declaration in keys(FILES[kind]).items():
        if name == "kind":
            content[name] = kind
        elif name == "provenance":
            content[name] = dict(model.provenance)
        else:
            content[name] = declaration.type.plain(getattr(model, name))
    return _rounded(content)


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items() if item is not None}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value
