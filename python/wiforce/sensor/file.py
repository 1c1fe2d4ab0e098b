# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models as YAML files: reading with checks, writing, the shipped ones by name."""

import datetime
import math
import os
from pathlib import Path

import numpy as np
import yaml

from ..errors import InputError
from . import curves, line
from .model import LineModel


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
        path = _shipped_folder() / f"{text}.yaml"
    else:
        raise InputError(
            "sensor", f"must be a .yaml file or one of {', '.join(shipped_sensors())}", text
        )
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(path, f"is not YAML ({' '.join(str(error).split())})") from error
    return sensor_from_dict(content, path)


def sensor_from_dict(content, where="sensor"):
    """The model that a sensor file's content describes; see :func:`load_sensor`."""
    keys = _Keys(content, where)
    kind = keys.choice("kind", ("line", "curves"))
    common = {
        "name": keys.text("name"),
        "length_mm": keys.positive("length_mm"),
        "onset_force_n": keys.positive("onset_force_n"),
        "provenance": _provenance(keys.child("provenance")),
    }
    model = (_read_line if kind == "line" else _read_curves)(keys, common)
    keys.done()
    return model


def _provenance(keys):
    known = {
        "source": keys.text("source"),
        "date": keys.text("date"),
        "assumed": keys.texts("assumed", optional=True),
    }
    return known | keys.rest()


def _spans(keys, length_mm):
    force = keys.numbers("force_span_n", (2,))
    location = keys.numbers("location_span_mm", (2,))
    if not 0 < force[0] < force[1]:
        raise InputError(keys.at("force_span_n"), "must be two rising positive forces", [*force])
    if not 0 <= location[0] < location[1] <= length_mm:
        rule = f"must be two rising locations within 0..{length_mm:g}"
        raise InputError(keys.at("location_span_mm"), rule, [*location])
    return {
        "force_span_n": tuple(map(float, force)),
        "location_span_mm": tuple(map(float, location)),
    }


def _read_line(keys, common):
    contact = keys.child("contact")
    law = line.ContactLaw(
        onset_force_n=common["onset_force_n"],
        decay_length_mm=contact.positive("decay_length_mm"),
        asymmetry=contact.number("asymmetry"),
        fade_mm=contact.positive("fade_mm"),
    )
    if not 0 <= law.asymmetry < 1:
        raise InputError(contact.at("asymmetry"), "must be in [0, 1)", law.asymmetry)
    contact.done()
    frequencies = keys.numbers("frequencies_hz", (None,))
    if not (len(frequencies) and np.all(frequencies > 0)):
        raise InputError(keys.at("frequencies_hz"), "must be positive carriers", [*frequencies])
    return LineModel(
        **common,
        **_spans(keys, common["length_mm"]),
        frequencies_hz=tuple(map(float, frequencies)),
        contact=law,
        permittivity=keys.positive("permittivity"),
        port_offset_deg=tuple(map(float, keys.numbers("port_offset_deg", (2,)))),
    )


def _read_curves(keys, common):
    form = keys.choice("form", curves.FORMS)
    knots = None
    if form != "power":
        knots = keys.numbers("knots_n", (None,))
        if len(knots) < 2 or np.any(np.diff(knots) <= 0):
            raise InputError(keys.at("knots_n"), "must be at least two rising forces", [*knots])
    basis_size = curves.force_basis(form, knots).size
    carriers = tuple(
        _read_carrier(carrier, basis_size, common["length_mm"])
        for carrier in keys.children("carriers")
    )
    return curves.CurveModel(
        **common,
        **_spans(keys, common["length_mm"]),
        frequencies_hz=tuple(carrier.frequency_hz for carrier in carriers),
        form=form,
        knots_n=knots,
        carriers=carriers,
        permittivity=keys.positive("permittivity"),
    )


def _read_carrier(keys, basis_size, length_mm):
    location = keys.numbers("location_mm", (None,))
    if len(location) < 2 or np.any(np.diff(location) <= 0):
        raise InputError(keys.at("location_mm"), "must be at least two rising locations")
    if location[0] < 0 or location[-1] > length_mm:
        raise InputError(keys.at("location_mm"), f"must lie within 0..{length_mm:g}", [*location])
    count = len(location)
    carrier = curves.Carrier(
        frequency_hz=keys.positive("frequency_hz"),
        untouched_deg=tuple(map(float, keys.numbers("untouched_deg", (2,)))),
        location_mm=location,
        force_span_n=keys.numbers("force_span_n", (count, 2)),
        coefficients_deg=keys.numbers("coefficients_deg", (2, count, basis_size)),
        covariance_deg2=keys.numbers("covariance_deg2", (2, count, basis_size, basis_size)),
        noise_deg=tuple(map(float, keys.numbers("noise_deg", (2,)))),
    )
    keys.done()
    return carrier


