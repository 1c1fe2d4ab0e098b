# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models as YAML files: load by name or path, and write."""

import os
from functools import lru_cache
from pathlib import Path
from typing import Any

from ..errors import InputError, name_rule
from ..io.text.schema import DRAFT_7, json_schema, plain, read
from ..io.text.textfile import parse_yaml, write_yaml, yaml_bytes
from ..io.text.values import Choice, KeyPath, Scope
from .curves import CurveModel
from .model import LineModel, SensorModel, check_onset

MODELS: dict[str, type[SensorModel]] = {"line": LineModel, "curves": CurveModel}


def sensor_json_schema() -> dict[str, Any]:
    """JSON Schema of sensor files, draft 7, for completion and checks in editors."""
    return {
        "$schema": DRAFT_7,
        "title": "gr-wiforce sensor",
        "type": "object",
        "properties": {"kind": {"enum": list(MODELS)}},
        "required": ["kind"],
        "allOf": [
            {"if": {"properties": {"kind": {"const": kind}}}, "then": json_schema(cls)}
            for kind, cls in MODELS.items()
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
    return _model_in(path, yaml_bytes(path))


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
    kind = Choice(words=tuple(MODELS)).read(content.get("kind"), top.key("kind"), Scope())
    model = read(MODELS[kind], content, top)
    check_onset(top.key("onset_force_n"), model.onset_force_n, model.force_span_n[1])
    return model


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
    return _rounded(plain(type(model), model))


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items() if item is not None}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value
