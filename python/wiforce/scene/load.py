# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes by name: files, and the scenes that are shipped."""

from __future__ import annotations

import os
from collections.abc import Container, Iterator
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any

from ..errors import InputError, name_rule
from ..io.capture.channel_snapshots import ChannelSnapshots
from ..io.capture.names import SUFFIXES
from ..io.capture.recordings import Capture
from ..io.text.schema import read
from ..io.text.textfile import read_yaml
from ..io.text.values import KeyPath
from ..signal.symbols import decode_symbol, encode_symbol, read_symbol
from .consistency import check_scene
from .schema import Scene, Sounding
from .simulated import with_all_tags
from .surface import skin_of


def load_scene(scene: str | Path | dict[str, Any] | Scene) -> Scene:
    """Read and check a scene.

    Parameters
    ----------
    scene : str, Path, dict or Scene
        A YAML file, the name of a shipped scene, or the mapping that such a file would hold. A
        Scene is returned as it is.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        For an unreadable file, an unknown key, a wrong type, a value out of range, keys that
        contradict each other, or anything that is no scene. The message names file, dotted key,
        rule and value.

    Examples
    --------
    >>> load_scene("demo").radio.center_frequency_hz
    915000000.0
    >>> scene = {"sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 0}]}
    >>> load_scene(scene)
    Traceback (most recent call last):
    gnuradio.wiforce.errors.InputError: scene: sensors[0].clock_hz: must be a number above 0 and \
at most 1e+06 Hz, got 0
    """
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, dict):
        return _checked(scene, KeyPath("scene"), None)
    if not isinstance(scene, str | Path):
        rule = "must be a scene file, the name of a shipped scene, a mapping or a Scene"
        raise InputError("scene", rule, scene)
    path = _scene_path(scene)
    values = read_yaml(path)
    if "kind" in values and "sensors" not in values:
        raise InputError(scene, "is a sensor model; a scene lists its sensors under 'sensors'")
    return _checked(values, KeyPath(str(scene)), path)


def load_capture_scene(capture: Capture | ChannelSnapshots) -> Scene:
    """Read the scene in a capture's metadata; sensor files are relative to the capture."""
    if capture.scene is None:
        rule = "holds no scene; name one with --scene"
        raw = isinstance(capture, Capture) and capture.sample_rate_hz is None
        if raw and capture.path.with_suffix(".sigmf-meta").exists():
            rule += ", or leave out --datatype to use that of its metadata"
        raise InputError(capture.path, rule)
    name = "scene" if isinstance(capture, ChannelSnapshots) else "wiforce:scene"
    where = KeyPath(f"{capture.path}: {name}")
    if not isinstance(capture.scene, dict):
        raise InputError(where.source, "must hold a mapping of keys to values", capture.scene)
    return _checked(capture.scene, where, capture.path)


def _checked(values: dict[str, Any], where: KeyPath, path: Path | None) -> Scene:
    scene = read(Scene, values, where, path=path)
    scene = replace(scene, sounding=_with_symbol(scene.sounding, where, path))
    tagged = with_all_tags(scene.simulation, scene.sensors, where.key("simulation"))
    scene = replace(scene, simulation=tagged)
    check_scene(scene, where.source)
    return scene


def _with_symbol(sounding: Sounding, where: KeyPath, path: Path | None) -> Sounding:
    """The sounding with the symbol of its file, so that nothing else needs to read it."""
    where = where.key("sounding")
    if not sounding.waveform.lower().endswith(".npy"):
        if sounding.symbol is not None:
            raise where.key("symbol").error("applies to a waveform from a .npy file only")
        return sounding
    if sounding.symbol is None:
        # Relative to the scene's file.
        file = (path.parent if path else Path()) / sounding.waveform
        key = where.key("waveform")
        sounding = replace(sounding, symbol=encode_symbol(read_symbol(file, key)))
    else:
        decode_symbol(sounding.symbol, where.key("symbol"))
    return sounding


def shipped_scenes() -> list[str]:
    """Names of the scenes that are shipped, sorted."""
    return sorted(path.stem for path in _shipped_folder().glob("*.yaml"))


def sampled_scenes() -> list[str]:
    """Names of the scenes that are shipped and describe samples, not packets; sorted."""
    return [name for name in shipped_scenes() if load_scene(name).packets is None]


