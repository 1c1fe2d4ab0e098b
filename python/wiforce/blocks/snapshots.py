# SPDX-License-Identifier: GPL-3.0-or-later
"""Snapshots of two antennas, or of devices whose oscillators are free."""

import numpy as np
import pmt
from gnuradio import gr

from ..estimation.capture.folded_groups import folded_ratio, ratio_noise
from ..estimation.capture.frame import FrameFollower
from ..estimation.groups import Array
from ..signal.waveform import Waveform
from ..wiforce_kernels import fold_frames
from . import names
from .argument_types import Kept, typed
from .group_block import NoiseTags, noise_value
from .rules import WaveformOrScene, frames_of
from .stream_watch import DeviceSettings, Timeline, between_tags

_NOISE = pmt.intern(names.NOISE)
# What is true of the ratio where it is true of either antenna.
_OF_EITHER = {names.SATURATED, names.RETUNED}
_VALUES = 4  # I and Q of a sample of two antennas


class antenna_ratio(Kept, gr.sync_block):
    """The channel of one receive antenna over that of another, as folded vectors.

    For a transmitter and a receiver with separate clocks (``reader_clock: free``): the phase of the
    receiver's oscillator is the same on both antennas and cancels in the ratio. Connect the output
    to a ``reader`` with the input ``folded``.

    Input 0 and 1: vectors of a symbol's samples, a frame each (``preamble_fold``,
    ``capture_source``), of the same frames; gaps must be the same. Output: the like; tags are
    those of input 0, with the noise and the slips of both, saturated and retuned where either is.

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

    def start(self) -> bool:
        # A flowgraph that is started again counts items anew, not so after unlock().
        if self.nitems_read(0) == 0:
            self._noise = NoiseTags(), NoiseTags()
        return super().start()

    def work(self, input_items: list[Array], output_items: list[Array]) -> int:
        first, second = input_items
        ratio = folded_ratio(first, second, self._waveform)
        output_items[0][:] = ratio
        count, start = len(first), self.nitems_written(0)
        noise = self._noise_of(0, count), self._noise_of(1, count)
        self._forward_tags(count)
        if count:
            value = noise_value(ratio_noise((first, second), noise, ratio))
            self.add_item_tag(0, start, _NOISE, value)
        return count

    def _forward_tags(self, count: int) -> None:
        sent: set[tuple[int, str]] = set()
        for port in range(2):
            for tag in self.get_tags_in_window(port, 0, count):
                key, item = str(tag.key), tag.offset - self.nitems_read(port)
                new = key in _OF_EITHER and (item, key) not in sent
                if key != names.NOISE and (port == 0 or new or key == names.SLIPPED):
                    sent.add((item, key))
                    self.add_item_tag(0, self.nitems_written(0) + item, tag.key, tag.value)

    def _noise_of(self, port: int, count: int) -> Array:
        """Noise of the items at hand, by the tags of an input; shape (count, 2)."""
        for tag in self.get_tags_in_window(port, 0, count, _NOISE):
            self._noise[port].add(tag.offset, tag.value)
        return self._noise[port].noise(self.nitems_read(port), count)


_RX_TIME, _RETUNED = pmt.intern(names.RX_TIME), pmt.intern(names.RETUNED)
_SNAPSHOT = pmt.intern(names.SNAPSHOT)
_SATURATED = pmt.intern(names.SATURATED)
_MOST_WAITING = 4096  # vectors


class free_fold(Kept, gr.basic_block):
    """Folds the frames of a transmitter on a clock of its own (:class:`.FrameFollower`).

    In: 16-bit samples of two antennas from the first frame on; out: vectors of the same frames.
    Samples at another rate or carrier are discarded, as in ``preamble_fold``.
    """

    @typed
    def __init__(self, waveform: Waveform, carrier: float) -> None:
        vector = (np.complex64, waveform.symbol_length)
        gr.basic_block.__init__(
            self, "free_fold", in_sig=[(np.int16, 2)] * 2, out_sig=[vector, vector]
        )
        self.set_tag_propagation_policy(gr.TPP_DONT)
        self._waveform = waveform
        self.follower = FrameFollower(waveform.frame_length)
        self._timeline = Timeline(waveform.sample_rate_hz)
        self._settings = DeviceSettings("free_fold", waveform.sample_rate_hz, carrier)
        self._gaps = 0
        # Folded vectors (n, 2, N) with their noise (n, 2, 2) and saturation (n,).
        self._waiting: list[tuple[Array, Array, Array]] = []
        self._count = self._written = 0  # vectors folded and put out
        self._marks: list[tuple[int, object, object]] = []  # vector, key, value
        self._retuned = False
        self._begins = True

    def gaps(self) -> int:
        """Number of gaps that tags ``rx_time`` report."""
        return self._gaps

    def samples_lost(self) -> int:
        """Number of samples that they account for."""
        return self._timeline.lost

    def frames_moved(self) -> int:
        """Times that the frame timing shifted without such a tag."""
        return self.follower.moved

    # Nothing is known of the samples lost by these shifts, and no tags are counted as implausible.
    samples_moved = times_ignored = staticmethod(lambda: 0)

    def forecast(self, noutput_items: int, ninputs: int) -> list[int]:
        return [0 if self._waiting else 1] * ninputs

    def general_work(self, input_items: list[Array], output_items: list[Array]) -> int:
        count = min(map(len, input_items))
        if self._count - self._written > _MOST_WAITING:
            count = 0
        if count:
            self._take(np.concatenate([each[:count] for each in input_items], axis=1))
            for port in range(2):
                self.consume(port, count)
        return self._put_out(output_items)

    def _take(self, items: Array) -> None:
        for part, tag in between_tags(self, items):
            if self._settings.usable():
                self._fold(self.follower.take(part))
            elif len(part):
                self._lose(len(part))
            if tag is None:
                break
            if self._settings.note(tag):
                self._lose(0)  # no frame has samples from both sides of it
                self._retuned = True
            if not pmt.eq(tag.key, _RX_TIME):
                continue
            if lost := self._timeline.note_tag(tag.offset, tag.value):
                self._lose(lost)
                self._gaps += 1

    def _lose(self, samples: int) -> None:
        self._fold(self.follower.lose(samples, _VALUES))
        self._begins = True

    def _fold(self, samples: Array) -> None:
        frames = samples.reshape(-1, self._waveform.frame_length, _VALUES)
        if not len(frames):
            return
        if self._begins:
            index = pmt.from_uint64(self._count + self.follower.lost)
            self._marks.append((self._count, _SNAPSHOT, index))
            self._begins = False
        if self._retuned:
            self._marks.append((self._count, _RETUNED, pmt.from_uint64(1)))
            self._retuned = False
        waveform = self._waveform
        averaged = waveform.first_averaged, waveform.repetitions, waveform.symbol_length
        first, second = (fold_frames(frames[:, :, at : at + 2], *averaged) for at in (0, 2))
        vectors = np.stack([first[0], second[0]], axis=1)
        noise = np.stack([first[1], second[1]], axis=1)
        full = np.isin(np.arange(len(frames)), [*first[2], *second[2]])
        self._waiting.append((vectors, noise, full))
        self._count += len(frames)

    def _put_out(self, outputs: list[Array]) -> int:
        if not self._waiting:
            return 0
        vectors, noise, full = self._waiting[0]
        count = min(map(len, (vectors, *outputs)))
        for port, out in enumerate(outputs):
            out[:count] = vectors[:count, port]
            self.add_item_tag(port, self._written, _NOISE, noise_value(noise[:count, port]))
        for item in np.flatnonzero(full[:count]):
            self.add_item_tag(0, self._written + int(item), _SATURATED, pmt.from_uint64(1))
        while self._marks and self._marks[0][0] < self._written + count:
            item, key, value = self._marks.pop(0)
            self.add_item_tag(0, item, key, value)
        self._waiting[0] = vectors[count:], noise[count:], full[count:]
        if count == len(vectors):
            self._waiting.pop(0)
        self._written += count
        return count
