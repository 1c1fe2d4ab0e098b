# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: aligns the start of a stream of samples with the first whole frame."""

import pmt
from gnuradio import gr

from ...errors import InputError
from ...estimation.groups import Array
from ...io.capture.samples import item_type_named
from .. import names
from ..argument_types import typed
from ..frame_settings import WaveformOrScene, frames_of
from ..kept import Kept
from ..stream_watch import SearchWatch
from .frame_search import FrameSearch, Tag


class frame_alignment(Kept, gr.basic_block):
    """Finds the offset of the first frame in each run, and drops the samples before it.

    A device delays its own transmit signal by a time that is constant during a run but unknown.
    The offset is estimated over the first frames, which are passed on as well. Tags stay with their
    samples, and the first sample that is passed on has its ``rx_time``. Samples lost later (an
    overflow) are handled by the following blocks, which receive the time in its tag.

    Input and output: samples, complex or complex 16-bit integers. After a second of samples without
    frames, and at the end of a stream without any, a warning names the cause. Message port
    ``warnings`` (out): the same, a dict with ``text``.

    Parameters
    ----------
    waveform : str, Path, Waveform or Scene
        A shipped waveform's name, or the ``.npy`` file of a symbol. A Waveform or a scene (its
        ``.yaml`` file, or the ID of a Scene block) states its own frame length, rate and symbol.
    frame_length : int
        Samples per frame.
    sample_rate : float
        Samples per second.
    item_type : str
        ``fc32`` or ``sc16``.
    search_frames : int
        Frames that are averaged to find the offset.
    symbol_length, repetitions, averaged_repetitions : int
        As the keys of a scene's ``sounding``; 0 for their defaults.

    Attributes
    ----------
    offset : int or None
        Samples before the first frame; None until frames are found.
    start_time : tuple or None
        (whole seconds, fraction) of the first sample passed on; None without ``rx_time``.
    searches : int
        Number of searches without a result.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> alignment = frame_alignment("repeated", frame_length=720, item_type="sc16")
    >>> alignment.offset is None  # until frames are found
    True
    """

    @typed
    def __init__(
        self,
        waveform: WaveformOrScene = "repeated",
        frame_length: int = 720,
        sample_rate: float = 12.5e6,
        item_type: str = "fc32",
        search_frames: int = 2000,
        symbol_length: int = 0,
        repetitions: int = 0,
        averaged_repetitions: int = 0,
    ) -> None:
        item = item_type_named(item_type).item
        if search_frames < 1:
            raise InputError("search_frames", "must be 1 or more", search_frames)
        frames = frames_of(
            waveform, frame_length, sample_rate, symbol_length, repetitions, averaged_repetitions
        )
        gr.basic_block.__init__(self, "frame_alignment", in_sig=[item], out_sig=[item])
        self.set_tag_propagation_policy(gr.TPP_DONT)
        self._frames, self._search_frames = frames, search_frames
        self._begin()
        self.message_port_register_out(pmt.intern(names.WARNINGS))

    def _begin(self) -> None:
        self.search = FrameSearch(self._frames, self._search_frames)
        self._watch = SearchWatch(self._frames, self._warn)

    def _warn(self, sentence: str) -> None:
        gr.log.warn(sentence)
        self.message_port_pub(pmt.intern(names.WARNINGS), pmt.to_pmt({names.TEXT: sentence}))

    @property
    def offset(self) -> int | None:
        return self.search.offset

    @property
    def start_time(self) -> tuple[int, float] | None:
        return self.search.start_time

    @property
    def searches(self) -> int:
        return self.search.searches

    def forecast(self, noutput_items: int, ninputs: int) -> list[int]:
        return [0 if self.search.holds else 1] * ninputs

    def general_work(self, input_items: list[Array], output_items: list[Array]) -> int:
        items, out, search = input_items[0], output_items[0], self.search
        if search.offset is None:
            items = items[: search.wanted]
            search.take(items, self._tags_of(len(items)))
            if search.offset is None:
                self._watch.take(items)
            self.consume(0, len(items))
            return 0
        produced = search.put_out(self, out)
        count = 0 if search.holds else min(len(items), len(out) - produced)
        if count:
            search.tags.extend(self._tags_of(count))
            out[produced : produced + count] = items[:count]
            produced += count
            search.put_tags(self, produced)
        self.consume(0, count)
        return produced

    def start(self) -> bool:
        self._begin()  # a transmitter that starts again may begin anywhere in a frame
        return True

    def stop(self) -> bool:
        if self.offset is None:
            self._watch.end()
        return True

    def _tags_of(self, count: int) -> list[Tag]:
        tags = self.get_tags_in_window(0, 0, count)
        return [(tag.offset, tag.key, tag.value) for tag in tags]
