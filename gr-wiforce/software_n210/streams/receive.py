# SPDX-License-Identifier: GPL-3.0-or-later
"""A receive stream: stream commands select which samples are received and when."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from ..wire import RX_BROKEN_CHAIN, RX_LATE, RX_OVERFLOW
from .dsp import FULL_SCALE, DspRegisters
from .rx_packets import PacketStream

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

    ``air``: ``air.receive(chain, tick, spacing, count)`` gives complex64 samples, 1.0 at full
    scale; ``stream_id``: used until the driver writes another. ``stream_start``: tick of the first
    sample since the device was opened. Commands for a single sample, which the driver uses to flush
    a stream, do not count; ``dropped_samples``: samples lost in overflows.
    """

    def __init__(self, clock, air, stream_id=3):
        self.dsp = DspRegisters(cic_power=4)
        self.stream_start = None
        self.packets = PacketStream(clock, stream_id)
        self.dropped_samples = 0
        self._clock = clock
        self._air = air
        self._command_word = 0
        self._command_time = 0
        self._make_late = False
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
                self._queue.append(StreamCommand(self._command_word, time))
        elif register == 5:
            self.packets.restart(value)
        elif register == 7:
            self.packets.samples_per_packet = max(value & 0xFFFF, 1)
        elif register == 8:
            self.stop()

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
        """Receive from tick `start` up to `end`; list of (bytes, packet size) to send."""
        while self._begin(start, end) and self._receive(end):
            pass
        return self.packets.take()

    def overflow(self, samples, restart=True):
        """Report an overflow; continue after `samples`, or go idle as the FPGA itself does."""
        if not self.active:
            return
        self.packets.flush()
        self.packets.error(RX_OVERFLOW, self._next_tick)
        if restart:
            self._next_tick += samples * self.dsp.ticks_per_sample
            self.dropped_samples += samples
        else:
            self.stop()

    def make_late(self):
        """Report the next command as late."""
        self._make_late = True

    def _begin(self, start, end):
        """Whether a command runs, after starting the next one if it is due before `end`."""
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
        self._collect(taken, end_of_burst=self._remaining == 0 and not self._command.chain)
        if self._remaining == 0:
            self._finish()
        return True

    def _follow_on(self):
        """Replace a repeating command by the one that is queued behind it."""
        if self._command.reload and self._queue:
            command = self._queue.popleft()
            if command.stop:
                # A packet must carry the end of the burst: one more sample if none is pending.
                command = StreamCommand(0 if self.packets.pending else 1, 0)
            self._take(command, self._next_tick)

    def _finish(self):
        """The running command has all its samples: start the next one or stop."""
        command, tick = self._command, self._next_tick
        self._command = None
        if not command.chain:
            return
        if self._queue:
            following = self._queue.popleft()
            if following.stop:
                self.packets.flush(end_of_burst=True)
            else:
                self._take(following, tick)
        else:
            self.packets.flush()
            self.packets.error(RX_BROKEN_CHAIN, tick)

    def _collect(self, count, end_of_burst=False):
        """Receive `count` samples and hand them to the packets."""
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
