# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models as YAML files: reading with checks, writing, the shipped ones by name."""

import datetime
import os
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path

import numpy as np
import yaml

from ..errors import InputError, unwritable
from ..io.textfile import write_whole
from ..io.yamlfile import Section, as_number, read_yaml
from . import curves, line
from .checks import check_onset
from .location import SHAPES, Transition
from .model import (
    LEAST,
    LEAST_FREQUENCY_HZ,
    MAX_FORCE_N,
    MAX_LENGTH_MM,
    MAX_PERMITTIVITY,
    LineModel,
)

KINDS = ("line", "curves")
MAX_CARRIERS = 16
MAX_TRANSITIONS = 16
_LARGEST = 1e12  # of any number


def shipped_sensors():
    """Names of the sensors that are shipped, sorted."""
    return sorted(path.stem for path in _shipped_folder().glob("*.yaml"))


def _shipped_folder():
    from .._config import DATA_DIR

    return Path(DATA_DIR) / "sensors"


def load_sensor(name_or_path, relative_to=None):
    """Reads a sensor model.

    Parameters
    ----------
    name_or_path : str or path
        Name of a shipped sensor, or path of a YAML file (ends in ``.yaml`` or ``.yml``).
    relative_to : path, optional
        Folder from which a relative path counts.

    Returns
    -------
    SensorModel

    Raises
    ------
    InputError
        Naming file, key, rule and value.
    """
    text = os.fspath(name_or_path)
    if text.lower().endswith((".yaml", ".yml")):
        path = Path(relative_to or ".") / text
    elif text in shipped_sensors():
        return _shipped(_shipped_folder() / f"{text}.yaml")
    else:
        shipped = ", ".join(shipped_sensors())
        raise InputError("sensor", f"must be a .yaml file or one of {shipped}", text)
    return sensor_from_dict(read_yaml(path), path)


# One object with its tables for all who name it: they take a second to build.
@lru_cache(maxsize=8)
def _shipped(path):
    return sensor_from_dict(read_yaml(path), path)


def sensor_from_dict(content, where="sensor"):
    """The model that a sensor file's content describes; see :func:`load_sensor`."""
    section = Section(content, str(where))
    kind = section.choice("kind", KINDS)
    length = section.number("length_mm", above=0, high=MAX_LENGTH_MM)
    common = {
        "name": section.text("name"),
        "length_mm": length,
        "onset_force_n": section.number("onset_force_n", low=LEAST, high=MAX_FORCE_N),
        "force_span_n": _span(section, "force_span_n", high=MAX_FORCE_N),
        "location_span_mm": _span(section, "location_span_mm", high=length),
        "provenance": _provenance(section.section("provenance")),
    }
    check_onset(f"{where}: onset_force_n", common["onset_force_n"], common["force_span_n"][1])
    model = (_read_line if kind == "line" else _read_curves)(section, common)
    section.finish()
    return model


def _span(section, key, high):
    span = _numbers(section, key, (2,))
    if not 0 <= span[0] < span[1] <= high:
        raise section.error(key, f"must be two rising numbers from 0 to {high:g}", span.tolist())
    return float(span[0]), float(span[1])


def _provenance(section):
    date = section.raw("date")
    if isinstance(date, datetime.date):
        date = date.isoformat()
    if not isinstance(date, str):
        raise section.error("date", "must be a date", date)
    known = {"source": section.text("source", limit=2000), "date": date}
    assumed = section.raw("assumed", [])
    if not isinstance(assumed, list) or not all(isinstance(text, str) for text in assumed):
        raise section.error("assumed", "must be a list of texts", assumed)
    section.finish()
    return known | {"assumed": assumed}


