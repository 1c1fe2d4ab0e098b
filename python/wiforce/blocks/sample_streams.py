# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples between processes, with times that go on after a device was lost."""

from __future__ import annotations

import math
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pmt
from gnuradio import gr

from ..estimation.groups import Array
from ..wiforce_python import packet_reader, rx_time_value
from . import names
from .argument_types import Kept, typed
from .frame_alignment import FrameSearch, Tag
from .stream_watch import Timeline, time_value

# Tags that a device attaches to samples, by the number that stands for them in a packet.
TAG_KEYS = ("rx_time", "rx_rate", "rx_freq")

_HEAD = struct.Struct("<II")  # samples, tags
_TAG = struct.Struct("<BIQd")  # number of the key, sample, whole seconds, value or fraction
SAMPLE_BYTES = 4
TAG_BYTES = _TAG.size


class SampleTag(NamedTuple):
    """A tag of a packet's sample: fraction of a time in s, samples per second, or Hz."""

    key: str
    sample: int
    seconds: int
    value: float


def pack_head(samples: int, tags: Iterable[SampleTag] = ()) -> bytes:
    """What precedes the samples of a packet, 4 bytes each: counts and tags."""
    packed = [
        _TAG.pack(TAG_KEYS.index(tag.key), tag.sample, tag.seconds, tag.value) for tag in tags
    ]
    return _HEAD.pack(samples, len(packed)) + b"".join(packed)


def unpack_tags(data: bytes) -> list[SampleTag]:
    """Tags of a packet, ``TAG_BYTES`` each, which follow the counts."""
    return [SampleTag(TAG_KEYS[key], *fields) for key, *fields in _TAG.iter_unpack(data)]


# Blocks take a jump of more than an hour for a wrong time (lib/kernel/timing/timeline.h); a longer
# break is reported in several steps.
_LONGEST_STEP_S = 3000.0

Time = tuple[int, float]


# Seconds since the machine was started, those in standby included.
_boot_time_s = partial(time.clock_gettime, time.CLOCK_BOOTTIME)


class ResumedTime:
    """Continues the time of a stream when a device is lost and found; ``now`` is host time in s.

    Between streams the host's clock counts, as a device may restart. One resumes whole frames after
    the first began: both directions start together and the delay is constant.
    """

    def __init__(
        self, sample_rate: float, frame_length: int, now: Callable[[], float] = _boot_time_s
    ) -> None:
        self._rate, self._frame, self._now = sample_rate, frame_length, now
        self._timeline = Timeline(sample_rate)
        self._items = 0  # received in all streams
        self._last_s = 0.0  # host time of the last of them
        self._origin: Time | None = None
        self._offset: Time = (0, 0.0)  # from the present stream's clock to the first one's
        # Number of streams that have begun, and what is added to the clock of the last, in s.
        self.stream_clock = 0, 0.0

    @property
    def started(self) -> bool:
        """Whether a stream has begun."""
        return self._origin is not None

    def begin(self, device_time: Time | None, frame_offset: int = 0) -> list[Time]:
        """Begin a stream, at ``frame_offset`` in a frame; the times of its first samples.

        More than one after a long break. Without a device time, its samples are its clock.
        """
        device_time = device_time or (0, 0.0)
        streams = self.stream_clock[0] + 1
        if self._origin is None:
            self.stream_clock = streams, 0.0
            self._origin = device_time
            self._timeline.note(0, *self._origin)
            return [self._origin]
        position = self._items + self._timeline.lost
        gone = position + max(self._now() - self._last_s, 0.0) * self._rate
        resumed = math.ceil((gone - frame_offset) / self._frame) * self._frame + frame_offset
        steps = math.ceil((resumed - position) / (_LONGEST_STEP_S * self._rate)) or 1
        times = []
        for step in range(1, steps + 1):
            reached = position + (resumed - position) * step // steps
            # The samples of the steps before have times as well.
            item = step - 1
            value = self._after_origin(resumed + item if step == steps else reached)
            self._timeline.note(self._items + item, *value)
            times.append(value)
        first = _added(times[-1], (0, -(steps - 1) / self._rate))
        self._offset = _added(first, (-device_time[0], -device_time[1]))
        self.stream_clock = streams, sum(self._offset)
        return times

    def of(self, item: int, device_time: Time) -> Time:
        """Time of a sample, by its index in all streams, from that of the present one's clock."""
        seconds, fraction = _added(device_time, self._offset)
        value = max(seconds, 0), fraction  # a device may report a time that cannot be
        self._timeline.note(item, *value)
        return value

    def received(self, count: int) -> None:
        """Samples have been received."""
        self._items += count
        self._last_s = self._now()

    def _after_origin(self, samples: int) -> Time:
        whole, rest = divmod(samples, self._rate)
        return _added(self._origin or (0, 0.0), (int(whole), rest / self._rate))


