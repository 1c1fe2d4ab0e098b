# SPDX-License-Identifier: GPL-3.0-or-later
"""The host's side of the device: sockets, who is the host, and what it is sent."""

import errno
import ipaddress
import socket
import struct
from collections import Counter

from gnuradio.wiforce.errors import InputError

from .wire import (
    ALL_PORTS,
    CONTROL_PORT,
    FIFO_PORT,
    RX_PORT,
    TX_PORT,
    UNUSED_PORTS,
    Malformed,
    is_announcement,
)

_SOL_UDP, _UDP_SEGMENT = 17, 103
_MAX_SEGMENTS = 60
_MAX_BYTES = 65_000
_SO_RCVBUFFORCE = 33
_RECEIVE_BUFFER = 8 << 20
_MAX_DATAGRAM = 65_536
_MOST_AT_ONCE = 4096


def check_loopback(address):
    """The address, if it is an IPv4 loopback address."""
    try:
        if ipaddress.IPv4Address(address).is_loopback:
            return address
    except ValueError:
        pass
    raise InputError("--bind", "must be a loopback address, 127.0.0.0/8", address)


class Sockets:
    """One socket per port of the device, at a loopback IPv4 address."""

    def __init__(self, address):
        self._sockets = {}
        try:
            for port in ALL_PORTS:
                self._sockets[port] = _bound(address, port)
        except OSError as error:
            self.close()
            if error.errno == errno.EADDRINUSE:
                rule = f"port {port} is in use at this address; is another device running?"
            else:
                rule = f"port {port} cannot be bound ({error.strerror})"
            raise InputError("--bind", rule, address) from error

    def close(self):
        for sock in self._sockets.values():
            sock.close()
        self._sockets.clear()

    def receive_buffer(self, port):
        """Capacity of a port's receive buffer in bytes, the kernel's overhead included."""
        return self._sockets[port].getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)

    def items(self):
        return self._sockets.items()

    def drain(self, port):
        """All datagrams that are queued at a port, as (bytes, peer)."""
        receive = self._sockets[port].recvfrom
        received = []
        try:
            while len(received) < _MOST_AT_ONCE:
                received.append(receive(_MAX_DATAGRAM))
        except (BlockingIOError, ConnectionError):
            pass  # no more, or the peer has closed its socket
        return received

    def send(self, port, datagram, peer):
        """Send a datagram; it is lost when the receiver is full or absent, as on a network."""
        try:
            self._sockets[port].sendto(datagram, peer)
        except OSError:
            pass  # also where no address is one to send to: of a forged datagram

    def send_segments(self, port, data, size, peer):
        """Send `data` as datagrams of `size` bytes each, many by one system call (Linux 4.18)."""
        step = size * max(1, min(_MAX_SEGMENTS, _MAX_BYTES // size))
        control = [(_SOL_UDP, _UDP_SEGMENT, struct.pack("=H", size))]
        for start in range(0, len(data), step):
            try:
                self._sockets[port].sendmsg([data[start : start + step]], control, 0, peer)
            except OSError:
                pass  # lost, as by `send`, or since the system has no buffers


def _bound(address, port):
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setblocking(False)
        try:
            # A host may send a whole window at once; only root may request such a large buffer.
            sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER)
        except PermissionError:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        sock.bind((address, port))
    except OSError:
        sock.close()
        raise
    return sock


class HostLink:
    """Takes datagrams in the order in which the host meant them, and sends the replies.

    ``ignored`` counts ``malformed`` and ``foreign`` ones, of peers that are not announced.
    """

    def __init__(self, sockets, hardware, throttle):
        self.ignored = Counter(malformed=0, foreign=0)
        self._sockets = sockets
        self._hardware = hardware
        self._throttle = throttle
        self._rx_peer = self._tx_peer = None

    def serve(self, ready):
        """Take what has arrived at the ports in `ready`, a set."""
        # Samples are read first and handed on last: a register write that the host sent before
        # them, through another socket, must act before them.
        samples = self._sockets.drain(TX_PORT) if TX_PORT in ready else []
        if FIFO_PORT in ready:
            self._handle(self._sockets.drain(FIFO_PORT), self._submit)
        self.run_commands()
        if CONTROL_PORT in ready:
            self._handle(self._sockets.drain(CONTROL_PORT), self._answer)
        if RX_PORT in ready:
            self._handle(self._sockets.drain(RX_PORT), self._announce_rx)
        for port in ready.intersection(UNUSED_PORTS):
            self._sockets.drain(port)
        if samples:
            self._throttle.tx_arrived()
        self._handle(samples, self._accept)

    def run_commands(self):
        """Execute the register commands that are due, and acknowledge them."""
        for reply, peer in self._hardware.fifo.run():
            self._sockets.send(FIFO_PORT, reply, peer)

    def deliver(self):
        """Send received packets; False when the host has no room for all of them yet."""
        packets = self._hardware.receive.packets.ready
        if self._rx_peer is None:  # nothing is kept while no host listens
            packets.clear()
        while packets:
            data, size = packets.popleft()
            room = self._throttle.room(self._rx_peer, size)
            if room is None:  # the host's socket is closed
                self._hardware.receive.stop()
                continue
            part, rest = data[: room * size], data[room * size :]
            self._sockets.send_segments(RX_PORT, part, size, self._rx_peer)
            if rest:
                packets.appendleft((rest, size))
                return False
        return True

    def send_reports(self):
        reports = self._hardware.transmit.flow.reports
        if self._tx_peer is not None:
            for report in reports:
                self._sockets.send(TX_PORT, report, self._tx_peer)
        reports.clear()

    def _handle(self, datagrams, handle):
        """Handle datagrams one by one; malformed ones are counted and ignored."""
        for datagram, peer in datagrams:
            try:
                handle(datagram, peer)
            except Malformed:
                self.ignored["malformed"] += 1

    def _submit(self, datagram, peer):
        if is_announcement(datagram):
            self._hardware.fifo.clear()  # what the host before has left may wait for ever
        else:
            self._hardware.fifo.submit(datagram, peer)

    def _answer(self, datagram, peer):
        reply = self._hardware.control.reply(datagram)
        if reply is not None:
            self._sockets.send(CONTROL_PORT, reply, peer)

    def _announce_rx(self, datagram, peer):
        if not is_announcement(datagram):
            raise Malformed("the receive port takes announcements only")
        self._rx_peer = peer

    def _accept(self, datagram, peer):
        if is_announcement(datagram):
            self._tx_peer = peer
        elif peer != self._tx_peer:
            self.ignored["foreign"] += 1
        else:
            self._hardware.transmit.accept(datagram)
