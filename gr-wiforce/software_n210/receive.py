# SPDX-License-Identifier: GPL-3.0-or-later
"""Receive streams and their packets."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from .frontend import FULL_SCALE, DspRegisters
from .wire import (
    RX_HEADER_WORDS,
    RX_LATE,
    RX_OVERFLOW,
    RX_OVERHEAD_WORDS,
    rx_error,
    rx_header,
    rx_trailer,
)

_DEFAULT_SAMPLES_PER_PACKET = 363  # what fits the driver's frames of 1472 bytes


class PacketStream:
    """Collects samples into packets of equal size and numbers them, dropped ones as well."""

    def __init__(self, clock):
        self.samples_per_packet = _DEFAULT_SAMPLES_PER_PACKET
        self.dropped_packets = 0
        self._clock = clock
        self._stream_id = 3
        self._packet_count = 0
        self._lose = 0
        self.ready = deque()  # what is to be sent: packets of one size, and this size, in bytes
        self.discard()

    @property
    def pending(self):
        return len(self._partial)

    def discard(self):
        self._partial = np.empty((0, 2), ">i2")
        self._first_tick, self._spacing = 0, 1

    def restart(self, stream_id):
        """Number packets from 0 under another stream id."""
        self._stream_id = stream_id
        self._packet_count = 0

    def lose(self, packets):
        """Number the next packets but do not send them, like a network that drops them."""
        self._lose += packets

    def append(self, samples, tick, spacing, end_of_burst=False):
        """Send all full packets of samples (N, 2), at the end of a burst what remains as well."""
        self._first_tick, self._spacing = tick - self.pending * spacing, spacing
        samples, size = np.concatenate((self._partial, samples)), self.samples_per_packet
        # At the end, something must be left to carry the mark.
        full = max(len(samples) - end_of_burst, 0) // size * size
        self._partial = samples[full:]
        self._send(samples[:full], size, self._first_tick)
        self._first_tick += full * spacing
        if end_of_burst:
            self.flush(end_of_burst=True)

    def flush(self, end_of_burst=False):
        if self.pending:
            samples, self._partial = self._partial, self._partial[:0]
            self._send(samples, len(samples), self._first_tick, end_of_burst)

    def error(self, code, tick):
        """Send an error packet, which takes no number of its own."""
        packet = rx_error(self._packet_count, self._stream_id, self._clock.to_time(tick), code)
        self.ready.append((memoryview(packet), len(packet)))

    def _send(self, samples, size, tick, end_of_burst=False):
        """Packets of one size, built as one array."""
        packets = len(samples) // size
        numbers = np.arange(packets, dtype=np.uint64)
        times = self._clock.to_time(tick) + numbers * size * self._spacing
        block = np.empty((packets, size + RX_OVERHEAD_WORDS), ">u4")
        block[:, 0] = rx_header(self._packet_count + numbers, size)
        block[:, 1] = self._stream_id
        block[:, 2] = times >> 32
        block[:, 3] = times & 0xFFFFFFFF
        block[:, RX_HEADER_WORDS:-1].view(">i2")[:] = samples.reshape(packets, 2 * size)
        block[:, -1] = rx_trailer(end_of_burst)
        self._packet_count += packets
        lost = min(self._lose, packets)
        self._lose -= lost
        self.dropped_packets += lost
        block = block[lost:]
        if len(block):
            self.ready.append((memoryview(block.tobytes()), block.shape[1] * 4))


_NOW, _RELOAD, _STOP = 1 << 31, 1 << 29, 1 << 28
_COUNT = _STOP - 1
_MAX_QUEUE = 64


@dataclass(frozen=True)
class StreamCommand:
    """A stream command; `time` in ticks of device time."""

    count: int
    time: int = 0
    now: bool = False
    reload: bool = False
    stop: bool = False


class ReceiveChain:
    """One receive DSP with its stream of complex64 samples of ``air``, 1.0 at full scale.

    ``stream_start`` is its first tick since opening, but for single samples that flush.
    """

    def __init__(self, clock, air):
        self.dsp = DspRegisters(cic_power=4)
        self.stream_start = None
        self.packets = PacketStream(clock)
        self.dropped_samples = 0
        self._clock = clock
        self._air = air
        self._command_word = 0
        self._command_time = 0
        self.stop()

    def stop(self):
        """Go idle without a report, as when nobody listens any more."""
        self._queue = deque()
        self._command = None
        self._next_tick = None
        self._remaining = 0
        self.packets.discard()

    def poke(self, register, value):
        """Write register 0..8 of the stream's control block."""
        if register == 0:
            self._command_word = value
        elif register == 1:
            self._command_time = value << 32 | self._command_time & 0xFFFFFFFF
        elif register == 2:
            time = self._command_time & ~0xFFFFFFFF | value
            self._command_time = time
            if len(self._queue) < _MAX_QUEUE:
                word = self._command_word
                bits = (bool(word & bit) for bit in (_NOW, _RELOAD, _STOP))
                self._queue.append(StreamCommand(word & _COUNT, time, *bits))
        elif register == 5:
            self.packets.restart(value)
        elif register == 7:
            # No datagram holds as many as 16 bits count.
            self.packets.samples_per_packet = max(value & 0x1FFF, 1)
        elif register == 8:
            self.stop()

    @property
    def active(self):
        return self._command is not None

    @property
    def waiting(self):
        return self.active or bool(self._queue)

    def finish_tick(self):
        """Tick at which the running or the next command has all its samples; None without one."""
        if self._command is not None:
            if self._command.reload:
                return None
            tick, count = self._next_tick, self._remaining
        elif self._queue and not self._queue[0].now:
            tick, count = self._clock.to_ticks(self._queue[0].time), self._queue[0].count
        else:
            return None
        return tick + (max(count, 1) - 1) * self.dsp.ticks_per_sample + 1

    def run(self, start, end):
        """Receive from tick `start` up to `end`."""
        while self._begin(start, end) and self._receive(end):
            pass

    def overflow(self, samples):
        """Report an overflow, and continue after `samples`."""
        if not self.active:
            return
        self.packets.flush()
        self.packets.error(RX_OVERFLOW, self._next_tick)
        self._next_tick += samples * self.dsp.ticks_per_sample
        self.dropped_samples += samples

    def _begin(self, start, end):
        """Whether a command runs, after starting the next one if it is due before `end`."""
        while self._command is None:
            if not self._queue:
                return False
            command = self._queue[0]
            begin = start if command.now else self._clock.to_ticks(command.time)
            late = begin < start
            if begin >= end and not late:
                return False
            self._queue.popleft()
            if command.stop:
                continue
            if late:
                self.packets.error(RX_LATE, start)
                continue
            self._take(command, begin)
            if self.stream_start is None and (command.reload or command.count > 1):
                self.stream_start = begin
        return True

    def _take(self, command, tick):
        self._command = command
        self._next_tick = tick
        self._remaining = command.count

    def _receive(self, end):
        """Receive for the running command up to `end`; False when `end` is reached."""
        spacing = self.dsp.ticks_per_sample
        self._follow_on()
        count = max(0, -(-(end - self._next_tick) // spacing))
        if self._command.reload and not self._queue:
            self._collect(count)
            return False
        if count == 0 and self._remaining:
            return False
        taken = min(count, self._remaining)
        self._remaining -= taken
        self._collect(taken, end_of_burst=self._remaining == 0)
        if self._remaining == 0:
            self._command = None
        return True

    def _follow_on(self):
        """Replace a repeating command by the one that is queued behind it."""
        if self._command.reload and self._queue:
            command = self._queue.popleft()
            if command.stop:
                # A packet must carry the end of the burst: one more sample if none is pending.
                command = StreamCommand(0 if self.packets.pending else 1)
            self._take(command, self._next_tick)

    def _collect(self, count, end_of_burst=False):
        spacing = self.dsp.ticks_per_sample
        samples = np.empty(0, np.complex64)
        if count:
            samples = self._air.receive(self, self._next_tick, spacing, count)
        self.packets.append(self._to_wire(samples), self._next_tick, spacing, end_of_burst)
        self._next_tick += count * spacing

    def _to_wire(self, samples):
        values = samples.view(np.float32) * np.float32(FULL_SCALE * self.dsp.gain)
        np.rint(values, out=values)
        np.minimum(values, FULL_SCALE, out=values)
        np.maximum(values, -FULL_SCALE - 1, out=values)
        return values.astype(np.int16).astype(">i2").reshape(-1, 2)
