# SPDX-License-Identifier: GPL-3.0-or-later
"""Flow control of the transmit stream: which packets the host knows to be consumed."""

from ..wire import TX_FLOW, tx_report

_UPDATE_ENABLED = 1 << 31
# The driver takes the device for a FIFO of 1 MiB, and asks for eight reports per FIFO length.
_FIFO_BYTES = 1 << 20
_REPORTS_PER_FIFO = 8


class FlowControl:
    """Reports to the host: acknowledgements of packets, and events of the stream.

    ``socket_bytes``: capacity of the socket that packets arrive at; None when it is unlimited. The
    host is acknowledged fewer packets than were consumed when its window would not fit.
    """

    def __init__(self, clock, socket_bytes=None):
        self.stream_id = 2
        self._clock = clock
        self._socket_bytes = socket_bytes
        self._withheld = 0
        self._ticks_per_update = 0
        self._packets_per_update = 0
        self._report_count = 0
        self.clear()

    def clear(self):
        """Forget the packets of the last stream."""
        self._consumed = 0
        self._unreported = 0
        self._next_update = self._clock.ticks
        self._reports = []

    def report_every_ticks(self, value):
        """Set the register by which the driver asks for reports in time."""
        self._ticks_per_update = value & 0xFFFFFF if value & _UPDATE_ENABLED else 0
        self._next_update = self._clock.ticks

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
        self._reports.append(
            tx_report(self._report_count, self.stream_id, time, event, acknowledged)
        )
        self._report_count += 1

    def take(self):
        """Reports to send, which leave the queue; list of bytes."""
        if self._ticks_per_update and self._clock.ticks >= self._next_update:
            self._next_update = self._clock.ticks + self._ticks_per_update
            self.report(TX_FLOW, self._clock.ticks)
        reports, self._reports = self._reports, []
        return reports

    def _fit_window_to_socket(self):
        """Acknowledge fewer packets, so that the host's window fits the socket."""
        self._withheld = 0
        if self._socket_bytes is None or not self._packets_per_update:
            return
        window = _REPORTS_PER_FIFO * self._packets_per_update
        room = self._socket_bytes // _kernel_bytes(_FIFO_BYTES // window)
        if room < window:
            self._withheld = window - max(room, 2)
            self._packets_per_update = min(self._packets_per_update, max(room // 2, 1))
            self.report(TX_FLOW, self._clock.ticks)


def _kernel_bytes(datagram_bytes):
    """Bytes of a socket's buffer that a datagram takes: a power of two, and its bookkeeping."""
    return (1 << (datagram_bytes + 511).bit_length()) + 512
