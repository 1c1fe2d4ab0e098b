# SPDX-License-Identifier: GPL-3.0-or-later
"""The device: one loop that serves the host, moves the device's clock and lets faults happen."""

import math
import os
import select
import socket
import struct
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from gnuradio.wiforce.errors import InputError

from .frontend import Cable
from .hardware import Hardware
from .host_link import HostLink, Sockets, check_loopback
from .wire import TICK_RATE, TX_PORT

_IDLE_TICKS = 1_000_000
_IDLE_WAIT_S = 0.01
_HOLD_WAIT_S = 0.0005
# Wall time after which received samples are sent, where a step may hold more. A device sends a
# packet as soon as it is full: every 1.6 ms at 1.25 Msps with frames of 8000 bytes.
_SEND_S = 2e-3
# Steps whose times are kept: some ten seconds.
_KEPT_STEPS = 5000
# Below the usual 208 KiB of a receive buffer, counted as the kernel does: with its own overhead.
_BACKLOG_LIMIT = 180_000
_DATAGRAM_OVERHEAD = 832
_DEBT_LIMIT_S = 0.02
_HOLD_LIMIT_S = 0.3
_TX_PAUSE_S = 0.003
_TX_UNDERFLOW_S = 0.25


class WallClock:
    """Ticks that device time may have reached by now; ``held_s`` is not caught up in a rush."""

    def __init__(self, speed):
        self._ticks_per_second = TICK_RATE * speed
        self._anchor_s = time.monotonic()
        self._anchor_ticks = 0
        self.held_s = 0.0

    def allowance(self, ticks):
        """Ticks by which a device at `ticks` may advance."""
        elapsed = time.monotonic() - self._anchor_s
        due = self._anchor_ticks + int(elapsed * self._ticks_per_second) - ticks
        limit = int(_DEBT_LIMIT_S * self._ticks_per_second)
        if due > limit:
            self._anchor_ticks -= due - limit
            self.held_s += (due - limit) / self._ticks_per_second
            due = limit
        return max(due, 0)

    def seconds_for(self, ticks):
        return ticks / self._ticks_per_second


class Throttle:
    """Lossless pacing: holds device time while the host is slow, for a limited time."""

    def __init__(self):
        self._table = os.open("/proc/net/udp", os.O_RDONLY)
        self._backlog, self._changed_s = (None, 0), 0.0  # of a peer, and since when
        self._tx_arrival_s = 0.0
        self._tx_short_s = None  # since when transmit samples are missing

    def close(self):
        os.close(self._table)

    def tx_arrived(self):
        self._tx_arrival_s = time.monotonic()

    def room(self, peer, size):
        """Number of datagrams of `size` bytes that fit the socket of `peer`; None if closed."""
        queued = self._queued(peer)
        if queued is None:
            return None
        now = time.monotonic()
        if self._backlog != (peer, queued):
            self._backlog, self._changed_s = (peer, queued), now
        if now - self._changed_s > _HOLD_LIMIT_S:
            queued = 0  # the host does not read, so samples are lost as on a network
        return max(_BACKLOG_LIMIT - queued, 0) // (size + _DATAGRAM_OVERHEAD)

    def _queued(self, peer):
        """Bytes in the receive socket of `peer` (address, port); None without such a socket."""
        address = struct.unpack("=I", socket.inet_aton(peer[0]))[0]
        keys = [f": {a:08X}:{peer[1]:04X} ".encode() for a in (address, 0)]
        offset = 0
        while table := os.pread(self._table, 65536, offset):  # whole lines
            for key in keys:
                at = table.find(key)
                if at >= 0:
                    fields = table[at + 2 : table.find(b"\n", at)].split()
                    return int(fields[3].partition(b":")[2], 16)
            offset += len(table)
        return None

    def transmit_until(self, covered, start, end):
        """End of a step from `start` to `end` when transmit samples reach to `covered`."""
        if covered >= end:
            self._tx_short_s = None
            return end
        now = time.monotonic()
        if self._tx_short_s is None:
            self._tx_short_s = now
        waited = now - max(self._tx_arrival_s, self._tx_short_s)
        if waited > _TX_UNDERFLOW_S:
            return end
        return covered if waited > _TX_PAUSE_S else start


def _switch(on, hardware, sensor):
    hardware.air.sensor(sensor).on = on


# The argument of each kind, and what it does to the hardware.
_KINDS = {
    "overflow": ("samples", lambda hardware, samples: hardware.receive.overflow(samples)),
    "lose": ("packets", lambda hardware, packets: hardware.receive.packets.lose(packets)),
    "off": ("sensor", partial(_switch, False)),
    "on": ("sensor", partial(_switch, True)),
}
_MOST = 1e9
GRAMMAR = "; ".join(f"{kind} {argument}" for kind, (argument, _) in _KINDS.items())


@dataclass(frozen=True)
class Fault:
    """One fault, so many ticks after the first received sample."""

    time: int
    kind: str
    argument: int | str

    def apply(self, hardware):
        _KINDS[self.kind][1](hardware, self.argument)