def _added(time: Time, other: Time) -> Time:
    fraction = time[1] + other[1]
    carried = math.floor(fraction)
    return time[0] + other[0] + carried, fraction - carried


_WAIT_S = 0.1
_DONE = -1


def wait_briefly(stream: socket.socket, option: int) -> None:
    """Let the kernel end a call of a socket, by its SO_RCVTIMEO or SO_SNDTIMEO, after 0.1 s."""
    # Its timeval has two fields of 64 bits, or of 32 in older 32-bit systems.
    held = stream.getsockopt(socket.SOL_SOCKET, option, 16)
    form = "=qq" if len(held) == 16 else "=ii"
    stream.setsockopt(socket.SOL_SOCKET, option, struct.pack(form, 0, round(1e6 * _WAIT_S)))


class sample_receiver(Kept, gr.sync_block):
    """Reads complex 16-bit samples and their device tags from stream sockets.

    Between a stream's end and the next one is a gap, tagged with the host's ``rx_time`` and
    ``retuned``. The output begins with the first frame that ``search`` finds, an output per
    antenna. ``received`` counts samples, ``peak`` is the largest I or Q since it was last set to
    0; ``called_s`` is when the scheduler last asked: not while later blocks are busy.
    """

    @typed
    def __init__(
        self, sample_rate: float, frame_length: int, search: FrameSearch, antennas: int = 1
    ) -> None:
        signature = [(np.int16, 2)] * antennas
        gr.sync_block.__init__(self, "sample_receiver", in_sig=None, out_sig=signature)
        self._antennas = antennas
        self.times = ResumedTime(sample_rate, frame_length)
        self._waiting: deque[tuple[socket.socket, bool]] = deque()
        self._stream: socket.socket | None = None
        self._search = search
        self._packets: packet_reader | None = None
        self._packet_start = 0  # the first sample of the latest one with tags
        self._tags: deque[SampleTag] = deque()
        self.received = self.peak = 0
        self._begins = self._finished = self._aligned = False
        self.called_s = self._heard_s = time.monotonic()

    @property
    def idle_s(self) -> float:
        return time.monotonic() - self._heard_s

    def attach(self, stream: socket.socket, aligned: bool = False) -> None:
        """Read another stream behind those before, ``aligned`` to a frame or as the first."""
        self._waiting.append((stream, aligned))

    def finish(self) -> None:
        """End the stream once all streams have ended."""
        self._finished = True

    def work(self, _: list[Array], output_items: list[Array]) -> int:
        self.called_s = time.monotonic()
        finished = self._finished  # before streams are looked for, which may still be attached
        if not self._search.holds and self._stream is None and not self._take_next_stream():
            return _DONE if finished else 0
        items = output_items[0]
        if self._antennas > 1:
            items = np.empty((len(items), 2 * self._antennas), np.int16)
        count = self._count_of(self._put_out, items)
        if self._antennas > 1:
            for antenna, out in enumerate(output_items):
                out[:count] = items[:count, 2 * antenna : 2 * antenna + 2]
        return count

    # Arrays for each call, of a thousand per second, would take longer than what is done with them.

    def handle_general_work(self, most: int, *arguments: Any) -> int:
        search = self._search
        searches = search.offset is None or search.holds
        if self._antennas > 1 or self._stream is None or searches:
            return super().handle_general_work(most, *arguments)
        self.called_s = time.monotonic()
        return self._count_of(self._pass_on, most)

    def _count_of(self, put_out: Callable[[Any], int], out: Any) -> int:
        """What a call puts out: 0 when nothing comes for a while, or a stream has ended."""
        try:
            return put_out(out)
        except TimeoutError:
            return 0
        except EOFError:
            self._drop_stream()
            return 0

    def _put_out(self, out: Array) -> int:
        """Put out a part of a packet, or of what the search held; the number of samples."""
        search = self._search
        # The scheduler pauses a source that puts out nothing, which would lose samples.
        while search.offset is None and not self._finished:
            self._search_on(len(out))
        if search.offset is None:
            self._search_on(len(out))
            return 0
        if search.holds:
            return search.put_out(self, out)
        assert self._packets is not None
        return self._tagged(*self._take(self._packets.read(out)))

    def _pass_on(self, most: int) -> int:
        """The same into the output's buffer, once the frames are found."""
        assert self._packets is not None
        return self._tagged(*self._take(self._packets.read_to(self.gateway, most)))

    def _tagged(self, count: int, tags: list[Tag]) -> int:
        first = self._search.offset or 0
        for item, key, value in tags:
            for port in range(self._antennas):
                self.add_item_tag(port, item - first, key, value)
        return count

    def _search_on(self, most: int) -> None:
        items = np.empty((min(self._search.wanted, most), 2 * self._antennas), np.int16)
        assert self._packets is not None
        count, tags = self._take(self._packets.read(items))
        self._search.take(items[:count], tags)

    def stop(self) -> bool:
        self._drop_stream()
        while self._waiting:
            self._waiting.popleft()[0].close()
        return super().stop()

    def _take_next_stream(self) -> bool:
        if not self._waiting:
            if not self._finished:
                time.sleep(_WAIT_S / 5)
            return False
        self._stream, self._aligned = self._waiting.popleft()
        self._stream.settimeout(None)  # one of Python's would make the socket not wait at all
        wait_briefly(self._stream, socket.SO_RCVTIMEO)
        self._packets = packet_reader(
            self._stream.fileno(), SAMPLE_BYTES * self._antennas, TAG_BYTES
        )
        self._begins = True
        return True

    def _drop_stream(self) -> None:
        """Forget a stream that has ended, with the rest of a packet that it leaves."""
        if self._stream is not None:
            self._stream.close()
        self._stream = self._packets = None
        self._tags.clear()

    def _take(self, part: tuple[int, bytes, int, bool]) -> tuple[int, list[Tag]]:
        """Take a part of a packet, samples and tags; TimeoutError or, at the end, EOFError."""
        count, tags, peak, ended = part
        self.called_s = time.monotonic()
        if tags:
            self._packet_start = self.received
            self._tags.extend(unpack_tags(tags))
        if not count:
            raise EOFError if ended else TimeoutError
        self._heard_s = self.called_s
        self.peak = max(self.peak, peak)
        tags_of = self._take_tags(count) if self._tags or self._begins else []
        self.received += count
        self.times.received(count)
        return count, tags_of

    def _take_tags(self, count: int) -> list[Tag]:
        """Tags of the samples that were read now."""
        first, due, tags = self.received, [], []
        while self._tags and self._packet_start + self._tags[0].sample < first + count:
            due.append(self._tags.popleft())
        if self._begins:
            self._begins = False
            tags += self._beginning(first, due)
        for tag in due:
            item = self._packet_start + tag.sample
            if tag.key == names.RX_TIME:
                value = time_value(*self.times.of(item, (tag.seconds, tag.value)))
            else:
                value = pmt.from_double(tag.value)
            tags.append((item, pmt.intern(tag.key), value))
        return tags

    def _beginning(self, first: int, due: list[SampleTag]) -> list[Tag]:
        """Tags of a stream that begins with a sample; its own time is removed from ``due``."""
        resumes = self.times.started
        mine = [tag for tag in due if tag.key == names.RX_TIME and tag.sample == 0]
        begins = (mine[0].seconds, mine[0].value) if mine else None
        offset = self._search.offset if self._aligned else 0
        times = self.times.begin(begins, offset or 0)
        for tag in mine:
            due.remove(tag)
        key = pmt.intern(names.RX_TIME)
        tags = [(item, key, time_value(*value)) for item, value in enumerate(times, first)]
        if resumes:
            tags.append((first, pmt.intern(names.RETUNED), pmt.from_uint64(1)))
        return tags


