# SPDX-License-Identifier: GPL-3.0-or-later
"""What passes between the device's ports and the host: requests, samples and reports."""

from collections import Counter, deque

from ..wire import CONTROL_PORT, FIFO_PORT, GPS_PORT, RX_PORTS, TX_PORT, Malformed, is_announcement


class HostLink:
    """Takes datagrams in the order in which the host meant them, and sends the replies.

    ``throttle``: limits what is sent to what the host has room for; None sends everything at once.
    ``ignored``: datagrams that were ignored: ``malformed``, or ``foreign`` (from a peer that has
    not announced itself).
    """

    def __init__(self, sockets, hardware, throttle):
        self.ignored = Counter(malformed=0, foreign=0)
        self._sockets = sockets
        self._hardware = hardware
        self._throttle = throttle
        self._rx_peers = [None] * len(RX_PORTS)
        self._tx_peer = None
        self._outbox = deque()

    def serve(self, ready):
        """Take what has arrived at the ports in `ready`, a set."""
        if self._hardware.network.is_cut:
            for port in ready - {None}:
                self._sockets.drain(port)
            return
        # Samples are read first and handed on last: a register write that the host sent before
        # them, through another socket, must act before them.
        samples = self._sockets.drain(TX_PORT) if TX_PORT in ready else []
        if FIFO_PORT in ready:
            self._handle(self._sockets.drain(FIFO_PORT), self._submit)
        self.run_commands()
        if CONTROL_PORT in ready:
            self._handle(self._sockets.drain(CONTROL_PORT), self._answer)
        for index, port in enumerate(RX_PORTS):
            if port in ready:
                self._handle(
                    self._sockets.drain(port),
                    lambda data, peer, index=index: self._announce_rx(index, data, peer),
                )
        if GPS_PORT in ready:
            self._sockets.drain(GPS_PORT)
        if samples and self._throttle:
            self._throttle.tx_arrived()
        self._handle(samples, self._accept)

    def run_commands(self):
        """Execute the register commands that are due, and acknowledge them."""
        for reply, peer in self._hardware.fifo.run():
            if not self._hardware.network.is_cut:
                self._sockets.send(FIFO_PORT, reply, peer)

    def queue(self, packets):
        """Queue received packets for the host; nothing is kept while no host listens."""
        if packets and self._hardware.network.is_cut:
            self._tear(*packets[0])
            return
        for index, data, size in packets:
            if self._rx_peers[index] is not None:
                self._outbox.append((index, memoryview(data), size))

    def deliver(self):
        """Send queued packets; False when the host has no room for all of them yet."""
        while self._outbox:
            index, data, size = self._outbox.popleft()
            peer = self._rx_peers[index]
            room = self._throttle.room(peer, size) if self._throttle else len(data)
            if room is None:  # the host's socket is closed
                self._hardware.receive[index].stop()
                continue
            part, rest = data[: room * size], data[room * size :]
            self._sockets.send_segments(RX_PORTS[index], part, size, peer)
            if rest:
                self._outbox.appendleft((index, rest, size))
                return False
        return True

    def _tear(self, index, data, size):
        """Send what a network that has just been cut lets pass of the next packet."""
        self.discard()
        rest, peer = self._hardware.network.passed(bytes(data[:size])), self._rx_peers[index]
        if rest and peer is not None:
            self._sockets.send(RX_PORTS[index], rest, peer)

    def discard(self):
        """Drop queued packets."""
        self._outbox.clear()

    def send_reports(self):
        """Send the transmit stream's reports that are due."""
        reports = self._hardware.transmit.flow.take()
        if self._tx_peer is not None and not self._hardware.network.is_cut:
            for report in reports:
                self._sockets.send(TX_PORT, report, self._tx_peer)

    def _handle(self, datagrams, handle):
        """Handle datagrams one by one; malformed ones are counted and ignored."""
        for datagram, peer in datagrams:
            try:
                handle(datagram, peer)
            except Malformed:
                self.ignored["malformed"] += 1

    def _submit(self, datagram, peer):
        if not is_announcement(datagram):
            self._hardware.fifo.submit(datagram, peer)

    def _answer(self, datagram, peer):
        reply = self._hardware.control.reply(datagram)
        if reply is not None:
            self._sockets.send(CONTROL_PORT, reply, peer)

    def _announce_rx(self, index, datagram, peer):
        if not is_announcement(datagram):
            raise Malformed("a receive port takes announcements only")
        self._rx_peers[index] = peer

    def _accept(self, datagram, peer):
        if is_announcement(datagram):
            self._tx_peer = peer
        elif peer != self._tx_peer:
            self.ignored["foreign"] += 1
        else:
            self._hardware.transmit.accept(datagram)