def parse_fault(text: str, where: str = "--fault") -> Fault:
    """A fault from ``TIME KIND ARGUMENT``.

    TIME is in seconds after the first sample that was received since the device was opened. Faults
    that are given while it is closed wait for the next host. The kinds are::

        overflow SAMPLES        report an overflow, lose SAMPLES and continue
        lose PACKETS            number the next packets but do not send them
        off SENSOR, on SENSOR   stop or start the switches of a tag

    ``where``: named in the error.
    """
    time, *rest = text.split() or [""]
    kind, *arguments = rest or [""]
    try:
        ticks = round(float(time) * TICK_RATE)
    except (ValueError, OverflowError):
        ticks = -1
    if ticks < 0:
        raise InputError(where, "must begin with a time in seconds, not negative", text)
    if kind not in _KINDS:
        raise InputError(where, f"must be one of: {GRAMMAR}", text)
    name = _KINDS[kind][0]
    form = f"TIME {kind} {name}"
    if len(arguments) != 1:
        raise InputError(where, f"must have the form {form}", text)
    (argument,) = arguments
    if name == "sensor":
        return Fault(ticks, kind, argument)
    try:
        number = int(argument)
    except ValueError:
        raise InputError(where, f"{name} must be a number in {form}", text) from None
    if not 1 <= number <= _MOST:
        raise InputError(where, f"{name} must be 1 to {_MOST:g} in {form}", text)
    return Fault(ticks, kind, number)


class Device:
    """A software N210 at a loopback address, with some ``air`` between its connectors.

    ``speed`` limits device seconds per second; device time is held while the host is slow.
    """

    def __init__(
        self,
        air: Cable,
        address: str = "127.0.0.1",
        speed: float = 1.0,
        faults: Iterable[Fault] = (),
    ):
        self.address = check_loopback(address)
        if not 0 < speed < math.inf:
            raise InputError("speed", "must be positive and finite", speed)
        self.air = air
        self._faults: list[Fault] = []
        self._faults_applied = 0
        for fault in faults:
            self.add_fault(fault)
        self._sockets = Sockets(address)
        self._hardware = Hardware(air, address, self._sockets.receive_buffer(TX_PORT))
        self._wall = WallClock(speed)
        self._throttle = Throttle()
        self._link = HostLink(self._sockets, self._hardware, self._throttle)
        self._sent = deque(maxlen=_KEPT_STEPS)
        self._stop = False
        self._port_of = {sock.fileno(): port for port, sock in self._sockets.items()}
        # By file descriptor, what to call while it is readable.
        self.watched: dict[int, Callable[[], None]] = {}

    def add_fault(self, fault: Fault) -> None:
        if isinstance(fault.argument, str):
            self.air.sensor(fault.argument)  # refuses one that is not on the air
        self._faults.append(fault)
        self._faults.sort(key=lambda fault: fault.time)

    def stop(self) -> None:
        """Make `run` return; may be called from a signal handler."""
        self._stop = True

    def close(self) -> None:
        self._sockets.close()
        self._throttle.close()

    def run(self) -> None:
        wait_s = 0.0
        while not self._stop:
            ready, _, _ = select.select([*self._port_of, *self.watched], [], [], wait_s)
            self._link.serve({self._port_of.get(descriptor) for descriptor in ready})
            for descriptor in self.watched.keys() & set(ready):
                self.watched[descriptor]()
            wait_s = self._advance()

    def status(self) -> dict:
        """State and counters as plain values; docs/radios.md lists them."""
        return {
            "cpu_s": time.process_time(),
            **self._hardware.status(),
            **self._link.ignored,
            "faults": self._faults_applied,
            "held_s": self._wall.held_s,
        }

    def take_sent(self) -> list[tuple[float, float]]:
        """(device time sent, monotonic time) in s since the last call, up to ten seconds."""
        sent = list(self._sent)
        self._sent.clear()
        return sent

    def _advance(self):
        """Move device time on by at most one step; seconds to wait before the next."""
        hardware = self._hardware
        while self._fault_tick() <= hardware.clock.ticks:
            self._faults.pop(0).apply(hardware)
            self._faults_applied += 1
        if not self._link.deliver():
            return _HOLD_WAIT_S
        start = hardware.clock.ticks
        hardware.transmit.discard_late(start)
        end = start + min(self._wall.allowance(start), hardware.longest_step)
        end = self._until_event(start, end)
        if end > start and hardware.streaming:
            covered = hardware.transmit.covered_until(end)
            end = self._throttle.transmit_until(covered, start, end)
            if end == start:
                return _HOLD_WAIT_S
        if end > start:
            self._step(start, end)
        return self._wait_after(end)

    def _fault_tick(self):
        """Tick of the next fault; infinite without one, or without a stream."""
        begun = self._hardware.receive.stream_start
        return math.inf if begun is None or not self._faults else begun + self._faults[0].time

    def _until_event(self, start, end):
        """End a step where something must act, or where a host may want to answer."""
        return self._hardware.next_event(start, min(end, max(self._fault_tick(), start)))

    def _step(self, start, end):
        """Everything that happens between two ticks: transmit, receive, then what is due."""
        hardware = self._hardware
        hardware.transmit.run(start, end)
        hardware.receive.run(start, end)
        self._link.deliver()
        if hardware.streaming:
            self._sent.append((hardware.clock.to_time(end) / TICK_RATE, time.monotonic()))
        hardware.clock.advance(end)
        self.air.forget(end)
        self._link.run_commands()
        self._link.send_reports()

    def _wait_after(self, end):
        if not self._hardware.streaming:
            pending = self._until_event(end, end + _IDLE_TICKS) - end
            return min(_IDLE_WAIT_S, max(self._wall.seconds_for(pending), 0.0))
        longest_s = min(self._wall.seconds_for(self._hardware.longest_step), _SEND_S)
        return max(longest_s - self._wall.seconds_for(self._wall.allowance(end)), 0.0)