# As far as the system allows: with a larger buffer, the processes wait for each other less often.
_BUFFER_BYTES = 1 << 20


class sample_sender(Kept, gr.sync_block):
    """Writes complex 16-bit samples and device tags to the socket of a ``sample_receiver``.

    What arrives within ``interval_s`` is sent together, which saves time. ``accepts_time`` says
    whether a time, in seconds, is sent as rx_time; ``waiting`` that the other process is slower,
    ``ended`` that the stream has ended.
    """

    @typed
    def __init__(
        self,
        stream: socket.socket,
        interval_s: float = 0.0,
        accepts_time: Callable[[float], bool] = lambda seconds: True,
        antennas: int = 1,
    ) -> None:
        signature = [(np.int16, 2)] * antennas
        gr.sync_block.__init__(self, "sample_sender", in_sig=signature, out_sig=None)
        # With a timeout of Python's, a call would send whatever part finds room at once.
        stream.settimeout(None)
        wait_briefly(stream, socket.SO_SNDTIMEO)
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
        self._stream, self._accepts_time = stream, accepts_time
        self._interval_s, self._next_s = interval_s, 0.0
        self.waiting = self.ended = False
        self.sent = 0

    def work(self, input_items: list[Array], _: list[Array]) -> int:
        count = len(input_items[0])
        samples = input_items[0] if len(input_items) == 1 else np.concatenate(input_items, axis=1)
        self._send(memoryview(pack_head(count, self._tags(count))), samples.data.cast("B"))
        if self.ended:
            return _DONE
        time.sleep(max(self._next_s - time.monotonic(), 0.0))
        self._next_s = time.monotonic() + self._interval_s
        self.sent += count
        return count

    def _send(self, *parts: memoryview) -> None:
        """Send parts as one message, so that the other process is woken once, unless it ends."""
        rest = list(parts)
        while rest and not self.ended:
            try:
                count = self._stream.sendmsg(rest, (), socket.MSG_NOSIGNAL)
            except BlockingIOError:
                self.waiting = True
                continue
            except OSError:  # the other process has gone
                self.ended = True
                return
            self.waiting = False
            while rest and count >= len(rest[0]):
                count -= len(rest.pop(0))
            if rest:
                rest[0] = rest[0][count:]

    def stop(self) -> bool:
        self.ended = True
        return super().stop()

    def _tags(self, count: int) -> Iterator[SampleTag]:
        first = self.nitems_read(0)
        for tag in self.get_tags_in_window(0, 0, count):
            key = pmt.symbol_to_string(tag.key)
            if key not in TAG_KEYS or (value := _plain(tag.value)) is None:
                continue
            if key != names.RX_TIME or self._accepts_time(sum(value)):
                yield SampleTag(key, tag.offset - first, *value)


def _plain(value: Any) -> tuple[int, float] | None:
    """Whole seconds and fraction of an ``rx_time``, or 0 and a number; None for anything else."""
    if pmt.is_real(value) or pmt.is_integer(value):
        return 0, pmt.to_double(value)
    return rx_time_value(value)
