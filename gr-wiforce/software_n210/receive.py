# SPDX-License-Identifier: GPL-3.0-or-later
"""A receive stream: commands in, samples of the air out in packets."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from .dsp import FULL_SCALE, DspRegisters
from .wire import (
    RX_BROKEN_CHAIN,
    RX_HEADER_WORDS,
    RX_LATE,
    RX_OVERFLOW,
    RX_OVERHEAD_WORDS,
    rx_error,
    rx_header,
    rx_trailer,
)

_NOW, _CHAIN, _RELOAD, _STOP = 1 << 31, 1 << 30, 1 << 29, 1 << 28
_COUNT = _STOP - 1
_MAX_QUEUE = 64


@dataclass(frozen=True)
class StreamCommand:
    """A latched stream command; `time` in ticks of device time."""

    word: int
    time: int

    @property
    def now(self):
        return bool(self.word & _NOW)

    @property
    def chain(self):
        return bool(self.word & _CHAIN)

    @property
    def reload(self):
        return bool(self.word & _RELOAD)

    @property
    def stop(self):
        return bool(self.word & _STOP)

    @property
    def count(self):
        return self.word & _COUNT


class ReceiveChain:
    """One receive DSP with its stream.

    Parameters
    ----------
    clock : DeviceClock
    air : object
        ``air.receive(chain, tick, spacing, count)`` gives complex64 samples, 1.0 at full scale.
    stream_id : int
        As the driver has it until it writes another.

    Attributes
    ----------
    dsp : DspRegisters
    stream_start : int or None
        Tick of the first sample since the device was opened; single samples, by which the
        driver flushes a stream, don't count.
    dropped_samples, dropped_packets : int
        Taken away by faults.
    """

    def __init__(self, clock, air, stream_id=3):
        self.dsp = DspRegisters(cic_power=4)
        self.stream_start = None
        self.dropped_samples = 0
        self.dropped_packets = 0
        self._clock = clock
        self._air = air
        self._stream_id = stream_id
        self._samples_per_packet = 363
        self._command_word = 0
        self._command_time = 0
        self._packet_count = 0
        self._make_late = False
        self._lose = 0
        self._swap = False
        self._out = []
        self._reset()

    def _reset(self):
        self._queue = deque()
        self._command = None
        self._next_tick = None
        self._remaining = 0
        self._partial = np.empty((0, 2), ">i2")

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
                self._queue.append(StreamCommand(self._command_word, time))
        elif register == 5:
            self._stream_id = value
            self._packet_count = 0
        elif register == 7:
            self._samples_per_packet = max(value & 0xFFFF, 1)
        elif register == 8:
            self._reset()

    @property
    def active(self):
        """Whether a command runs now."""
        return self._command is not None

    @property
    def waiting(self):
        """Whether a command runs or is queued."""
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
        """Receive from tick `start` up to `end`; list of (bytes, segment size) to be sent."""
        while self._begin(start, end) and self._receive(end):
            pass
        out, self._out = self._out, []
        return out

    def stop(self):
        """Go idle without a word, as when nobody listens any more."""
        self._reset()

    def overflow(self, samples, restart=True):
        """Report an overflow; go on after `samples`, or go idle as the FPGA itself does."""
        if not self.active:
            return
        self._flush(end_of_burst=False)
        self._error(RX_OVERFLOW, self._next_tick)
        if restart:
            self._next_tick += samples * self.dsp.ticks_per_sample
            self.dropped_samples += samples
        else:
            self._reset()

    def lose_packets(self, count):
        """Send nothing for the next `count` packets, but count them."""
        self._lose += count

    def swap_packets(self):
        """Send the next two packets in the wrong order."""
        self._swap = True

    def make_late(self):
        """Report the next command as late."""
        self._make_late = True

    def _begin(self, start, end):
        """Whether a command runs, after taking on the next one when it is due before `end`."""
        while self._command is None:
            if not self._queue:
                return False
            command = self._queue[0]
            begin = start if command.now else self._clock.to_ticks(command.time)
            late = self._make_late or begin < start
            if begin >= end and not late:
                return False
            self._queue.popleft()
            if command.stop:
                continue
            if late:
                self._make_late = False
                self._error(RX_LATE, start)
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
        """Receive what the running command wants up to `end`; False when `end` is reached."""
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
        self._collect(taken, last=self._remaining == 0 and not self._command.chain)
        if self._remaining == 0:
            self._finish()
        return True

    def _follow_on(self):
        """A command queued behind a repeating one takes its place."""
        if self._command.reload and self._queue:
            command = self._queue.popleft()
            if command.stop:
                # Some packet must carry the end of the burst: one more sample when none is left.
                command = StreamCommand(0 if len(self._partial) else 1, 0)
            self._take(command, self._next_tick)

    def _finish(self):
        """The running command has had its samples: go to the next one or stop."""
        command, tick = self._command, self._next_tick
        self._command = None
        if not command.chain:
            return
        if self._queue:
            following = self._queue.popleft()
            if following.stop:
                self._flush(end_of_burst=True)
            else:
                self._take(following, tick)
        else:
            self._flush(end_of_burst=False)
            self._error(RX_BROKEN_CHAIN, tick)

    def _collect(self, count, last=False):
        """Take `count` samples off the air; send what fills packets, and the rest if `last`."""
        spacing = self.dsp.ticks_per_sample
        if count:
            samples = self._air.receive(self, self._next_tick, spacing, count)
            wire = self._to_wire(samples)
            if len(self._partial):
                wire = np.concatenate((self._partial, wire))
            self._next_tick += count * spacing
        else:
            wire = self._partial
        size = self._samples_per_packet
        full = len(wire) // size
        if last and full and full * size == len(wire):
            full -= 1
        first_tick = self._next_tick - len(wire) * spacing
        if full:
            self._send(wire[: full * size], size, first_tick)
        self._partial = wire[full * size :]
        if last:
            self._flush(end_of_burst=True)

    def _to_wire(self, samples):
        values = samples.view(np.float32) * np.float32(FULL_SCALE * self.dsp.gain)
        np.rint(values, out=values)
        np.minimum(values, FULL_SCALE, out=values)
        np.maximum(values, -FULL_SCALE - 1, out=values)
        return values.astype(np.int16).astype(">i2").reshape(-1, 2)

    def _send(self, wire, size, first_tick, end_of_burst=False):
        """Send packets of one size."""
        packets = len(wire) // size
        numbers = np.arange(packets)
        times = self._clock.to_time(first_tick) + numbers * size * self.dsp.ticks_per_sample
        block = np.empty((packets, size + RX_OVERHEAD_WORDS), ">u4")
        block[:, 0] = rx_header(0, size) | ((self._packet_count + numbers) & 15) << 16
        block[:, 1] = self._stream_id
        block[:, 2] = times >> 32
        block[:, 3] = times & 0xFFFFFFFF
        block[:, RX_HEADER_WORDS:-1].view(">i2")[:] = wire.reshape(packets, 2 * size)
        block[:, -1] = rx_trailer(end_of_burst)
        self._packet_count += packets
        self._emit(block)

    def _flush(self, end_of_burst):
        """Send what is left over as one short packet."""
        wire, self._partial = self._partial, self._partial[:0]
        if len(wire):
            first_tick = self._next_tick - len(wire) * self.dsp.ticks_per_sample
            self._send(wire, len(wire), first_tick, end_of_burst)

    def _emit(self, block):
        """Hand packets of one size on, less what the faults take."""
        lost = min(self._lose, len(block))
        self._lose -= lost
        self.dropped_packets += lost
        block = block[lost:]
        if self._swap and len(block) > 1:
            block[[0, 1]] = block[[1, 0]]
            self._swap = False
        if len(block):
            self._out.append((block.tobytes(), block.shape[1] * 4))

    def _error(self, code, tick):
        packet = rx_error(self._packet_count, self._stream_id, self._clock.to_time(tick), code)
        self._out.append((packet, len(packet)))
