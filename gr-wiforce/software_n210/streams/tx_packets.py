# SPDX-License-Identifier: GPL-3.0-or-later
"""Data packets of the transmit stream, as the driver sends them."""

import struct
from dataclasses import dataclass

from ..wire import END_OF_BURST, HAS_TIME, HAS_TRAILER, TYPE_MASK, Malformed, words

_TIME = struct.Struct(">Q")


@dataclass
class Packet:
    """A data packet.

    ``time``: ticks of device time, None when the packet carries no time; ``end``: whether it ends a
    burst; ``payload``: samples not transmitted yet, as big-endian 16-bit I and Q.
    """

    sequence: int
    time: int | None
    end: bool
    payload: memoryview

    @property
    def samples(self):
        """Number of samples not transmitted yet."""
        return len(self.payload) // 4


def parse_packet(datagram):
    """The packet in a datagram.

    Raises Malformed when it is no data packet, or shorter than its header states.
    """
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
