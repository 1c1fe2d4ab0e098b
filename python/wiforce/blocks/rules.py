# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules of the blocks' parameters as predicates, for editors that check a value while it is typed.

The asserts of the GNU Radio Companion descriptions call them. Each runs the code of the
constructors, so that both always agree.
"""

from collections.abc import Callable
from typing import Any

from ..errors import InputError
from ..scene import load_scene


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


def is_sensor(model: Any) -> bool:
    """Whether a sensor model, or its file or name, can be loaded."""
    from ..sensor import SensorModel, load_sensor

    return isinstance(model, SensorModel) or _accepted(lambda: load_sensor(model))


def is_carrier_of(model: Any, frequency_hz: float) -> bool:
    """Whether a sensor model contains a carrier in Hz, or can be transferred to it."""
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
    from .frame_settings import frames_of

    stated = symbol_length, repetitions, averaged_repetitions
    return _accepted(lambda: frames_of(waveform, frame_length, 1.0, *stated))


def is_amplitude_of(waveform: str, amplitude: float, symbol_length: int = 0) -> bool:
    """Whether a sounding frame of some amplitude (root mean power) stays within full scale."""
    from .frame_settings import LONGEST_PREAMBLE, frames_of
    from .sounding import largest_amplitude

    def largest() -> float:
        return largest_amplitude(frames_of(waveform, LONGEST_PREAMBLE, 1.0, symbol_length).preamble)

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
