# SPDX-License-Identifier: GPL-3.0-or-later
"""Streams of samples that begin with a frame."""

from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from ..errors import InputError
from ..estimation.capture.frame import find_frame_offset, samples_needed, searched_samples
from ..estimation.capture.recorded_frames import search_problem
from ..estimation.groups import Array
from ..io.capture.samples import item_type_named, samples_of
from ..press.sensor_state import PATIENCE_S
from ..signal.waveform import Waveform
from . import names
from .argument_types import Kept, typed
from .rules import WaveformOrScene, frames_of
from .stream_watch import Timeline, time_value

_RX_TIME, _RETUNED = pmt.intern(names.RX_TIME), pmt.intern(names.RETUNED)

Tag = tuple[int, Any, Any]


class FrameSearch:
    """Holds the samples of a stream until its frames are found, and gives those from the first on.

    The offset is that of the first of several antennas; a gap begins the search anew. ``offset``
    and ``start_time`` (whole seconds, fraction) are None until known; ``searches`` counts those
    without a result, ``items`` all samples taken; ``tags`` are (item, key, value) not put out yet.
    """

    def __init__(
        self, waveform: Waveform, search_frames: int | None = None, antennas: int = 1
    ) -> None:
        self._waveform = waveform
        self._antennas = antennas
        self._needed = searched_samples(waveform)
        if search_frames is not None:
            self._needed = search_frames * waveform.frame_length
        self.offset: int | None = None
        self.start_time: tuple[int, float] | None = None
        self.searches = 0
        self.tags: deque[Tag] = deque()
        self._timeline = Timeline(waveform.sample_rate_hz)
        self.items = 0
        # First ones of the last search without a result: another thread may ask for the problem.
        self._searched: Array | None = None
        self._held: deque[Array] = deque()
        self._held_start = self._held_count = 0

    @property
    def wanted(self) -> int:
        """Samples that the search takes next, however many samples come at once."""
        return self._needed - self._held_count

    @property
    def holds(self) -> bool:
        """Whether samples from the first frame on are to be put out."""
        return self.offset is not None and bool(self._held)

    def problem(self) -> str:
        """Why no frames have been found in the samples taken so far."""
        if not self.items:
            return "no samples were received"
        rate_hz, ended = self._waveform.sample_rate_hz, ""
        if self.items < self._needed:
            ended = (
                f"the stream has ended after {self.items / rate_hz:.3g} s; frames are searched in "
                f"{self._needed / rate_hz:.3g} s"
            )
        samples = self._held_samples() if self._searched is None else self._searched
        needed = samples_needed(self._waveform.frame_length)
        return search_problem(samples[:needed], self._waveform, ended)

    def take(self, items: Array, tags: Iterable[Tag]) -> None:
        """Take up to ``wanted`` samples, complex64 (n,) or int16 (n, 2 A), and their tags."""
        gap = None
        for item, key, value in tags:
            if pmt.eq(key, _RX_TIME) and self._timeline.note_tag(item, value):
                gap = item
            self.tags.append((item, key, value))
        if gap is not None:
            self._hold_from(gap)
            items = items[gap - self.items :]
            self.items = gap
        self.items += len(items)
        self._held.append(items.copy())
        self._held_count += len(items)
        if self._held_count < self._needed:
            return
        samples = self._held_samples()
        found = find_frame_offset(samples, self._waveform)
        if found is None:
            self.searches += 1
            self._searched = samples[: samples_needed(self._waveform.frame_length)].copy()
            self._hold_from(self._held_start + self._held_count)
            return
        self._begin(found)

    def put_out(self, block: Any, out: Array) -> int:
        """Copy samples that it ``holds`` to a block's output, with their tags; their number."""
        count = min(len(self._held[0]), len(out))
        out[:count] = self._held[0][:count]
        self._held[0] = self._held[0][count:]
        if not len(self._held[0]):
            self._held.clear()
        self.put_tags(block, count)
        return count

    def put_tags(self, block: Any, produced: int) -> None:
        """Add the tags of the samples that a block puts out now."""
        assert self.offset is not None
        end = self.offset + block.nitems_written(0) + produced
        while self.tags and self.tags[0][0] < end:
            item, key, value = self.tags.popleft()
            for port in range(self._antennas):
                block.add_item_tag(port, item - self.offset, key, value)

    def _held_samples(self) -> Array:
        """Those of the first antenna as complex numbers."""
        held = np.concatenate(self._held)
        return held if np.iscomplexobj(held) else samples_of(held[:, :2].copy())

    def _begin(self, found: int) -> None:
        """The stream begins so many samples into what is held: nothing was retuned before it."""
        first = self._held_start + found
        self._held = deque([np.concatenate(self._held)[found:]])
        self.start_time = time = self._time_at(first)
        self.tags = deque(
            (max(item, first), key, value)
            for item, key, value in self.tags
            if item > first or not (pmt.eq(key, _RX_TIME) or pmt.eq(key, _RETUNED))
        )
        if time is not None:
            self.tags.appendleft((first, _RX_TIME, time_value(*time)))
        self.offset = first

    def _hold_from(self, item: int) -> None:
        """Discard the samples held, and hold those from an item on."""
        self._held.clear()
        # Without frames this may go on for weeks: of the tags before, only the last ones matter.
        latest = {pmt.symbol_to_string(key): at for at, key, _ in self.tags if at <= item}
        self.tags = deque(
            tag
            for tag in self.tags
            if tag[0] > item or latest[pmt.symbol_to_string(tag[1])] == tag[0]
        )
        self._held_start, self._held_count = item, 0

    def _time_at(self, item: int) -> tuple[int, float] | None:
        """Time of an item among those held, by the last tag at or before it."""
        timeline = Timeline(self._waveform.sample_rate_hz)
        for at, key, value in self.tags:
            if pmt.eq(key, _RX_TIME) and at <= item:
                timeline.note_tag(at, value)
        return timeline.time_at(item)


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
        self._said = False

    def _explain(self) -> None:
        """Say once why no frames are found."""
        if not self._said:
            self._said = True
            self._warn(f"frame_alignment: {self.search.problem()}")

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
            # The first search of a slow radio may take longer.
            late = search.items >= PATIENCE_S * self._frames.sample_rate_hz
            if search.offset is None and search.searches and late:
                self._explain()
            self.consume(0, len(items))
            return 0
        if search.holds:
            return search.put_out(self, out)
        count = min(len(items), len(out))
        search.tags.extend(self._tags_of(count))
        out[:count] = items[:count]
        search.put_tags(self, count)
        self.consume(0, count)
        return count

    def start(self) -> bool:
        self._begin()  # a transmitter that starts again may begin anywhere in a frame
        return super().start()

    def stop(self) -> bool:
        if self.offset is None:
            self._explain()
        return super().stop()

    def _tags_of(self, count: int) -> list[Tag]:
        tags = self.get_tags_in_window(0, 0, count)
        return [(tag.offset, tag.key, tag.value) for tag in tags]
