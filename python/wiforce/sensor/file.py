# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models as YAML files: load by name or path, and write."""

import os
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

from ..errors import InputError, name_rule
from ..io.text.schema import keys, plain, read
from ..io.text.textfile import read_yaml, write_yaml
from ..io.text.values import Choice, KeyPath, Scope
from .curves import Carrier, CurveModel
from .earlier_files import with_present_keys
from .file_schema import FILES, CarrierCurves, Provenance, SensorFile
from .line import ContactLaw
from .location import Transition
from .model import LineModel, SensorModel, check_onset


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
        return _shipped(_shipped_folder() / f"{text}.yaml")
    else:
        raise InputError("sensor", name_rule("sensor", shipped_sensors(), text), text)
    content = read_yaml(path)
    if "sensors" in content and "kind" not in content:
        raise InputError(path, "is a scene; a sensor model is needed, such as those it lists")
    return sensor_from_dict(content, path)


# The models of a shipped sensor share one object, and with it the table of its inversion.
@lru_cache(maxsize=8)
def _shipped(path: Path) -> SensorModel:
    return sensor_from_dict(read_yaml(path), path)


def sensor_from_dict(content: dict[str, Any], where: str | Path = "sensor") -> SensorModel:
    """Build the model that the content of a sensor file describes.

    Parameters
    ----------
    content : dict
        As the YAML loader returns it.
    where : str or path
        Name of the file, for messages.

    Raises
    ------
    InputError
        Naming file, dotted key, rule and value.
    """
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
    """The content of a model's file, as plain values that YAML and JSON can hold.

    Returns dict: numbers have nine significant digits, enough for any phase.
    """
    kind = next(kind for kind, (cls, _) in _MODELS.items() if isinstance(model, cls))
    content: dict[str, Any] = {}
    for name, key in keys(FILES[kind]).items():
        if name == "kind":
            content[name] = kind
        elif name == "provenance":
            content[name] = dict(model.provenance)
        else:
            content[name] = key.type.plain(getattr(model, name))
    return _rounded(content)


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items() if item is not None}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value
