# SPDX-License-Identifier: GPL-3.0-or-later
"""The transmit stream: packets in, bursts on the air, flow control and events back."""

import struct
from collections import deque
from dataclasses import dataclass

import numpy as np

from .dsp import FULL_SCALE, DspRegisters
from .wire import (
    END_OF_BURST,
    HAS_TIME,
    HAS_TRAILER,
    TX_BURST_ACK,
    TX_FLOW,
    TX_LATE,
    TX_SEQUENCE_ERROR,
    TX_UNDERFLOW,
    Malformed,
    tx_report,
    words,
)

_TYPE_MASK = 0xF0000000
_POLICY_NEXT_BURST = 4
_UPDATE_ENABLED = 1 << 31
_MAX_QUEUE = 4096
# The driver takes the device for a FIFO of 1 MiB, and asks for eight reports per filling.
_FIFO_BYTES = 1 << 20
_REPORTS_PER_FIFO = 8
_ONE = struct.Struct(">Q")


@dataclass
class Packet:
    """A data packet: samples as wire bytes; `time` in ticks of device time, None when untimed."""

    sequence: int
    time: int | None
    end: bool
    payload: memoryview

    @property
    def samples(self):
        return len(self.payload) // 4


def parse(datagram):
    """The packet of one datagram.

    Raises
    ------
    Malformed
        When it is no data packet, or its length belies its header.
    """
    sequence, header = words(datagram, 2)
    if header & _TYPE_MASK:
        raise Malformed(f"data header 0x{header:08x}")
    length = 4 + 4 * (header & 0xFFFF)
    first = 16 if header & HAS_TIME else 8
    last = length - 4 if header & HAS_TRAILER else length
    # Ethernet pads short frames, so there may be more bytes than words, never fewer.
    if len(datagram) < length or last <= first:
        raise Malformed(f"data packet of {len(datagram)} bytes says {length}")
    time = _ONE.unpack_from(datagram, 8)[0] if header & HAS_TIME else None
    payload = memoryview(datagram)[first:last]
    return Packet(sequence, time, bool(header & END_OF_BURST), payload)