class _Keys:
    """A mapping of a YAML file whose values are asked for one by one and must all be known."""

    def __init__(self, content, where, prefix=""):
        self._where, self._prefix = where, prefix
        if not isinstance(content, dict):
            raise InputError(f"{where}: {prefix or 'file'}", "must be a mapping", content)
        self._content, self._asked = content, set()

    def at(self, key):
        return f"{self._where}: {self._prefix}{key}"

    def _get(self, key):
        self._asked.add(key)
        if key not in self._content:
            raise InputError(self.at(key), "is missing")
        return self._content[key]

    def text(self, key):
        value = self._get(key)
        if isinstance(value, datetime.date):
            return value.isoformat()
        if not isinstance(value, str) or not value:
            raise InputError(self.at(key), "must be a text", value)
        return value

    def texts(self, key, optional=False):
        if optional and key not in self._content:
            return []
        value = self._get(key)
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise InputError(self.at(key), "must be a list of texts", value)
        return value

    def choice(self, key, allowed):
        value = self._get(key)
        if value not in allowed:
            raise InputError(self.at(key), f"must be one of {', '.join(allowed)}", value)
        return value

    def number(self, key):
        return _number(self._get(key), self.at(key))

    def positive(self, key):
        value = self.number(key)
        if not value > 0:
            raise InputError(self.at(key), "must be positive", value)
        return value

    def numbers(self, key, shape):
        """An array of finite numbers; None in ``shape`` stands for any length."""
        value = self._get(key)
        array = np.array(_nested(value, len(shape), self.at(key)), float)
        fits = array.ndim == len(shape) and all(
            want in (None, have) for want, have in zip(shape, array.shape, strict=True)
        )
        if not fits:
            wanted = " x ".join("n" if n is None else str(n) for n in shape)
            raise InputError(self.at(key), f"must be a list of {wanted} numbers", value)
        return array

    def child(self, key):
        return _Keys(self._get(key), self._where, f"{self._prefix}{key}.")

    def children(self, key):
        value = self._get(key)
        if not isinstance(value, list) or not value:
            raise InputError(self.at(key), "must be a list of mappings", value)
        return [
            _Keys(item, self._where, f"{self._prefix}{key}[{i}].") for i, item in enumerate(value)
        ]

    def rest(self):
        """What has not been asked for, taken as it stands."""
        rest = {key: value for key, value in self._content.items() if key not in self._asked}
        self._asked.update(rest)
        return rest

    def done(self):
        unknown = [key for key in self._content if key not in self._asked]
        if unknown:
            raise InputError(self.at(unknown[0]), "is not a known key")


def _number(value, where):
    # PyYAML reads 900e6, without a dot and a sign, as a text.
    try:
        if isinstance(value, bool):
            raise ValueError
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(where, "must be a number", value) from None
    if not math.isfinite(number):
        raise InputError(where, "must be finite", value)
    return number


def _nested(value, depth, where):
    if depth == 0:
        return _number(value, where)
    if not isinstance(value, list):
        raise InputError(where, "must be a list", value)
    items = [_nested(item, depth - 1, where) for item in value]
    if len({len(item) for item in items if isinstance(item, list)}) > 1:
        raise InputError(where, "must be a list of lists of one length", value)
    return items


def write_sensor(model, path):
    """Writes a model as YAML, whole or not at all.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    text = yaml.safe_dump(
        sensor_to_dict(model), sort_keys=False, width=100, default_flow_style=None
    )
    path = Path(path)
    part = path.with_name(path.name + ".part")
    try:
        part.write_text("# SPDX-License-Identifier: GPL-3.0-or-later\n" + text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise InputError(path, f"cannot be written ({error.strerror})") from error


def sensor_to_dict(model):
    """The content of a model's file."""
    content = {
        "name": model.name,
        "kind": "line" if isinstance(model, LineModel) else "curves",
        "length_mm": model.length_mm,
        "onset_force_n": model.onset_force_n,
        "force_span_n": list(model.force_span_n),
        "location_span_mm": list(model.location_span_mm),
        "permittivity": model.permittivity,
    }
    if isinstance(model, LineModel):
        content |= {
            "frequencies_hz": list(model.frequencies_hz),
            "port_offset_deg": list(model.port_offset_deg),
            "contact": {
                key: getattr(model.contact, key)
                for key in ("decay_length_mm", "asymmetry", "fade_mm")
            },
        }
    else:
        content |= {"form": model.form}
        if model.knots_n is not None:
            content["knots_n"] = _rounded(model.knots_n)
        content["carriers"] = [_carrier_to_dict(carrier) for carrier in model.carriers]
    return content | {"provenance": dict(model.provenance)}


def _carrier_to_dict(carrier):
    return {key: _rounded(getattr(carrier, key)) for key in curves.Carrier.__dataclass_fields__}


def _rounded(value):
    """Nested lists of floats with nine significant digits, enough for any phase."""
    if np.ndim(value):
        return [_rounded(item) for item in value]
    return float(f"{float(value):.9g}")
