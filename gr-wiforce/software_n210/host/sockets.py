# SPDX-License-Identifier: GPL-3.0-or-later
"""The device's UDP sockets, bound to a loopback address only."""

import errno
import ipaddress
import socket
import struct

from gnuradio.wiforce.errors import InputError

from ..wire import ALL_PORTS

_SOL_UDP, _UDP_SEGMENT = 17, 103
_MAX_SEGMENTS = 60
_MAX_BYTES = 65_000
_SO_RCVBUFFORCE = 33
_RECEIVE_BUFFER = 8 << 20
_MAX_DATAGRAM = 65_536


def check_loopback(address):
    """The address, if it is an IPv4 loopback address."""
    try:
        if ipaddress.IPv4Address(address).is_loopback:
            return address
    except ValueError:
        pass
    raise InputError("--bind", "must be a loopback address, 127.0.0.0/8", address)


class Sockets:
    """One socket per port of the device.

    ``address``: loopback IPv4 address.
    """

    def __init__(self, address):
        self._sockets = {}
        self._segmentation = True
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
        """Close all sockets."""
        for sock in self._sockets.values():
            sock.close()
        self._sockets = {}

    def receive_buffer(self, port):
        """Capacity of a port's receive buffer in bytes, the kernel's overhead included."""
        return self._sockets[port].getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)

    def items(self):
        """Pairs of port and socket."""
        return self._sockets.items()

    def drain(self, port, limit=4096):
        """All datagrams that are queued at a port, as (bytes, peer)."""
        receive = self._sockets[port].recvfrom
        received = []
        try:
            while len(received) < limit:
                received.append(receive(_MAX_DATAGRAM))
        except BlockingIOError:
            pass
        except ConnectionError:
            pass  # the peer has closed its socket
        return received

    def send(self, port, datagram, peer):
        """Send a datagram; it is lost when the receiver is full or absent, as on a network."""
        try:
            self._sockets[port].sendto(datagram, peer)
        except (BlockingIOError, ConnectionError):
            pass

    def send_segments(self, port, data, size, peer):
        """Send `data` as datagrams of `size` bytes each."""
        step = size * max(1, min(_MAX_SEGMENTS, _MAX_BYTES // size))
        view = memoryview(data)
        for start in range(0, len(view), step):
            chunk = view[start : start + step]
            if not self._send_many(port, chunk, size, peer):
                for offset in range(0, len(chunk), size):
                    self.send(port, chunk[offset : offset + size], peer)

    def _send_many(self, port, chunk, size, peer):
        """Send many datagrams by one system call; False when the kernel (before 4.18) cannot."""
        if not self._segmentation or len(chunk) <= size:
            return False
        control = [(_SOL_UDP, _UDP_SEGMENT, struct.pack("=H", size))]
        try:
            self._sockets[port].sendmsg([chunk], control, 0, peer)
        except (BlockingIOError, ConnectionError):
            return True
        except OSError:
            self._segmentation = False
            return False
        return True


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
