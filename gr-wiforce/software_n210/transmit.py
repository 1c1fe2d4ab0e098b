# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmit streams, their packets, and flow control."""

import struct
from collections import deque
from dataclasses import dataclass

import numpy as np

from .frontend import FULL_SCALE, DspRegisters
from .wire import (
    END_OF_BURST,
    HAS_TIME,
    HAS_TRAILER,
    TX_BURST_ACK,
    TX_FLOW,
    TX_LATE,
    TX_SEQUENCE_ERROR,
    TX_UNDERFLOW,
    TYPE_MASK,
    Malformed,
    tx_report,
    words,
)

_TIME = struct.Struct(">Q")


@dataclass
class Packet:
    """A data packet: ticks of device time or None, end of burst, rest as big-endian I and Q."""

    sequence: int
    time: int | None
    end: bool
    payload: memoryview

    @property
    def samples(self):
        return len(self.payload) // 4


def parse_packet(datagram):
    """The packet in a datagram; Malformed when it is none, or shorter than its header says."""
    sequence, header = words(datagram, 2)
    if header & TYPE_MASK:
        raise Malformed(f"data header 0x{header:08x}")
    length = 4 + 4 * (header & 0xFFFF)
    first = 16 if header & HAS_TIME else 8
    last = length - 4 if header & HAS_TRAILER else length
    # Ethernet pads short frames, so a datagram may be longer than its header states.
    if len(datagram) < length or last <= first:
        raise Malformed(f"data packet of {len(datagram)} bytes states {length}")
    time = _TIME.unpack_from(datagram, 8)[0] if header & HAS_TIME else None
    return Packet(sequence, time, bool(header & END_OF_BURST), memoryview(datagram)[first:last])


_UPDATE_ENABLED = 1 << 31
# The driver takes the device for a FIFO of 1 MiB, and asks for eight reports per FIFO length.
_FIFO_BYTES = 1 << 20
_REPORTS_PER_FIFO = 8


class FlowControl:
    """Reports events and acknowledges packets, as many as the host's window fits the socket."""

    def __init__(self, clock, socket_bytes):
        self.stream_id = 2
        self._clock = clock
        self._socket_bytes = socket_bytes
        self._withheld = 0
        self._packets_per_update = 0
        self._report_count = 0
        self.clear()

    def clear(self):
        self._consumed = 0
        self._unreported = 0
        self.reports = []  # to be sent

    def report_every_packets(self, value):
        """Set the register by which the driver asks for reports per number of packets."""
        self._packets_per_update = value & 0xFFFF if value & _UPDATE_ENABLED else 0
        self._fit_window_to_socket()

    def consumed(self, packet):
        """Note that a packet has left the queue; report it when enough have."""
        self._consumed = packet.sequence
        self._unreported += 1
        if self._packets_per_update and self._unreported >= self._packets_per_update:
            self.report(TX_FLOW, self._clock.ticks)

    def report(self, event, tick):
        """Queue a report of an event; every report acknowledges the consumed packets too."""
        self._unreported = 0
        time = self._clock.to_time(tick)
        acknowledged = self._consumed - self._withheld & 0xFFFFFFFF
        report = tx_report(self._report_count, self.stream_id, time, event, acknowledged)
        self.reports.append(report)
        self._report_count += 1

    def _fit_window_to_socket(self):
        """Acknowledge fewer packets, so that the host's window fits the socket."""
        self._withheld = 0
        if not self._packets_per_update:
            return
        window = _REPORTS_PER_FIFO * self._packets_per_update
        # A datagram takes a power of two of the socket's buffer, and its bookkeeping.
        taken = (1 << (_FIFO_BYTES // window + 511).bit_length()) + 512
        room = self._socket_bytes // taken
        if room < window:
            self._withheld = window - max(room, 2)
            self._packets_per_update = min(self._packets_per_update, max(room // 2, 1))
            self.report(TX_FLOW, self._clock.ticks)


_MAX_QUEUE = 4096


class TransmitChain:
    """The transmit DSP with its stream, which ``air`` takes as complex64 at full scale 1.0."""

    def __init__(self, clock, air, socket_bytes):
        self.dsp = DspRegisters(cic_power=3)
        self.counts = dict.fromkeys(("tx_underflows", "tx_late_packets", "tx_sequence_errors"), 0)
        self._clock = clock
        self._air = air
        self.flow = FlowControl(clock, socket_bytes)
        self._clear()

    def _clear(self):
        self._queue = deque()
        self._expected = None
        self._next_tick = None
        self._free_tick = self._clock.ticks
        self.flow.clear()

    def poke(self, register, value):
        """Write register 0..5 of the stream's control block."""
        if register == 0 and value:
            self._clear()
        elif register == 2:
            self.flow.stream_id = value
        elif register == 5:
            self.flow.report_every_packets(value)

    @property
    def in_burst(self):
        return self._next_tick is not None

    @property
    def busy(self):
        return self.in_burst or bool(self._queue)

    def accept(self, datagram):
        """Queue a datagram's packet; Malformed when it is none, or the host exceeds its window."""
        packet = parse_packet(datagram)
        if len(self._queue) >= _MAX_QUEUE:
            raise Malformed("transmit queue is full")
        if self._expected is not None and packet.sequence != self._expected:
            self.counts["tx_sequence_errors"] += 1
            self.flow.report(TX_SEQUENCE_ERROR, self._clock.ticks)
        self._expected = packet.sequence + 1 & 0xFFFFFFFF
        self._queue.append(packet)

    def discard_late(self, now):
        """Drop late packets as they arrive, also while device time is held: so does a device."""
        if not self.in_burst:
            self.run(now, now)

    def covered_until(self, end):
        """The tick up to which no sample is missing, at most `end`; an open burst may run out."""
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
        """Transmit the samples that are due between ticks `start` and `end`."""
        while self._queue or self.in_burst:
            if not self.in_burst and not self._begin(start, end):
                return
            if self.in_burst and not self._play(end):
                return

    def _start_of(self, packet, earliest):
        """Tick at which a burst begins: its time, or when the last burst has ended."""
        if packet.time is None:
            return max(earliest, self._free_tick)
        return self._clock.to_ticks(packet.time)

    def _begin(self, start, end):
        """Start or drop the packet at the head; False when it is not due before `end`."""
        packet = self._queue[0]
        tick = self._start_of(packet, start)
        late = tick < start
        if tick >= end and not late:
            return False
        if late:
            self.counts["tx_late_packets"] += 1
            self.flow.consumed(self._queue.popleft())
            self.flow.report(TX_LATE, start)
        else:
            self._next_tick = tick
        return True

    def _play(self, end):
        """Transmit the open burst up to `end` or its own end; False when `end` is reached."""
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
                self.flow.consumed(packet)
                ended = packet.end
        if taken:
            self._air.transmit(self._next_tick, spacing, self._samples(payloads))
            self._next_tick += taken * spacing
            self._free_tick = self._next_tick
        if ended:
            self.flow.report(TX_BURST_ACK, self._next_tick)
            self._next_tick = None
            return True
        if taken < room:
            self.counts["tx_underflows"] += 1
            self.flow.report(TX_UNDERFLOW, self._next_tick)
            self._next_tick = None
            return True
        return False

    def _samples(self, payloads):
        wire = np.frombuffer(b"".join(payloads), ">i2")
        values = wire.astype(np.int16).astype(np.float32)
        values *= np.float32(self.dsp.gain / FULL_SCALE)
        return values.view(np.complex64)