def about_scene(name: str) -> str:
    """What a scene shows: the comment that its file begins with, as one line."""
    lines = _scene_path(name).read_text(encoding="utf-8").splitlines()
    return " ".join(line.lstrip("# ") for line in takewhile(lambda x: x.startswith("#"), lines))


def _shipped_folder() -> Path:
    from .._config import DATA_DIR

    return Path(DATA_DIR) / "scenes"


def _scene_path(scene: str | Path) -> Path:
    """The file meant: a shipped scene when the name has no suffix and no such file exists."""
    path = Path(scene)
    if path.suffix in SUFFIXES:
        raise InputError(path, "is a file of a capture; a scene is a .yaml file or a shipped name")
    # Those of os.path, unlike a Path's, answer for names that are too long as well.
    if os.path.isfile(path) or path.suffix:
        return path
    if str(scene) not in shipped_scenes():
        if path.name and os.path.exists(path):
            return path
        raise InputError("scene", name_rule("scene", shipped_scenes(), str(scene)), str(scene))
    return _shipped_folder() / f"{scene}.yaml"


# Who reads a capture may well simulate something else. The sensor files have another location
# after a capture was moved, and another calibration of a sensor or a skin is no contradiction.
_NOT_COMPARED = ("simulation", "model", "spreading", "spreading_file")


def scene_of(
    capture: Capture | ChannelSnapshots, scene: str | Path | dict[str, Any] | Scene | None = None
) -> tuple[Scene, list[str]]:
    """The scene to read a capture with, and a line for each key that differs from its own."""
    if scene is None:
        return load_capture_scene(capture), []
    given = load_scene(scene)
    if capture.scene is None:
        return given, []
    return given, list(_differences(capture, given))


def accepted_suspicions(scene: Scene) -> list[str]:
    """Likely mistakes in calibrations of sensors and skin that were accepted, a sentence each."""
    found = [
        (f"sensor '{sensor.name}'", text)
        for sensor in scene.sensors
        for text in sensor.load_model(scene).provenance.get("suspicions", ())
    ]
    if (skin := skin_of(scene)) is not None:
        found += [(f"surface '{skin.name}'", text) for text in skin.spreading.suspicions or ()]
    return [f"{what} was calibrated in spite of a suspicion: {text}" for what, text in found]


def _differences(capture: Capture | ChannelSnapshots, given: Scene) -> Iterator[str]:
    # Sensor files may be missing here: the scene stored is not loaded, only understood.
    try:
        stored = read(Scene, capture.scene, KeyPath("wiforce:scene"), path=capture.path)
    except InputError as error:
        yield f"the capture's own scene cannot be compared with the scene given ({error})"
        return
    names = {sensor.name for sensor in stored.sensors} & {sensor.name for sensor in given.sensors}
    same_waveform = stored.sounding.waveform == given.sounding.waveform
    for key, own, other in _differing(_by_name(stored, names), _by_name(given, names)):
        if key != "sounding.symbol":
            own, other = _text(own), _text(other)
            yield f"{key} is {own} in the capture's own scene, {other} in the scene given"
        elif same_waveform:
            # Otherwise the names say it already; the samples as text tell a reader nothing.
            waveform = stored.sounding.waveform
            yield f"{key}: {waveform} holds another symbol than in the capture's own scene"


def _by_name(scene: Scene, names: Container[str]) -> dict[str, Any]:
    """Values of a scene, with a key of its own for each sensor of these names."""
    values = scene.as_dict()
    sensors = {sensor.pop("name"): sensor for sensor in values.pop("sensors")}
    common = {f"sensors[{name}]": own for name, own in sensors.items() if name in names}
    return {"sensors": sorted(sensors), **values, **common}


def _differing(
    own: dict[str, Any], given: dict[str, Any], prefix: str = ""
) -> Iterator[tuple[str, Any, Any]]:
    """Dotted keys that differ, and both values; None where one is absent."""
    for key in dict.fromkeys([*own, *given]):
        one, other = own.get(key), given.get(key)
        if key in _NOT_COMPARED or one == other:
            continue
        if isinstance(one, dict) or isinstance(other, dict):
            yield from _differing(one or {}, other or {}, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", one, other


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.9g}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_text, value))}]"
    return "absent" if value is None else str(value)
