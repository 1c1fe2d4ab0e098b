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
    """The value of a Scene block while a flowgraph is edited.

    Companion takes only text for parameters with a file button. With a text that has the
    attributes of a scene, the block's ID can be given there, and generated programs pass the scene
    itself.

    Parameters
    ----------
    file : str
        A file, or the name of a shipped scene.

    Returns
    -------
    str
        The scene's file; its attributes are those of :class:`scene.Scene`.

    Raises
    ------
    InputError
        (A ValueError) naming file and key, rule and value.

    Examples
    --------
    >>> scene = scene_in_companion("demo")
    >>> scene.endswith("demo.yaml"), scene.radio.sample_rate_hz, is_scene(scene)
    (True, 12500000.0, True)
    """
    return _NamedScene(str(load_scene(file).path))


def is_scene(scene: Any) -> bool:
    """Whether a reader can be built from a scene.

    Parameters
    ----------
    scene : object
        A file, a shipped scene's name or a dict.

    Returns
    -------
    bool

    Examples
    --------
    >>> is_scene("demo"), is_scene("missing.yaml")
    (True, False)
    """
    from ..planning.plan import plan

    def build() -> Any:
        planned = plan(scene)
        return planned.table, planned.sensors

    return _accepted(build)


def is_sensor(model: Any) -> bool:
    """Whether a sensor model can be loaded.

    Parameters
    ----------
    model : object
        A file, a shipped sensor's name or a SensorModel.

    Returns
    -------
    bool

    Examples
    --------
    >>> is_sensor("line-900mhz"), is_sensor(7)
    (True, False)
    """
    from ..sensor import SensorModel, load_sensor

    return isinstance(model, SensorModel) or _accepted(lambda: load_sensor(model))


def is_carrier_of(model: Any, frequency_hz: float) -> bool:
    """Whether a sensor model contains a carrier, or can be transferred to it.

    Parameters
    ----------
    model : object
        A file or a shipped sensor's name.
    frequency_hz : float
        Carrier, in Hz.

    Returns
    -------
    bool

    Examples
    --------
    >>> is_carrier_of("line-900mhz", 900e6), is_carrier_of("line-900mhz", 5e9)
    (True, False)
    """
    from ..sensor import load_sensor

    return _accepted(lambda: load_sensor(model, frequency_hz=frequency_hz))


def is_waveform(
    waveform: Any,
    frame_length: int,
    symbol_length: int = 0,
    repetitions: int = 0,
    averaged_repetitions: int = 0,
) -> bool:
    """Whether frames can be made of a waveform.

    Parameters
    ----------
    waveform : object
        A shipped waveform's name, the ``.npy`` file of a symbol, or a scene.
    frame_length : int
        Samples per frame.
    symbol_length, repetitions, averaged_repetitions : int
        As the keys of a scene's ``sounding``; 0 for their defaults.

    Returns
    -------
    bool

    Examples
    --------
    >>> is_waveform("chirp", 720), is_waveform("chirp", 720, symbol_length=256)
    (True, False)
    """
    from .frame_settings import frames_of

    stated = symbol_length, repetitions, averaged_repetitions
    return _accepted(lambda: frames_of(waveform, frame_length, 1.0, *stated))


def is_amplitude_of(waveform: str, amplitude: float, symbol_length: int = 0) -> bool:
    """Whether a sounding frame of some amplitude stays within full scale.

    Parameters
    ----------
    waveform : str
        As for :func:`is_waveform`.
    amplitude : float
        Root of the mean preamble power.
    symbol_length : int
        As stated; 0 for the waveform's default.

    Returns
    -------
    bool

    Examples
    --------
    >>> is_amplitude_of("repeated", 0.5), is_amplitude_of("repeated", 2.0)
    (True, False)
    """
    from .frame_settings import LONGEST_PREAMBLE, frames_of
    from .sounding import largest_amplitude

    def largest() -> float:
        return largest_amplitude(frames_of(waveform, LONGEST_PREAMBLE, 1.0, symbol_length).preamble)

    return _accepted(largest) and bool(0 < amplitude <= largest())


def is_capture(capture: Any, datatype: str | None = None) -> bool:
    """Whether a recording can be opened.

    Parameters
    ----------
    capture : object
        SigMF pair, by either file's name or their common stem.
    datatype : str, optional
        ``ci16_le`` or ``cf32_le``: the file is raw samples of this type.

    Returns
    -------
    bool

    Examples
    --------
    >>> is_capture("missing")
    False
    """
    from ..io.capture.recordings import open_capture

    return _accepted(lambda: open_capture(capture, datatype))


def _accepted(build: Callable[[], Any]) -> bool:
    try:
        build()
    except (InputError, TypeError):
        # TypeError: a value of a wrong type, such as a number for a file name.
        return False
    return True
