# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene to read a capture with: its own or another, and how that differs from its own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..io.capture.channel_snapshots import ChannelSnapshots
from ..io.capture.recordings import Capture
from ..io.text.schema import read
from ..io.text.values import KeyPath
from .load import load_capture_scene, load_scene
from .schema import Scene

# Who reads a capture may well simulate something else. The sensor files have another location
# after a capture was moved, and another calibration of a sensor or a skin is no contradiction.
_NOT_COMPARED = ("simulation", "model", "spreading", "spreading_file")
_WAVEFORM, _SYMBOL = "sounding.waveform", "sounding.symbol"


def scene_of(
    capture: Capture | ChannelSnapshots, scene: str | Path | dict[str, Any] | Scene | None = None
) -> tuple[Scene, list[str]]:
    """The scene to read a capture with: the capture's own unless another is given.

    Parameters
    ----------
    scene : str, Path, dict or Scene, optional
        As for :func:`load_scene`.

    Returns
    -------
    scene : Scene
    differences : list of str
        One line for each key in which the scene given differs from the capture's own; empty when
        none is given, or when the capture holds none.

    Raises
    ------
    InputError
        For a mistake in the scene, or when there is none.
    """
    if scene is None:
        return load_capture_scene(capture), []
    given = load_scene(scene)
    if capture.scene is None:
        return given, []
    return given, list(_differences(capture, given))


def accepted_suspicions(scene: Scene) -> list[str]:
    """Likely mistakes in the calibrations of a scene's sensors, which were accepted.

    Returns list of str: a sentence each.
    """
    return [
        f"sensor '{sensor.name}' was calibrated in spite of a suspicion: {text}"
        for sensor in scene.sensors
        for text in sensor.load_model(scene).provenance.get("suspicions", ())
    ]


def _differences(capture: Capture | ChannelSnapshots, given: Scene) -> Iterator[str]:
    # Sensor files may be missing here: the scene stored is not loaded, only understood.
    try:
        stored = read(Scene, capture.scene, KeyPath("wiforce:scene"), path=capture.path)
    except InputError as error:
        yield f"the capture's own scene cannot be compared with the scene given ({error})"
        return
    own, other = _by_key(stored), _by_key(given)
    for key in dict.fromkeys([*own, *other]):
        if own.get(key) == other.get(key):
            continue
        if key != _SYMBOL:
            before, now = (_text(values.get(key)) for values in (own, other))
            yield f"{key} is {before} in the capture's own scene, {now} in the scene given"
        elif own.get(_WAVEFORM) == other.get(_WAVEFORM):
            # Otherwise the names say it already; the samples as text tell a reader nothing.
            yield f"{key}: {own[_WAVEFORM]} holds another symbol than in the capture's own scene"


def _by_key(scene: Scene) -> dict[str, Any]:
    """Values of a scene by dotted key; sensors are named, since their order means nothing."""
    values = scene.as_dict()
    sensors = {sensor.pop("name"): sensor for sensor in values.pop("sensors")}
    flat: dict[str, Any] = {"sensors": sorted(sensors)}
    _flatten(values, "", flat)
    for name, sensor in sensors.items():
        _flatten(sensor, f"sensors[{name}].", flat)
    return flat


def _flatten(values: dict[str, Any], prefix: str, flat: dict[str, Any]) -> None:
    for key, value in values.items():
        if key in _NOT_COMPARED:
            continue
        if isinstance(value, dict):
            _flatten(value, f"{prefix}{key}.", flat)
        else:
            flat[f"{prefix}{key}"] = value


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_text, value))}]"
    return "absent" if value is None else str(value)
