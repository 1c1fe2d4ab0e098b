# SPDX-License-Identifier: GPL-3.0-or-later
"""Limits of device time: not ahead of wall time, and not ahead of a slow host."""

import os
import socket
import struct
import time

from .wire import TICK_RATE

# Below the usual 208 KiB of a receive buffer, counted as the kernel does: with its own overhead.
_BACKLOG_LIMIT = 180_000
_DATAGRAM_OVERHEAD = 832
_DEBT_LIMIT_S = 0.02
_HOLD_LIMIT_S = 0.3
_TX_PAUSE_S = 0.003
_TX_UNDERFLOW_S = 0.25


class WallClock:
    """Ticks that device time may have reached by now.

    Time during which the device was held is not caught up, since samples would arrive in a rush;
    ``held_s`` is its sum.
    """

    def __init__(self, speed=1.0, now=time.monotonic):
        self._ticks_per_second = TICK_RATE * speed
        self._now = now
        self._anchor_s = now()
        self._anchor_ticks = 0
        self.held_s = 0.0

    def allowance(self, ticks):
        """Ticks by which a device at `ticks` may advance."""
        elapsed = self._now() - self._anchor_s
        due = self._anchor_ticks + int(elapsed * self._ticks_per_second) - ticks
        limit = int(_DEBT_LIMIT_S * self._ticks_per_second)
        if due > limit:
            self._anchor_ticks -= due - limit
            self.held_s += (due - limit) / self._ticks_per_second
            due = limit
        return max(due, 0)

    def seconds_for(self, ticks):
        """Wall time of `ticks`."""
        return ticks / self._ticks_per_second


class HostBacklog:
    """Bytes that are queued in a host's receive socket, from /proc/net/udp."""

    def __init__(self):
        self._file = os.open("/proc/net/udp", os.O_RDONLY)

    def close(self):
        os.close(self._file)

    def read(self, peer):
        """Bytes queued for `peer` (address, port); None when no such socket is open."""
        address = struct.unpack("=I", socket.inet_aton(peer[0]))[0]
        keys = [f": {a:08X}:{peer[1]:04X} ".encode() for a in (address, 0)]
        offset = 0
        while table := os.pread(self._file, 65536, offset):  # whole lines
            for key in keys:
                at = table.find(key)
                if at >= 0:
                    fields = table[at + 2 : table.find(b"\n", at)].split()
                    return int(fields[3].partition(b":")[2], 16)
            offset += len(table)
        return None


class Throttle:
    """Lossless pacing: holds device time while the host is slow, for a limited time."""

    def __init__(self, backlog, now=time.monotonic):
        self._backlog = backlog
        self._now = now
        self._last_backlog = {}
        self._changed_s = {}
        self._tx_arrival_s = 0.0
        self._tx_short_s = None  # since when transmit samples are missing

    def tx_arrived(self):
        """Note that transmit packets have arrived."""
        self._tx_arrival_s = self._now()

    def room(self, peer, size):
        """Number of datagrams of `size` bytes that fit the socket of `peer`; None if closed."""
        queued = self._backlog.read(peer)
        if queued is None:
            return None
        now = self._now()
        if queued != self._last_backlog.get(peer):
            self._last_backlog[peer] = queued
            self._changed_s[peer] = now
        if now - self._changed_s[peer] > _HOLD_LIMIT_S:
            queued = 0  # the host does not read, so samples are lost as on a network
        return max(_BACKLOG_LIMIT - queued, 0) // (size + _DATAGRAM_OVERHEAD)

    def transmit_until(self, covered, start, end):
        """End of a step from `start` to `end` when transmit samples reach to `covered`."""
        if covered >= end:
            self._tx_short_s = None
            return end
        now = self._now()
        if self._tx_short_s is None:
            self._tx_short_s = now
        waited = now - max(self._tx_arrival_s, self._tx_short_s)
        if waited > _TX_UNDERFLOW_S:
            return end
        return covered if waited > _TX_PAUSE_S else start
