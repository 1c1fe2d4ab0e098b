# SPDX-License-Identifier: GPL-3.0-or-later
"""What the blocks' parameters describe, and rules of them for editors that check what is typed.

The asserts of the GNU Radio Companion descriptions call the predicates. Each runs the code of the
constructors, so that both always agree.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..estimation.groups import Array
from ..scene import Scene, load_scene
from ..signal.symbols import LONGEST_SYMBOL
from ..signal.waveform import WAVEFORMS, Waveform, sounding_waveform

# What the parameter ``waveform`` of blocks takes.
WaveformOrScene = str | Path | Waveform | Scene
# Samples that hold five repetitions of any symbol.
_LONGEST_PREAMBLE = 5 * LONGEST_SYMBOL


def scene_meant(waveform: WaveformOrScene) -> Scene | None:
    """The scene, or ``.yaml`` file of one, given in place of a waveform; None for a waveform."""
    if isinstance(waveform, Scene):
        return waveform
    if str(waveform).lower().endswith((".yaml", ".yml")):
        return load_scene(str(waveform))
    return None


def frames_of(
    waveform: WaveformOrScene,
    frame_length: int,
    sample_rate: float,
    symbol_length: int = 0,
    repetitions: int = 0,
    averaged_repetitions: int = 0,
) -> Waveform:
    """The frame of a block, of a Waveform, a scene, or a name and keys, 0 for defaults."""
    if isinstance(waveform, Waveform):
        return waveform
    scene = scene_meant(waveform)
    if scene is not None:
        return scene.waveform()
    stated = {
        "symbol_length": symbol_length,
        "repetitions": repetitions,
        "averaged_repetitions": averaged_repetitions,
    }
    for name, value in stated.items():
        if value < 0:
            raise InputError(name, "must be positive, or 0 for the default", value)
    given: dict[str, Any] = {name: value for name, value in stated.items() if value}
    return sounding_waveform(str(waveform), frame_length, sample_rate, **given)


def largest_amplitude(frame: Array) -> float:
    """Amplitude at which the largest component of a frame of unit mean power is at full scale."""
    return float(1 / np.abs(frame.view(float)).max())


def symbol_length_of(waveform: WaveformOrScene, symbol_length: int = 0) -> int:
    """Samples of the symbol of a waveform or a scene: the length of folded vectors."""
    name = str(waveform)
    stated = isinstance(waveform, Waveform | Scene) or name in WAVEFORMS
    if stated or name.lower().endswith(".npy"):
        return frames_of(waveform, _LONGEST_PREAMBLE, 1.0, symbol_length).symbol_length
    return load_scene(name).waveform().symbol_length


class _NamedScene(str):
    """The file of a scene, with the scene's attributes."""

    def __getattr__(self, name: str) -> Any:
        if name == "_scene":
            self._scene = load_scene(str(self))
            return self._scene
        return getattr(self._scene, name)


def scene_in_companion(file: str) -> _NamedScene:
    """A Scene block's file with the scene's attributes, as Companion takes only text for files."""
    return _NamedScene(str(load_scene(file).path))


def is_scene(scene: Any) -> bool:
    """Whether a reader can be built from a scene: a file, a shipped scene's name or a dict."""
    from ..planning.plan import plan

    def build() -> Any:
        planned = plan(scene)
        return planned.table, planned.sensors

    return _accepted(build)


def is_carrier_of(model: Any, frequency_hz: float) -> bool:
    """Whether a sensor model can be loaded, and has a carrier in Hz or can be moved to it."""
    from ..sensor import load_sensor

    return _accepted(lambda: load_sensor(model, frequency_hz=frequency_hz))


def is_waveform(
    waveform: Any,
    frame_length: int,
    symbol_length: int = 0,
    repetitions: int = 0,
    averaged_repetitions: int = 0,
) -> bool:
    """Whether frames can be made of a waveform or a scene, with these keys, 0 for defaults."""
    stated = symbol_length, repetitions, averaged_repetitions
    return _accepted(lambda: frames_of(waveform, frame_length, 1.0, *stated))


def is_amplitude_of(waveform: str, amplitude: float, symbol_length: int = 0) -> bool:
    """Whether a sounding frame of some amplitude (root mean power) stays within full scale."""

    def largest() -> float:
        return largest_amplitude(
            frames_of(waveform, _LONGEST_PREAMBLE, 1.0, symbol_length).preamble
        )

    return _accepted(largest) and bool(0 < amplitude <= largest())


def is_capture(capture: Any, datatype: str | None = None) -> bool:
    """Whether a recording, or a raw file of a ``datatype``, can be opened."""
    from ..io.capture.recordings import open_capture

    return _accepted(lambda: open_capture(capture, datatype))


def _accepted(build: Callable[[], Any]) -> bool:
    try:
        build()
    except (InputError, TypeError):
        # TypeError: a value of a wrong type, such as a number for a file name.
        return False
    return True
