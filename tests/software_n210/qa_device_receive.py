# SPDX-License-Identifier: GPL-3.0-or-later
"""The receive stream of the software N210: commands in, packets out."""

import struct

import numpy as np
import pytest
from device_parts import SPACING, Air, unit_gain
from software_n210 import wire
from software_n210.hardware import DeviceClock
from software_n210.host.control import Network
from software_n210.streams.receive import ReceiveChain


def receive_chain(clock=None):
    chain = ReceiveChain(clock or DeviceClock(), Air())
    unit_gain(chain)
    chain.poke(7, 100)
    return chain


def command(chain, word, time=0):
    chain.poke(0, word)
    chain.poke(1, time >> 32)
    chain.poke(2, time & 0xFFFFFFFF)


def packets(sent):
    """Packets in what a chain has to send: dicts of header fields and I values."""
    found = []
    for data, size in sent:
        for start in range(0, len(data), size):
            packet = data[start : start + size]
            header, stream, time = struct.unpack_from(">IIQ", packet)
            entry = {"count": header >> 16 & 15, "stream": stream, "time": time}
            assert header & 0xFFFF == len(packet) // 4
            if header >> 28 == 5:
                entry["error"] = struct.unpack_from(">I", packet, 16)[0]
            else:
                entry["i"] = np.frombuffer(packet[16:-4], ">i2")[::2].astype(int)
                entry["end"] = bool(struct.unpack(">I", packet[-4:])[0] & 0x100)
            found.append(entry)
    return found


NOW, CHAIN, RELOAD, STOP = 1 << 31, 1 << 30, 1 << 29, 1 << 28


def test_receive_finite_command_sends_n_samples_and_marks_the_last_packet():
    chain = receive_chain()
    command(chain, 250, time=1000)
    assert chain.run(0, 1000) == []
    got = packets(chain.run(1000, 100_000))
    assert [len(p["i"]) for p in got] == [100, 100, 50]
    assert [p["end"] for p in got] == [False, False, True]
    assert [p["count"] for p in got] == [0, 1, 2]
    assert [p["time"] for p in got] == [1000, 1000 + 100 * SPACING, 1000 + 200 * SPACING]
    assert np.array_equal(np.concatenate([p["i"] for p in got]), 125 + np.arange(250))
    assert not chain.waiting


@pytest.mark.parametrize("steps", [1, 7, 99, 800, 5003])
def test_receive_any_step_length_sends_the_same_packets(steps):
    whole, cut = receive_chain(), receive_chain()
    sent = []
    for chain in (whole, cut):
        command(chain, CHAIN | RELOAD | 1, time=40)
    expected = packets(whole.run(0, 20_000))
    for start in range(0, 20_000, steps):
        sent += cut.run(start, min(start + steps, 20_000))
    assert repr(packets(sent)) == repr(expected)


def test_receive_stop_command_ends_the_burst():
    chain = receive_chain()
    command(chain, NOW | CHAIN | RELOAD | 1)
    first = packets(chain.run(0, 1200))
    command(chain, NOW | STOP)
    rest = packets(chain.run(1200, 2400))
    assert [len(p["i"]) for p in first + rest] == [100, 50]
    assert rest[-1]["end"] and not chain.waiting
    # Between two packets there is no sample left to carry the end: one more is sent.
    command(chain, NOW | CHAIN | RELOAD | 1)
    chain.run(2400, 2400 + 800)
    command(chain, NOW | STOP)
    last = packets(chain.run(3200, 4000))
    assert [len(p["i"]) for p in last] == [1] and last[0]["end"]


def test_receive_chained_commands_join_and_broken_chain_is_reported():
    chain = receive_chain()
    command(chain, NOW | CHAIN | 150)
    command(chain, NOW | CHAIN | 150)
    got = packets(chain.run(0, 10_000))
    assert np.array_equal(np.concatenate([p["i"] for p in got if "i" in p]), np.arange(300))
    assert got[-1]["error"] == wire.RX_BROKEN_CHAIN and not chain.waiting


def test_receive_command_in_the_past_is_reported_late():
    clock = DeviceClock()
    clock.advance(5000)
    chain = receive_chain(clock)
    command(chain, 10, time=4999)
    (late,) = packets(chain.run(5000, 6000))
    assert late["error"] == wire.RX_LATE and not chain.waiting


def test_receive_overflow_reported_at_the_last_sample():
    chain = receive_chain()
    command(chain, NOW | CHAIN | RELOAD | 1)
    before = packets(chain.run(0, 1200))
    chain.overflow(30)
    got = before + packets(chain.run(1200, 2400))
    samples = [p for p in got if "i" in p]
    assert [len(p["i"]) for p in samples] == [100, 50, 100]
    assert got[2]["error"] == wire.RX_OVERFLOW and got[2]["time"] == 150 * SPACING
    assert samples[2]["i"][0] == 180 and samples[2]["time"] == 180 * SPACING
    chain.overflow(30, restart=False)
    assert packets(chain.run(2400, 9000))[-1]["error"] == wire.RX_OVERFLOW and not chain.waiting


def test_receive_lost_packets_keep_numbers_and_swapped_ones_exchange():
    chain = receive_chain()
    command(chain, NOW | CHAIN | RELOAD | 1)
    chain.packets.lose(2)
    chain.packets.swap()
    got = packets(chain.run(0, 800 * 6))
    assert [p["count"] for p in got] == [3, 2, 4, 5]
    assert [p["i"][0] for p in got] == [300, 200, 400, 500]


def test_network_cut_tears_one_packet_and_then_passes_nothing_until_it_ends():
    """A host must cope with a packet of which only the first half arrives."""
    now = [0.0]
    network = Network(lambda: now[0])
    assert network.passed(b"12345678") == b"12345678" and not network.is_cut
    network.cut(2.0)
    assert [network.passed(b"12345678") for _ in range(3)] == [b"1234", b"", b""]
    now[0] = 2.0
    assert network.passed(b"12345678") == b"12345678" and not network.is_cut