def _read_line(section, common):
    contact = section.section("contact")
    law = line.ContactLaw(
        onset_force_n=common["onset_force_n"],
        decay_length_mm=contact.number("decay_length_mm", low=LEAST, high=_LARGEST),
        asymmetry=contact.number("asymmetry", low=0, high=0.99),
        fade_mm=contact.number("fade_mm", low=LEAST, high=_LARGEST),
        width_mm=contact.number("width_mm", 0.0, low=0, high=common["length_mm"]),
    )
    contact.finish()
    frequencies = _numbers(section, "frequencies_hz", (None,))
    if not np.all(frequencies >= LEAST_FREQUENCY_HZ):
        rule = f"must be at least {LEAST_FREQUENCY_HZ:g}"
        raise section.error("frequencies_hz", rule, frequencies.tolist())
    return LineModel(
        **common,
        frequencies_hz=tuple(map(float, frequencies)),
        contact=law,
        permittivity=section.number("permittivity", low=1, high=MAX_PERMITTIVITY),
        port_offset_deg=tuple(map(float, _numbers(section, "port_offset_deg", (2,)))),
    )


def _read_curves(section, common):
    form = section.choice("form", curves.FORMS)
    knots = None
    if form != "power":
        knots = _numbers(section, "knots_n", (None,))
        if len(knots) < 2 or np.any(np.diff(knots, prepend=0) < LEAST):
            rule = f"must be at least two rising positive forces, {LEAST:g} apart"
            raise section.error("knots_n", rule, knots.tolist())
    basis_size = curves.force_basis(form, knots).size
    carriers = tuple(
        _read_carrier(carrier, basis_size, common["length_mm"])
        for carrier in section.sections("carriers", MAX_CARRIERS, required=True)
    )
    validation = section.raw("cross_validation", {})
    if not isinstance(validation, dict):
        raise section.error("cross_validation", "must be a mapping of keys to values", validation)
    return curves.CurveModel(
        **common,
        frequencies_hz=tuple(carrier.frequency_hz for carrier in carriers),
        form=form,
        knots_n=knots,
        carriers=carriers,
        permittivity=section.number("permittivity", low=1, high=MAX_PERMITTIVITY),
        cross_validation=validation,
    )


def _read_carrier(section, basis_size, length_mm):
    location = _numbers(section, "location_mm", (None,))
    if len(location) < 2 or np.any(np.diff(location) < LEAST):
        rule = f"must be at least two rising locations, {LEAST:g} apart"
        raise section.error("location_mm", rule, location.tolist())
    if location[0] < 0 or location[-1] > length_mm:
        rule = f"must lie from 0 to {length_mm:g}"
        raise section.error("location_mm", rule, location.tolist())
    count = len(location)
    interpolation = _read_transitions(section)
    covariance = _numbers(section, "covariance_deg2", (2, count, basis_size, basis_size))
    if not _are_covariances(covariance):
        raise section.error("covariance_deg2", "must hold symmetric, non-negative matrices")
    carrier = curves.Carrier(
        frequency_hz=section.number("frequency_hz", low=LEAST_FREQUENCY_HZ, high=_LARGEST),
        untouched_deg=tuple(map(float, _numbers(section, "untouched_deg", (2,)))),
        location_mm=location,
        force_span_n=_numbers(section, "force_span_n", (count, 2)),
        coefficients_deg=_numbers(section, "coefficients_deg", (2, count, basis_size)),
        covariance_deg2=covariance,
        noise_deg=tuple(map(float, _numbers(section, "noise_deg", (2,)))),
        misfit_deg=tuple(map(float, _numbers(section, "misfit_deg", (2,)))),
        interpolation=interpolation,
    )
    section.finish()
    return carrier


def _read_transitions(section):
    rows = section.raw("interpolation")
    if isinstance(rows, list) and rows and isinstance(rows[0], list):
        rule = "is that of an earlier version: calibrate again with gr-wiforce calibrate"
        raise section.error("interpolation", rule)
    transitions = []
    for row in section.sections("interpolation", MAX_TRANSITIONS, required=True):
        transitions.append(
            Transition(
                shape=row.choice("shape", SHAPES),
                probability=row.number("probability", low=LEAST, high=1),
                fade_mm=row.number("fade_mm", low=LEAST, high=_LARGEST),
                fade_relative_std=row.number("fade_relative_std", low=0, high=10),
                shift_mm=row.number("shift_mm", low=-_LARGEST, high=_LARGEST),
                shift_std_mm=row.number("shift_std_mm", low=0, high=_LARGEST),
                residual_length_mm=row.number("residual_length_mm", low=LEAST, high=_LARGEST),
                residual_variance=row.number("residual_variance", low=0, high=_LARGEST),
            )
        )
        row.finish()
    total = sum(transition.probability for transition in transitions)
    if abs(total - 1) > 1e-6:
        raise section.error("interpolation", "must have probabilities that sum to 1", total)
    return tuple(transitions)