class TransmitChain:
    """The transmit DSP with its stream.

    Parameters
    ----------
    clock : DeviceClock
    air : object
        ``air.transmit(tick, spacing, samples)`` takes complex64 samples, 1.0 at full scale.
    socket_bytes : int or None
        What may wait in the socket that packets come by; None for any amount.

    Attributes
    ----------
    dsp : DspRegisters
    underflows, late_packets, sequence_errors : int
    """

    def __init__(self, clock, air, socket_bytes=None):
        self.dsp = DspRegisters(cic_power=3)
        self.underflows = 0
        self.late_packets = 0
        self.sequence_errors = 0
        self._clock = clock
        self._air = air
        self._socket_bytes = socket_bytes
        self._withheld = 0
        self._stream_id = 2
        self._policy = 2
        self._ticks_per_update = 0
        self._packets_per_update = 0
        self._report_count = 0
        self._make_late = False
        self._clear()

    def _clear(self):
        self._queue = deque()
        self._expected = None
        self._next_tick = None
        self._free_tick = self._clock.ticks
        self._skip_burst = False
        self._consumed = 0
        self._unreported = 0
        self._next_update = self._clock.ticks
        self._reports = []

    def poke(self, register, value):
        """Write register 0..5 of the stream's control block."""
        if register == 0 and value:
            self._clear()
        elif register == 2:
            self._stream_id = value
        elif register == 3:
            self._policy = value
        elif register == 4:
            self._ticks_per_update = value & 0xFFFFFF if value & _UPDATE_ENABLED else 0
            self._next_update = self._clock.ticks
        elif register == 5:
            self._packets_per_update = value & 0xFFFF if value & _UPDATE_ENABLED else 0
            self._withhold()

    @property
    def in_burst(self):
        """Whether a burst has begun and not ended."""
        return self._next_tick is not None

    @property
    def busy(self):
        """Whether a burst is on or waits to start."""
        return self.in_burst or bool(self._queue)

    def accept(self, datagram):
        """Queue the packet of one datagram.

        Raises
        ------
        Malformed
            When it is none, or the host overruns its window.
        """
        packet = parse(datagram)
        if len(self._queue) >= _MAX_QUEUE:
            raise Malformed("transmit queue is full")
        if self._expected is not None and packet.sequence != self._expected:
            self.sequence_errors += 1
            self._report(TX_SEQUENCE_ERROR, self._clock.ticks)
        self._expected = packet.sequence + 1 & 0xFFFFFFFF
        self._queue.append(packet)

    def make_late(self):
        """Treat the next packet that starts a burst as late."""
        self._make_late = True

    def covered_until(self, end):
        """The tick up to which nothing is missing, at most `end`: an open burst may run dry."""
        spacing = self.dsp.ticks_per_sample
        tick, opened = self._next_tick, self.in_burst
        for packet in self._queue:
            if not opened:
                tick = self._start_of(packet, tick or self._clock.ticks)
                opened = True
            if tick >= end:
                return end
            tick += packet.samples * spacing
            if packet.end:
                opened = False
        return min(tick, end) if opened else end

    def run(self, start, end):
        """Put on the air what belongs between ticks `start` and `end`."""
        while self._queue or self.in_burst:
            if not self.in_burst and not self._begin(start, end):
                return
            if self.in_burst and not self._play(end):
                return

    def reports(self):
        """Reports for the host that have come up; list of bytes."""
        if self._ticks_per_update and self._clock.ticks >= self._next_update:
            self._next_update = self._clock.ticks + self._ticks_per_update
            self._report(TX_FLOW, self._clock.ticks)
        out, self._reports = self._reports, []
        return out

    def _withhold(self):
        """Let the host send no more at once than the socket holds: acknowledge that much less."""
        self._withheld = 0
        if self._socket_bytes is None or not self._packets_per_update:
            return
        window = _REPORTS_PER_FIFO * self._packets_per_update
        room = self._socket_bytes // _kernel_bytes(_FIFO_BYTES // window)
        if room < window:
            self._withheld = window - max(room, 2)
            self._packets_per_update = min(self._packets_per_update, max(room // 2, 1))
            self._report(TX_FLOW, self._clock.ticks)

    def _start_of(self, packet, earliest):
        """Tick at which a burst begins: its time, or when the converter is free."""
        if packet.time is None:
            return max(earliest, self._free_tick)
        return self._clock.to_ticks(packet.time)

    def _begin(self, start, end):
        """Start or drop the packet at the head; False when it is not due before `end`."""
        packet = self._queue[0]
        if self._skip_burst:
            self._skip_burst = not packet.end
            self._done(self._queue.popleft())
            return True
        tick = self._start_of(packet, start)
        late = self._make_late or tick < start
        if tick >= end and not late:
            return False
        if late:
            self._make_late = False
            self.late_packets += 1
            self._skip_burst = self._policy & _POLICY_NEXT_BURST and not packet.end
            self._done(self._queue.popleft())
            self._report(TX_LATE, start)
        else:
            self._next_tick = tick
        return True

    def _play(self, end):
        """Play the open burst up to `end` or its own end; False when `end` is reached."""
        spacing = self.dsp.ticks_per_sample
        room = max(0, -(-(end - self._next_tick) // spacing))
        payloads, taken, ended = [], 0, False
        while self._queue and taken < room and not ended:
            packet = self._queue[0]
            count = min(packet.samples, room - taken)
            payloads.append(packet.payload[: 4 * count])
            packet.payload = packet.payload[4 * count :]
            taken += count
            if not packet.payload:
                self._queue.popleft()
                self._done(packet)
                ended = packet.end
        if taken:
            self._air.transmit(self._next_tick, spacing, self._samples(payloads))
            self._next_tick += taken * spacing
            self._free_tick = self._next_tick
        if ended:
            self._report(TX_BURST_ACK, self._next_tick)
            self._next_tick = None
            return True
        if taken < room:
            self.underflows += 1
            self._report(TX_UNDERFLOW, self._next_tick)
            self._skip_burst = bool(self._policy & _POLICY_NEXT_BURST)
            self._next_tick = None
            return True
        return False

    def _samples(self, payloads):
        wire = np.frombuffer(b"".join(payloads), ">i2")
        values = wire.astype(np.int16).astype(np.float32)
        values *= np.float32(self.dsp.gain / FULL_SCALE)
        return values.view(np.complex64)

    def _done(self, packet):
        """Count a packet that has left the queue, and let the host know in time."""
        self._consumed = packet.sequence
        self._unreported += 1
        if self._packets_per_update and self._unreported >= self._packets_per_update:
            self._report(TX_FLOW, self._clock.ticks)

    def _report(self, event, tick):
        self._unreported = 0
        time = self._clock.to_time(tick)
        acknowledged = self._consumed - self._withheld & 0xFFFFFFFF
        self._reports.append(
            tx_report(self._report_count, self._stream_id, time, event, acknowledged)
        )
        self._report_count += 1


def _kernel_bytes(datagram_bytes):
    """What a datagram takes of a socket's buffer: memory by powers of two, and its bookkeeping."""
    return (1 << (datagram_bytes + 511).bit_length()) + 512
