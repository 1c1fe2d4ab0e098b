# SPDX-License-Identifier: GPL-3.0-or-later
"""Fast control: register commands, executed in order and at their time, and acknowledged."""

import struct
from collections import deque
from dataclasses import dataclass

from ..wire import HAS_TIME, TYPE_MASK, Malformed, fifo_reply, words

_POKE = 1 << 8
_TYPE_CONTEXT = 0x40000000
_DEPTH = 4096


@dataclass(frozen=True)
class Command:
    """A register access; `time` in ticks of device time, None for immediately."""

    peer: tuple
    sequence: int
    control: int
    value: int
    time: int | None


class Fifo:
    """The queue of commands; a timed command holds all commands behind it."""

    def __init__(self, registers, clock):
        self._registers = registers
        self._clock = clock
        self._queue = deque()

    def submit(self, datagram, peer):
        """Queue the command in a datagram.

        Raises Malformed when it is not a command, or the queue is full.
        """
        sequence, header = words(datagram, 2)
        if header & TYPE_MASK != _TYPE_CONTEXT:
            raise Malformed(f"command header 0x{header:08x}")
        timed = bool(header & HAS_TIME)
        layout = struct.Struct(">QII" if timed else ">II")
        if len(datagram) != 8 + layout.size:
            raise Malformed(f"command of {len(datagram)} bytes")
        if len(self._queue) >= _DEPTH:
            raise Malformed("command queue is full")
        *time, control, value = layout.unpack_from(datagram, 8)
        self._queue.append(Command(peer, sequence, control, value, time[0] if timed else None))

    def next_tick(self):
        """Tick at which the first command is due, or None when it is untimed or there is none."""
        if self._queue and self._queue[0].time is not None:
            return self._clock.to_ticks(self._queue[0].time)
        return None

    def run(self):
        """Execute all commands that are due; list of (reply, peer)."""
        replies = []
        while self._queue:
            command = self._queue[0]
            if command.time is not None and command.time > self._clock.time:
                break
            self._queue.popleft()
            index, value = command.control & 0xFF, 0
            if command.control & _POKE:
                self._registers.poke(index, command.value)
            else:
                value = self._registers.peek(index)
            replies.append((fifo_reply(command.sequence, command.control, value), command.peer))
        return replies
