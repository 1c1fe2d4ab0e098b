# SPDX-License-Identifier: GPL-3.0-or-later
"""The transmit stream of the software N210: packets in, bursts and reports out."""

import struct

import numpy as np
import pytest
from device_parts import SPACING, Air, unit_gain
from software_n210 import wire
from software_n210.hardware import DeviceClock
from software_n210.streams.transmit import TransmitChain
from software_n210.wire import Malformed


def tx_packet(sequence, values, time=None, start=True, end=True):
    """A data packet with these I values, Q being their negative."""
    pairs = np.stack([values, -np.asarray(values)], axis=1).astype(">i2").tobytes()
    timing = b"" if time is None else struct.pack(">Q", time)
    words = 2 + len(timing) // 4 + len(pairs) // 4
    header = wire.HAS_TRAILER | words | (wire.HAS_TIME if timing else 0)
    header |= (wire.START_OF_BURST if start else 0) | (wire.END_OF_BURST if end else 0)
    return struct.pack(">II", sequence, header) + timing + pairs + bytes(4)


def transmit_chain():
    chain = TransmitChain(DeviceClock(), Air())
    unit_gain(chain)
    return chain


def events(chain):
    """Event words and consumed sequence numbers of the reports that are due."""
    return [struct.unpack_from(">IIQII", report)[3:] for report in chain.flow.take()]


@pytest.mark.parametrize("step", [8, 50, 333, 4000])
def test_transmit_timed_burst_starts_at_its_tick_for_any_step(step):
    chain = transmit_chain()
    chain.accept(tx_packet(0, range(1, 101), time=1000, end=False))
    # The host puts a time on every packet: inside a burst it means nothing.
    chain.accept(tx_packet(1, range(101, 151), time=77, start=False))
    for start in range(0, 4000, step):
        chain.run(start, min(start + step, 4000))
    given = chain._air.given
    sent = np.zeros(4000 // SPACING, complex)
    for tick, samples in given:
        sent[tick // SPACING :][: len(samples)] = samples
    expected = np.zeros(4000 // SPACING, complex)
    expected[125:275] = np.arange(1, 151) * (1 - 1j)
    assert np.array_equal(sent, expected)
    assert events(chain) == [(wire.TX_BURST_ACK, 1)]


def test_transmit_underflow_and_late_burst_are_reported():
    chain = transmit_chain()
    chain.accept(tx_packet(0, range(10), end=False))
    chain.run(0, 1000)
    assert events(chain) == [(wire.TX_UNDERFLOW, 0)]
    chain.accept(tx_packet(1, range(10), time=999))
    chain.run(1000, 2000)
    assert events(chain) == [(wire.TX_LATE, 1)] and not chain.busy
    assert (chain.underflows, chain.late_packets) == (1, 1)
    assert sum(len(samples) for _, samples in chain._air.given) == 10


def test_transmit_late_burst_with_next_burst_policy_is_dropped_whole():
    chain = transmit_chain()
    chain.poke(3, 4)  # policy: go on with the next burst
    chain._clock.advance(1000)
    chain.accept(tx_packet(0, range(10), time=999, end=False))
    chain.accept(tx_packet(1, range(10), time=5000, start=False))
    chain.accept(tx_packet(2, range(7), time=2000))
    chain.run(1000, 9000)
    assert [(tick, len(samples)) for tick, samples in chain._air.given] == [(2000, 7)]


def test_transmit_late_packets_are_dropped_while_device_time_is_held():
    """They filled the window of a host that was to catch up meanwhile, which never did."""
    chain = transmit_chain()
    chain._clock.advance(1000)
    for sequence, time in enumerate((200, 600, 2000)):
        chain.accept(tx_packet(sequence, range(10), time=time))
    chain.discard_late(1000)
    assert events(chain) == [(wire.TX_LATE, 0), (wire.TX_LATE, 1)]
    chain.run(1000, 3000)
    assert [tick for tick, _ in chain._air.given] == [2000]


def test_transmit_consumed_packets_acknowledged_by_number_and_time():
    chain = transmit_chain()
    chain.poke(5, 1 << 31 | 3)
    for sequence in range(7):
        chain.accept(tx_packet(sequence, range(10), start=sequence == 0, end=sequence == 6))
    chain.run(0, 7000)
    acknowledged = [(wire.TX_FLOW, 2), (wire.TX_FLOW, 5), (wire.TX_BURST_ACK, 6)]
    assert events(chain) == acknowledged
    chain.poke(4, 1 << 31 | 1000)
    chain._clock.advance(999)
    assert events(chain) == [(wire.TX_FLOW, 6)]
    assert events(chain) == []
    chain._clock.advance(1999)
    assert events(chain) == [(wire.TX_FLOW, 6)]


@pytest.mark.parametrize("socket_bytes, at_once", [(8 << 20, 128), (425_984, 25), (50_000, 2)])
def test_transmit_window_fits_the_socket(socket_bytes, at_once):
    """The driver sends up to 2^20 bytes, 128 of its packets here, more than it saw acknowledged."""
    chain = TransmitChain(DeviceClock(), Air(), socket_bytes)
    unit_gain(chain)
    chain.poke(5, 1 << 31 | 16)
    acknowledged, sent = 0, 0
    while sent < 300:
        for _, sequence in events(chain):
            acknowledged = sequence - (1 << 32 if sequence >> 31 else 0)
        count = acknowledged + 128 - sent
        assert 0 < count <= at_once
        for _ in range(count):
            chain.accept(tx_packet(sent, range(10), start=sent == 0, end=False))
            sent += 1
        chain.run(chain._clock.ticks, chain.covered_until(1 << 40))
    assert chain.sequence_errors == chain.underflows == 0


def test_transmit_sequence_gap_reported_except_after_reset():
    chain = transmit_chain()
    chain.accept(tx_packet(0, range(10)))
    chain.accept(tx_packet(2, range(10)))
    assert events(chain) == [(wire.TX_SEQUENCE_ERROR, 0)] and chain.sequence_errors == 1
    chain.poke(0, 1)
    assert not chain.busy
    chain.accept(tx_packet(77, range(10)))
    assert events(chain) == []


def test_transmit_covered_until_ends_at_the_last_queued_sample():
    chain = transmit_chain()
    assert chain.covered_until(9000) == 9000
    chain.accept(tx_packet(0, range(100), time=1000, end=False))
    assert chain.covered_until(1500) == 1500
    assert chain.covered_until(9000) == 1000 + 100 * SPACING
    chain.accept(tx_packet(1, range(50), start=False))
    assert chain.covered_until(9000) == 9000  # between bursts nothing is missing
    chain.accept(tx_packet(2, range(10), time=4000, end=False))
    assert chain.covered_until(9000) == 4000 + 10 * SPACING


@pytest.mark.parametrize(
    "datagram",
    [b"", bytes(7), bytes(8), struct.pack(">II", 0, 0x10000003) + bytes(8)]
    + [struct.pack(">II", 0, 9) + bytes(8), tx_packet(0, range(3), time=1)[:-8]],
)
def test_transmit_malformed_packet_refused(datagram):
    chain = transmit_chain()
    with pytest.raises(Malformed):
        chain.accept(datagram)
    assert not chain.busy
