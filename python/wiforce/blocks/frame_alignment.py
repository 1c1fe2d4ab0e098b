# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: aligns the start of a stream of samples with the first whole frame."""

from collections import deque
from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from .. import names
from ..errors import InputError
from ..estimation.frame import find_frame_offset
from ..estimation.groups import Array
from ..io.samples import item_type_named, samples_of
from ..signal.waveform import sounding_waveform
from .stream_time import Timeline, time_value

_RX_TIME = pmt.intern(names.RX_TIME)


class frame_alignment(gr.basic_block):
    """Finds the offset of the first frame once, and drops the samples before it.

    A device delays its own transmit signal by a time that is constant during a run but unknown.
    The offset is estimated over the first frames, which are passed on as well. Tags stay with their
    samples, and the first sample that is passed on has its ``rx_time``. Samples lost later (an
    overflow) are handled by the following blocks, which receive the time in its tag.

    Input and output: samples, complex or complex 16-bit integers.

    Parameters
    ----------
    waveform : str
        ``repeated`` or ``wifi``.
    frame_length : int
        Samples per frame.
    sample_rate : float
        Samples per second.
    item_type : str
        ``fc32`` or ``sc16``.
    search_frames : int
        Frames that are averaged to find the offset.

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

    def __init__(
        self,
        waveform: str = "repeated",
        frame_length: int = 720,
        sample_rate: float = 12.5e6,
        item_type: str = "fc32",
        search_frames: int = 2000,
    ) -> None:
        item = item_type_named(item_type).item
        if search_frames < 1:
            raise InputError("search_frames", "must be 1 or more", search_frames)
        self._waveform = sounding_waveform(waveform, frame_length, sample_rate)
        self._needed = search_frames * frame_length
        self._complex = item_type == "fc32"
        gr.basic_block.__init__(self, "frame_alignment", in_sig=[item], out_sig=[item])
        self.set_tag_propagation_policy(gr.TPP_DONT)
        self.offset: int | None = None
        self.start_time: tuple[int, float] | None = None
        self.searches = 0
        self._timeline = Timeline(sample_rate)
        self._held: deque[Array] = deque()
        self._held_start = self._held_count = 0
        self._tags: deque[tuple[int, Any, Any]] = deque()
        self._first = 0  # input item that became the first output item

    def forecast(self, noutput_items: int, ninputs: int) -> list[int]:
        return [0 if self.offset is not None and self._held else 1] * ninputs

    def general_work(self, input_items: list[Array], output_items: list[Array]) -> int:
        items, out = input_items[0], output_items[0]
        if self.offset is None:
            # No more than a search needs: where frames are found must not depend on how many
            # samples happen to come at once.
            items = items[: self._needed - self._held_count]
            self._search(items)
            self.consume(0, len(items))
            return 0
        produced = self._put_out_held(out)
        count = 0 if self._held else min(len(items), len(out) - produced)
        if count:
            self._take_tags(count)
            out[produced : produced + count] = items[:count]
            produced += count
        self._put_out_tags(produced)
        self.consume(0, count)
        return produced

    def _search(self, items: Array) -> None:
        """Hold samples until there are enough for a search."""
        gap = self._take_tags(len(items))
        if gap is not None:
            self._hold_from(gap)
            items = items[gap - self.nitems_read(0) :]
        self._held.append(items.copy())
        self._held_count += len(items)
        if self._held_count < self._needed:
            return
        found = find_frame_offset(self._samples(), self._waveform)
        if found is None:
            self.searches += 1
            self._hold_from(self._held_start + self._held_count)
            return
        self._begin(found)

    def _begin(self, offset: int) -> None:
        """The stream begins `offset` samples into what is held."""
        self._first = self._held_start + offset
        self._held = deque([np.concatenate(self._held)[offset:]])
        self.start_time = time = self._time_at(self._first)
        self._tags = deque(
            (max(item, self._first), key, value)
            for item, key, value in self._tags
            if item > self._first or not pmt.eq(key, _RX_TIME)
        )
        if time is not None:
            self._tags.appendleft((self._first, _RX_TIME, time_value(*time)))
        self.offset = self._first

    def _hold_from(self, item: int) -> None:
        """Discard the samples held, and hold those from an item of the input on."""
        self._held.clear()
        # Without frames this may go on for weeks: of the tags before, only the last ones matter.
        latest = {pmt.symbol_to_string(key): at for at, key, _ in self._tags if at <= item}
        self._tags = deque(
            tag
            for tag in self._tags
            if tag[0] > item or latest[pmt.symbol_to_string(tag[1])] == tag[0]
        )
        self._held_start, self._held_count = item, 0

    def _samples(self) -> Array:
        samples = np.concatenate(self._held)
        if self._complex:
            return samples
        return samples_of(samples)

    def _take_tags(self, count: int) -> int | None:
        """Keep the tags of the next input items; return the last item after lost samples."""
        gap = None
        for tag in self.get_tags_in_window(0, 0, count):
            if pmt.eq(tag.key, _RX_TIME) and self._timeline.note(tag.offset, tag.value):
                gap = tag.offset
            self._tags.append((tag.offset, tag.key, tag.value))
        return gap

    def _time_at(self, item: int) -> tuple[int, float] | None:
        """Time of an item among those held, by the last tag at or before it."""
        timeline = Timeline(self._waveform.sample_rate_hz)
        for offset, key, value in self._tags:
            if pmt.eq(key, _RX_TIME) and offset <= item:
                timeline.note(offset, value)
        return timeline.time_at(item)

    def _put_out_held(self, out: Array) -> int:
        if not self._held:
            return 0
        count = min(len(self._held[0]), len(out))
        out[:count] = self._held[0][:count]
        self._held[0] = self._held[0][count:]
        if not len(self._held[0]):
            self._held.clear()
        return count

    def _put_out_tags(self, produced: int) -> None:
        """Add the tags of the items that are put out now."""
        written = self.nitems_written(0)
        while self._tags and self._tags[0][0] - self._first < written + produced:
            item, key, value = self._tags.popleft()
            self.add_item_tag(0, item - self._first, key, value)
