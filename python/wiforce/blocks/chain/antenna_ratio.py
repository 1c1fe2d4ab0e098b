# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: ratio of two receive antennas, as folded vectors."""

import numpy as np
import pmt
from gnuradio import gr

from ...estimation.capture.antennas import folded_ratio, ratio_noise
from ...estimation.groups import Array
from .. import names
from ..argument_types import typed
from ..frame_settings import WaveformOrScene, frames_of
from ..kept import Kept
from .noise_tags import NoiseTags, noise_value

_NOISE = pmt.intern(names.NOISE)


class antenna_ratio(Kept, gr.sync_block):
    """The channel of one receive antenna over that of another, as folded vectors.

    For a transmitter and a receiver with separate clocks (``reader_clock: free``): the phase of the
    receiver's oscillator is the same on both antennas and cancels in the ratio. Connect the output
    to a ``reader`` with the input ``folded``.

    Input 0 and 1: vectors of a symbol's samples, a frame each (``preamble_fold``,
    ``capture_source``), of the same frames; gaps must be the same. Output: the like; tags are
    those of input 0, with the noise of both.

    Parameters
    ----------
    waveform : str, Path, Waveform or Scene
        A shipped waveform's name, or the ``.npy`` file of a symbol. A Waveform or a scene (its
        ``.yaml`` file, or the ID of a Scene block) states its own frame length, rate and symbol.
    frame_length : int
        Samples per frame.
    sample_rate : float
        Samples per second.
    symbol_length, repetitions, averaged_repetitions : int
        As the keys of a scene's ``sounding``; 0 for their defaults.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> ratio = antenna_ratio("repeated", frame_length=720)
    """

    @typed
    def __init__(
        self,
        waveform: WaveformOrScene = "repeated",
        frame_length: int = 720,
        sample_rate: float = 12.5e6,
        symbol_length: int = 0,
        repetitions: int = 0,
        averaged_repetitions: int = 0,
    ) -> None:
        self._waveform = frames_of(
            waveform, frame_length, sample_rate, symbol_length, repetitions, averaged_repetitions
        )
        vector = (np.complex64, self._waveform.symbol_length)
        gr.sync_block.__init__(self, "antenna_ratio", in_sig=[vector, vector], out_sig=[vector])
        self.set_tag_propagation_policy(gr.TPP_DONT)
        self._noise = NoiseTags(), NoiseTags()

    def work(self, input_items: list[Array], output_items: list[Array]) -> int:
        first, second = input_items
        ratio = folded_ratio(first, second, self._waveform)
        output_items[0][:] = ratio
        count, start = len(first), self.nitems_written(0)
        noise = self._noise_of(0, count), self._noise_of(1, count)
        for tag in self.get_tags_in_window(0, 0, count):
            if not pmt.equal(tag.key, _NOISE):
                offset = start + tag.offset - self.nitems_read(0)
                self.add_item_tag(0, offset, tag.key, tag.value)
        if count:
            value = noise_value(ratio_noise((first, second), noise, ratio))
            self.add_item_tag(0, start, _NOISE, value)
        return count

    def _noise_of(self, port: int, count: int) -> Array:
        """Noise of the items at hand, by the tags of an input; shape (count, 2)."""
        for tag in self.get_tags_in_window(port, 0, count, _NOISE):
            self._noise[port].add(tag.offset, tag.value)
        return self._noise[port].noise(self.nitems_read(port), count)
