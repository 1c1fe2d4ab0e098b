# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: samples that other processes send one after the other, as one continuous stream."""

import socket
import time
from collections import deque

import numpy as np
import pmt
from gnuradio import gr

from .. import names
from ..estimation.groups import Array
from ..io.sample_packets import (
    HEAD_BYTES,
    SAMPLE_BYTES,
    TAG_BYTES,
    SampleTag,
    unpack_counts,
    unpack_tags,
)
from .resumed_time import ResumedTime
from .stream_time import time_value

_WAIT_S = 0.1
_DONE = -1


class sample_receiver(gr.sync_block):
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

    Attributes
    ----------
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

    def __init__(self, sample_rate: float, frame_length: int) -> None:
        gr.sync_block.__init__(self, "sample_receiver", in_sig=None, out_sig=[(np.int16, 2)])
        self._times = ResumedTime(sample_rate, frame_length)
        self._waiting: deque[socket.socket] = deque()
        self._stream: socket.socket | None = None
        self._left = 0  # samples of the packet at hand
        self._packet_start = 0  # output item of its first sample
        self._tags: deque[SampleTag] = deque()
        self._begins = self._finished = False
        self.called_s = self._heard_s = time.monotonic()

    @property
    def idle_s(self) -> float:
        return time.monotonic() - self._heard_s

    @property
    def stream_clock(self) -> tuple[int, float]:
        """Number of streams that have begun, and the time added to the clock of the last, in s."""
        return self._times.stream_clock

    def attach(self, stream: socket.socket) -> None:
        """Read another stream once those before it have ended."""
        self._waiting.append(stream)

    def finish(self) -> None:
        """End the stream once all streams have ended."""
        self._finished = True

    def work(self, _: list[Array], output_items: list[Array]) -> int:
        self.called_s = time.monotonic()
        finished = self._finished  # before streams are looked for, which may still be attached
        if self._stream is None and not self._take_next_stream():
            return _DONE if finished else 0
        try:
            count = self._read(output_items[0])
        except TimeoutError:
            return 0
        except (EOFError, OSError):
            self._drop_stream()
            return 0
        self._heard_s = time.monotonic()
        return count

    def stop(self) -> bool:
        self._drop_stream()
        while self._waiting:
            self._waiting.popleft().close()
        return True

    def _take_next_stream(self) -> bool:
        if not self._waiting:
            if not self._finished:
                time.sleep(_WAIT_S / 5)
            return False
        self._stream = self._waiting.popleft()
        self._stream.settimeout(_WAIT_S)
        self._begins = True
        return True

    def _drop_stream(self) -> None:
        """Forget a stream that has ended, with the rest of a packet that it leaves."""
        if self._stream is not None:
            self._stream.close()
        self._stream = None
        self._left = 0
        self._tags.clear()

    def _read(self, out: Array) -> int:
        """Read a part of a packet; the number of samples."""
        if self._left == 0:
            self._left, tags = unpack_counts(self._bytes(HEAD_BYTES))
            self._packet_start = self.nitems_written(0)
            self._tags.extend(unpack_tags(self._bytes(tags * TAG_BYTES)))
        count = min(len(out), self._left)
        data = out[:count].view(np.uint8).data.cast("B")
        received = self._fill(data)
        count = received // SAMPLE_BYTES
        self._left -= count
        if count:
            self._put_tags(count)
            self._times.received(count)
        return count

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
                count = self._stream.recv_into(data[received:])
            except TimeoutError:
                if received == 0 and self._left == 0:
                    raise
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

    def _put_tags(self, count: int) -> None:
        """Tag the items that are put out now."""
        first = self.nitems_written(0)
        due = []
        while self._tags and self._packet_start + self._tags[0].sample < first + count:
            due.append(self._tags.popleft())
        if self._begins:
            self._begins = False
            self._put_beginning(first, due)
        for tag in due:
            item = self._packet_start + tag.sample
            if tag.key == names.RX_TIME:
                value = time_value(*self._times.of(item, (tag.seconds, tag.value)))
            else:
                value = pmt.from_double(tag.value)
            self.add_item_tag(0, item, pmt.intern(tag.key), value)

    def _put_beginning(self, first: int, due: list[SampleTag]) -> None:
        resumes = self._times.started
        mine = [tag for tag in due if tag.key == names.RX_TIME and tag.sample == 0]
        times = self._times.begin((mine[0].seconds, mine[0].value) if mine else None)
        for tag in mine:
            due.remove(tag)
        for item, value in enumerate(times, first):
            self.add_item_tag(0, item, pmt.intern(names.RX_TIME), time_value(*value))
        if resumes:
            self.add_item_tag(0, first, pmt.intern(names.RETUNED), pmt.from_uint64(1))
