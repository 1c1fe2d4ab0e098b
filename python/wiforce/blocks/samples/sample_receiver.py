# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: samples that other processes send one after the other, as one continuous stream."""

import socket
import struct
import time
from collections import deque

import numpy as np
import pmt
from gnuradio import gr

from ...estimation.groups import Array
from ...io.network.sample_packets import (
    HEAD_BYTES,
    SAMPLE_BYTES,
    TAG_BYTES,
    SampleTag,
    unpack_counts,
    unpack_tags,
)
from .. import names
from ..argument_types import typed
from ..kept import Kept
from ..stream_time import time_value
from .frame_search import FrameSearch, Tag
from .resumed_time import ResumedTime

_WAIT_S = 0.1
_WAIT = struct.pack("@ll", 0, round(1e6 * _WAIT_S))  # a timeval
_DONE = -1


class sample_receiver(Kept, gr.sync_block):
    """Reads complex 16-bit samples and their device tags from stream sockets.

    When a stream ends, the block waits for the next one. What passes between the two is a gap:
    the next stream's first sample is tagged with the ``rx_time`` at which it follows the samples
    before, by the host's clock, and ``retuned``, because the device's oscillators have new phases.

    Parameters
    ----------
    sample_rate : float
        Samples per second.
    frame_length : int
        Samples per sounding frame; a gap keeps the frame timing.
    search : FrameSearch, optional
        The output begins with the first frame that it finds; with the first sample without it.
    antennas : int
        Number of outputs: antennas whose samples come side by side.

    Attributes
    ----------
    received : int
        Samples received in all streams.
    peak : int
        Largest magnitude of I or Q that was put out since it was last set to 0.
    idle_s : float
        Seconds since the last sample was received.
    called_s : float
        When the scheduler last asked for samples (``time.monotonic``). It stops to ask while the
        blocks after this one are busy.

    Examples
    --------
    >>> ours, theirs = socket.socketpair()
    >>> receiver = sample_receiver(12.5e6, 720)
    >>> receiver.attach(ours)  # theirs is given to a sample_sender
    """

    @typed
    def __init__(
        self,
        sample_rate: float,
        frame_length: int,
        search: FrameSearch | None = None,
        antennas: int = 1,
    ) -> None:
        signature = [(np.int16, 2)] * antennas
        gr.sync_block.__init__(self, "sample_receiver", in_sig=None, out_sig=signature)
        self._antennas = antennas
        self._times = ResumedTime(sample_rate, frame_length)
        self._waiting: deque[tuple[socket.socket, bool]] = deque()
        self._stream: socket.socket | None = None
        self._search = search
        self._remaining = 0  # samples of the packet that are not received yet
        self._packet_start = 0  # its first sample, of those received
        self._tags: deque[SampleTag] = deque()
        self.received = self.peak = 0
        self._begins = self._finished = self._aligned = False
        self.called_s = self._heard_s = time.monotonic()

    @property
    def idle_s(self) -> float:
        return time.monotonic() - self._heard_s

    @property
    def stream_clock(self) -> tuple[int, float]:
        """Number of streams that have begun, and the time added to the clock of the last, in s."""
        return self._times.stream_clock

    def attach(self, stream: socket.socket, aligned: bool = False) -> None:
        """Read another stream once those before it have ended.

        Parameters
        ----------
        stream : socket.socket
        aligned : bool
            It begins with a frame; otherwise where the first stream began in a frame.
        """
        self._waiting.append((stream, aligned))

    def finish(self) -> None:
        """End the stream once all streams have ended."""
        self._finished = True

    def work(self, _: list[Array], output_items: list[Array]) -> int:
        self.called_s = time.monotonic()
        finished = self._finished  # before streams are looked for, which may still be attached
        if not self._holds and self._stream is None and not self._take_next_stream():
            return _DONE if finished else 0
        items = output_items[0]
        if self._antennas > 1:
            items = np.empty((len(items), 2 * self._antennas), np.int16)
        try:
            count = self._put_out(items)
        except TimeoutError:
            return 0
        except (EOFError, OSError):
            self._drop_stream()
            return 0
        if self._antennas > 1:
            for antenna, out in enumerate(output_items):
                out[:count] = items[:count, 2 * antenna : 2 * antenna + 2]
        return count

    @property
    def _holds(self) -> bool:
        return self._search is not None and self._search.holds

    def _put_out(self, out: Array) -> int:
        """Put out a part of a packet, or of what the search held; the number of samples."""
        search, first = self._search, 0
        if search is not None:
            # The scheduler pauses a source that puts out nothing, which would lose samples.
            while search.offset is None and not self._finished:
                self._search_on(search, len(out))
            if search.offset is None:
                self._search_on(search, len(out))
                return 0
            if search.holds:
                return search.put_out(self, out)
            first = search.offset
        count, tags = self._read(out)
        for item, key, value in tags:
            for port in range(self._antennas):
                self.add_item_tag(port, item - first, key, value)
        if count:
            items = out[:count]
            self.peak = max(self.peak, int(items.max()), -int(items.min()))
        return count

    def _search_on(self, search: FrameSearch, most: int) -> None:
        items = np.empty((min(search.wanted, most), 2 * self._antennas), np.int16)
        count, tags = self._read(items)
        search.take(items[:count], tags)

    def stop(self) -> bool:
        self._drop_stream()
        while self._waiting:
            self._waiting.popleft()[0].close()
        return True

    def _take_next_stream(self) -> bool:
        if not self._waiting:
            if not self._finished:
                time.sleep(_WAIT_S / 5)
            return False
        self._stream, self._aligned = self._waiting.popleft()
        # With a timeout of Python's, a call would return whatever part of a packet is there.
        self._stream.settimeout(None)
        self._stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, _WAIT)
        self._begins = True
        return True

    def _drop_stream(self) -> None:
        """Forget a stream that has ended, with the rest of a packet that it leaves."""
        if self._stream is not None:
            self._stream.close()
        self._stream = None
        self._remaining = 0
        self._tags.clear()

    def _read(self, out: Array) -> tuple[int, list[Tag]]:
        """Read a part of a packet; the number of samples, and their tags."""
        if self._remaining == 0:
            self._remaining, tags = unpack_counts(self._bytes(HEAD_BYTES))
            self._packet_start = self.received
            self._tags.extend(unpack_tags(self._bytes(tags * TAG_BYTES)))
        count = min(len(out), self._remaining)
        data = out[:count].view(np.uint8).data.cast("B")
        count = self._fill(data) // (SAMPLE_BYTES * self._antennas)
        self._remaining -= count
        tags_of = self._take_tags(count)
        self.received += count
        self.called_s = self._heard_s = time.monotonic()
        if count:
            self._times.received(count)
        return count, tags_of

    def _bytes(self, count: int) -> bytes:
        data = bytearray(count)
        if self._fill(memoryview(data)) < count:
            raise EOFError
        return bytes(data)

    def _fill(self, data: memoryview) -> int:
        """Read until all is there or the stream ends; the number of bytes.

        Raises
        ------
        TimeoutError
            When nothing of it comes in time.
        EOFError
            When the stream has ended.
        """
        assert self._stream is not None
        received = 0
        while received < len(data):
            try:
                count = self._stream.recv_into(data[received:], 0, socket.MSG_WAITALL)
            except BlockingIOError:
                if received == 0 and self._remaining == 0:
                    raise TimeoutError from None
                self.called_s = time.monotonic()  # it waits for samples all the same
                continue
            except OSError:
                break
            if count == 0:
                break
            received += count
        if received == 0 and len(data):
            raise EOFError
        return received

    def _take_tags(self, count: int) -> list[Tag]:
        """Tags of the samples that were read now."""
        if not count:
            return []
        first, due, tags = self.received, [], []
        while self._tags and self._packet_start + self._tags[0].sample < first + count:
            due.append(self._tags.popleft())
        if self._begins:
            self._begins = False
            tags += self._beginning(first, due)
        for tag in due:
            item = self._packet_start + tag.sample
            if tag.key == names.RX_TIME:
                value = time_value(*self._times.of(item, (tag.seconds, tag.value)))
            else:
                value = pmt.from_double(tag.value)
            tags.append((item, pmt.intern(tag.key), value))
        return tags

    def _beginning(self, first: int, due: list[SampleTag]) -> list[Tag]:
        """Tags of a stream that begins with a sample; its own time is removed from ``due``."""
        resumes = self._times.started
        mine = [tag for tag in due if tag.key == names.RX_TIME and tag.sample == 0]
        begins = (mine[0].seconds, mine[0].value) if mine else None
        offset = self._search.offset if self._aligned and self._search is not None else None
        times = self._times.begin(begins, offset or 0)
        for tag in mine:
            due.remove(tag)
        key = pmt.intern(names.RX_TIME)
        tags = [(item, key, time_value(*value)) for item, value in enumerate(times, first)]
        if resumes:
            tags.append((first, pmt.intern(names.RETUNED), pmt.from_uint64(1)))
        return tags
