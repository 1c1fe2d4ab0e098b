# SPDX-License-Identifier: GPL-3.0-or-later
"""The N210's wire formats: ports, register numbers and packet layouts, all big-endian."""

import struct

TICK_RATE = 100_000_000

CONTROL_PORT = 49152
RX_PORT = 49156
TX_PORT = 49157
FIFO_PORT = 49159
# Of a second receive DSP and of a GPS receiver, which are absent.
UNUSED_PORTS = (49158, 49172)
ALL_PORTS = (CONTROL_PORT, RX_PORT, TX_PORT, FIFO_PORT, *UNUSED_PORTS)

# Setting registers, by index.
SR_TIME = 10
SR_SPI = 20
SR_RX_CONTROL = 32
SR_RX_DSP = 48
SR_TX_CONTROL = 144
SR_TX_DSP = 160
SR_GPIO = 184
SETTINGS_BASE = 0x7000
READBACK_BASE = 0x5C00

# Codes of a context packet on a receive stream.
RX_LATE = 0x2
RX_OVERFLOW = 0x8

# Events of a report on a transmit stream.
TX_FLOW = 0
TX_BURST_ACK = 1
TX_UNDERFLOW = 2
TX_SEQUENCE_ERROR = 4
TX_LATE = 8

# Of a packet's first word.
TYPE_MASK = 0xF0000000
HAS_TIME = 1 << 20
END_OF_BURST = 1 << 24
HAS_TRAILER = 1 << 26

RX_HEADER_WORDS = 4
RX_OVERHEAD_WORDS = RX_HEADER_WORDS + 1
_RX_DATA = 0x14100000
_RX_TRAILER = 0x00100000
_RX_TRAILER_END = 0x00000100
_CONTEXT = 0x50000000
_TIME_MASK = (1 << 64) - 1


class Malformed(ValueError):
    """A datagram that does not follow the protocol."""


def words(datagram, count):
    """The first `count` 32-bit words of a datagram; raises Malformed when it is shorter."""
    if len(datagram) < 4 * count:
        raise Malformed(f"{len(datagram)} bytes, at least {4 * count} required")
    return struct.unpack_from(f">{count}I", datagram)


def is_announcement(datagram):
    """Whether this is the 8-byte packet by which a host announces its address and port."""
    return len(datagram) == 8 and words(datagram, 2)[1] == 0


def rx_header(count, payload_words):
    return _RX_DATA | (count & 15) << 16 | (payload_words + RX_OVERHEAD_WORDS)


def rx_trailer(end_of_burst=False):
    return _RX_TRAILER | (_RX_TRAILER_END if end_of_burst else 0)


def rx_error(count, stream_id, time, code):
    """A receive stream's error packet; `time` in ticks."""
    header = _CONTEXT | HAS_TIME | (count & 15) << 16 | 5
    return struct.pack(">IIQI", header, stream_id, time & _TIME_MASK, code)


def tx_report(count, stream_id, time, event, sequence):
    """A transmit stream's report: flow control or event; `time` in ticks."""
    header = _CONTEXT | HAS_TIME | (count & 15) << 16 | 6
    return struct.pack(">IIQII", header, stream_id, time & _TIME_MASK, event, sequence)


def fifo_reply(sequence, control, value):
    """Acknowledgement of one FIFO command."""
    return struct.pack(">IIII", _CONTEXT | (sequence & 15) << 16 | 4, 0, control, value)
