# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: transmit samples, the sounding frame repeated."""

from typing import Any

import numpy as np
from gnuradio import blocks, gr

from ...errors import InputError
from ...estimation.groups import Array
from ...io.capture.samples import item_type_named
from ..argument_types import typed
from ..frame_settings import WaveformOrScene, frames_of


def largest_amplitude(frame: Array) -> float:
    """The amplitude at which the largest component of a frame reaches full scale.

    Parameters
    ----------
    frame : ndarray of complex, shape (n,)
        Of unit mean preamble power.

    Returns
    -------
    float

    Examples
    --------
    >>> largest_amplitude(np.array([0.5 + 2j]))
    0.5
    """
    return 1 / np.abs(frame.view(float)).max()


class sounding_source(gr.hier_block2):
    """Transmit samples: preamble and guard zeros, repeated indefinitely.

    Output: complex samples, or pairs of 16-bit integers (full scale 32767) for ``sc16``. The
    first sample is the first of a frame.

    Parameters
    ----------
    waveform : str, Path, Waveform or Scene
        A shipped waveform's name, or the ``.npy`` file of a symbol. A Waveform or a scene (its
        ``.yaml`` file, or the ID of a Scene block) states its own frame length, rate and symbol.
    frame_length : int
        Samples per frame, at least those of the preamble.
    sample_rate : float
        In samples per second.
    amplitude : float
        Root of the mean preamble power, above 0 and such that no component exceeds full scale.
    item_type : str
        ``fc32`` or ``sc16``.
    symbol_length, repetitions, averaged_repetitions : int
        As the keys of a scene's ``sounding``; 0 for their defaults.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> source = sounding_source("repeated", frame_length=720, amplitude=0.5)
    >>> source.set_amplitude(0.3)
    """

    @typed
    def __init__(
        self,
        waveform: WaveformOrScene = "repeated",
        frame_length: int = 720,
        sample_rate: float = 12.5e6,
        amplitude: float = 0.5,
        item_type: str = "fc32",
        symbol_length: int = 0,
        repetitions: int = 0,
        averaged_repetitions: int = 0,
    ) -> None:
        size = item_type_named(item_type).sample_bytes
        self._frame = frames_of(
            waveform, frame_length, sample_rate, symbol_length, repetitions, averaged_repetitions
        ).frame()
        self._item_type = item_type
        data = self._data(amplitude)
        gr.hier_block2.__init__(
            self, "sounding_source", gr.io_signature(0, 0, 0), gr.io_signature(1, 1, size)
        )
        if item_type == "fc32":
            self._source = blocks.vector_source_c(data, True)
        else:
            self._source = blocks.vector_source_s(data, True, 2)
        self.connect(self._source, self)

    @typed
    def set_amplitude(self, amplitude: float) -> None:
        """Change the amplitude while running."""
        self._source.set_data(self._data(amplitude))

    def _data(self, amplitude: float) -> list[Any]:
        parts = self._frame.view(float)
        largest = largest_amplitude(self._frame)
        if not 0 < amplitude <= largest:
            raise InputError("amplitude", f"must be above 0 and at most {largest:.4f}", amplitude)
        if self._item_type == "fc32":
            return (amplitude * self._frame).astype(np.complex64).tolist()
        return np.rint(32767 * amplitude * parts).astype(np.int16).tolist()