def _are_covariances(matrices):
    """Whether matrices (..., n, n) are symmetric and without negative eigenvalues but rounding."""
    size = np.abs(matrices).max(axis=(-2, -1))
    apart = np.abs(matrices - np.swapaxes(matrices, -2, -1)).max(axis=(-2, -1))
    least = np.linalg.eigvalsh(matrices)[..., 0]
    return bool(np.all((apart <= 1e-6 * size) & (least >= -1e-6 * size)))


def _numbers(section, key, shape):
    """An array of numbers up to _LARGEST; None in ``shape`` stands for any length above 0."""
    value = section.raw(key)
    wanted = " x ".join("n" if size is None else str(size) for size in shape)
    rule = f"must be a list of {wanted} numbers"
    if value is None:
        raise section.error(key, f"is missing, {rule}")
    try:
        numbers = np.array(_nested(value, shape), float)
    except ValueError:
        raise section.error(key, rule, value) from None
    largest = numbers.flat[np.argmax(np.abs(numbers))]
    if abs(largest) > _LARGEST:
        rule = f"must hold numbers from -{_LARGEST:g} to {_LARGEST:g}"
        raise section.error(key, rule, float(largest))
    return numbers


def _nested(value, shape):
    if not shape:
        number = as_number(value)
        if number is None:
            raise ValueError
        return number
    if not isinstance(value, list) or len(value) != (shape[0] or max(len(value), 1)):
        raise ValueError
    return [_nested(item, shape[1:]) for item in value]


def write_sensor(model, path):
    """Writes a model as YAML, whole or not at all.

    Raises
    ------
    InputError
        When the file cannot be written.
    OutputError
        When the disk is full.
    """
    text = yaml.safe_dump(
        sensor_to_dict(model), sort_keys=False, width=100, default_flow_style=None
    )
    try:
        write_whole(path, "# SPDX-License-Identifier: GPL-3.0-or-later\n" + text)
    except OSError as error:
        raise unwritable(path, error) from error


def sensor_to_dict(model):
    """The content of a model's file."""
    is_line = isinstance(model, LineModel)
    if is_line:
        contact = ["decay_length_mm", "asymmetry", "fade_mm"]
        contact += ["width_mm"] if model.contact.width_mm else []
    content = {
        "name": model.name,
        "kind": "line" if is_line else "curves",
        "length_mm": model.length_mm,
        "onset_force_n": _rounded(model.onset_force_n),
        "force_span_n": _rounded(model.force_span_n),
        "location_span_mm": _rounded(model.location_span_mm),
        "permittivity": model.permittivity,
        "provenance": dict(model.provenance),
    }
    if is_line:
        return content | {
            "frequencies_hz": list(model.frequencies_hz),
            "port_offset_deg": list(model.port_offset_deg),
            "contact": {key: getattr(model.contact, key) for key in contact},
        }
    content |= {"cross_validation": model.cross_validation, "form": model.form}
    if model.knots_n is not None:
        content["knots_n"] = _rounded(model.knots_n)
    return content | {"carriers": [_carrier_to_dict(carrier) for carrier in model.carriers]}


def _carrier_to_dict(carrier):
    content = {key: getattr(carrier, key) for key in curves.Carrier.__dataclass_fields__}
    transitions = content.pop("interpolation")
    content = {key: _rounded(value) for key, value in content.items()}
    content["interpolation"] = [
        {"shape": t.shape}
        | {key: _rounded(value) for key, value in asdict(t).items() if key != "shape"}
        for t in transitions
    ]
    return content


def _rounded(value):
    """Nested lists of floats with nine significant digits, enough for any phase."""
    if np.ndim(value):
        return [_rounded(item) for item in value]
    return float(f"{float(value):.9g}")
