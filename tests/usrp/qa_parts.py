# SPDX-License-Identifier: GPL-3.0-or-later
"""The parts of the software N210 one by one, without sockets: bytes in, bytes out."""

import socket
import struct
from collections import deque

import numpy as np
import pytest
from gnuradio.wiforce.errors import InputError
from software_n210 import wire
from software_n210.air import Cable
from software_n210.clock import DeviceClock
from software_n210.control import Control
from software_n210.eeprom import I2cBus, daughterboard_image, motherboard_image
from software_n210.faults import FaultQueue, parse_fault
from software_n210.fifo import Fifo
from software_n210.frontend import Synthesizer
from software_n210.history import SampleHistory
from software_n210.pacing import HostBacklog, Throttle, WallClock
from software_n210.receive import ReceiveChain
from software_n210.registers import Registers
from software_n210.transmit import TransmitChain
from software_n210.wire import Malformed

SECOND = 100_000_000
CIC_2_BOTH_HALF_BANDS = 0x302
SPACING = 8  # ticks per sample at that rate


class Air:
    """Counts what it is asked for; remembers what it is given."""

    def __init__(self):
        self.given = []

    def receive(self, chain, tick, spacing, count):
        numbers = (tick // spacing + np.arange(count)) % 30000
        return (numbers / 32767 + 0j).astype(np.complex64)

    def transmit(self, tick, spacing, samples):
        self.given.append((tick, np.rint(samples * 32767).astype(np.complex64)))


def unit_gain(chain):
    """The scale word that makes a chain's gain 1 at CIC 2: 2^17 x 1/1.65."""
    chain.dsp.poke(2, CIC_2_BOTH_HALF_BANDS)
    chain.dsp.poke(1, round((1 << 17) / 1.65))


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


def test_a_command_for_n_samples_gives_n_and_the_last_packet_says_so():
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
def test_the_length_of_the_loop_s_steps_is_not_to_be_seen(steps):
    whole, cut = receive_chain(), receive_chain()
    sent = []
    for chain in (whole, cut):
        command(chain, CHAIN | RELOAD | 1, time=40)
    expected = packets(whole.run(0, 20_000))
    for start in range(0, 20_000, steps):
        sent += cut.run(start, min(start + steps, 20_000))
    assert repr(packets(sent)) == repr(expected)


def test_a_continuous_stream_stops_when_told_with_an_end_of_burst():
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


def test_chained_commands_join_without_a_gap_and_a_broken_chain_is_told():
    chain = receive_chain()
    command(chain, NOW | CHAIN | 150)
    command(chain, NOW | CHAIN | 150)
    got = packets(chain.run(0, 10_000))
    assert np.array_equal(np.concatenate([p["i"] for p in got if "i" in p]), np.arange(300))
    assert got[-1]["error"] == wire.RX_BROKEN_CHAIN and not chain.waiting


def test_a_command_for_the_past_is_late_and_does_nothing():
    clock = DeviceClock()
    clock.advance(5000)
    chain = receive_chain(clock)
    command(chain, 10, time=4999)
    (late,) = packets(chain.run(5000, 6000))
    assert late["error"] == wire.RX_LATE and not chain.waiting


def test_an_overflow_is_reported_where_the_samples_end():
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


def test_lost_packets_are_counted_and_swapped_ones_change_places():
    chain = receive_chain()
    command(chain, NOW | CHAIN | RELOAD | 1)
    chain.packets.lose(2)
    chain.packets.swap()
    got = packets(chain.run(0, 800 * 6))
    assert [p["count"] for p in got] == [3, 2, 4, 5]
    assert [p["i"][0] for p in got] == [300, 200, 400, 500]


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
def test_a_burst_goes_on_the_air_at_its_time_whatever_the_step(step):
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


def test_a_burst_that_runs_dry_and_one_that_comes_late_are_reported():
    chain = transmit_chain()
    chain.accept(tx_packet(0, range(10), end=False))
    chain.run(0, 1000)
    assert events(chain) == [(wire.TX_UNDERFLOW, 0)]
    chain.accept(tx_packet(1, range(10), time=999))
    chain.run(1000, 2000)
    assert events(chain) == [(wire.TX_LATE, 1)] and not chain.busy
    assert (chain.underflows, chain.late_packets) == (1, 1)
    assert sum(len(samples) for _, samples in chain._air.given) == 10


def test_a_burst_that_comes_late_is_dropped_as_a_whole_when_the_host_wants_it_so():
    chain = transmit_chain()
    chain.poke(3, 4)  # policy: go on with the next burst
    chain._clock.advance(1000)
    chain.accept(tx_packet(0, range(10), time=999, end=False))
    chain.accept(tx_packet(1, range(10), time=5000, start=False))
    chain.accept(tx_packet(2, range(7), time=2000))
    chain.run(1000, 9000)
    assert [(tick, len(samples)) for tick, samples in chain._air.given] == [(2000, 7)]


def test_consumed_packets_are_acknowledged_in_number_and_in_time():
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
def test_a_host_sends_no_more_at_once_than_the_socket_holds(socket_bytes, at_once):
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


def test_a_gap_in_the_numbers_is_an_error_but_not_after_a_reset():
    chain = transmit_chain()
    chain.accept(tx_packet(0, range(10)))
    chain.accept(tx_packet(2, range(10)))
    assert events(chain) == [(wire.TX_SEQUENCE_ERROR, 0)] and chain.sequence_errors == 1
    chain.poke(0, 1)
    assert not chain.busy
    chain.accept(tx_packet(77, range(10)))
    assert events(chain) == []


def test_how_far_the_queued_samples_reach():
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
def test_what_is_no_data_packet_is_refused(datagram):
    chain = transmit_chain()
    with pytest.raises(Malformed):
        chain.accept(datagram)
    assert not chain.busy


def fifo():
    clock, pokes = DeviceClock(), []
    registers = Registers(clock)
    registers.attach(40, 2, lambda register, value: pokes.append((register, value)))
    return Fifo(registers, clock), clock, pokes


def fifo_packet(sequence, control, value, time=None):
    header = 0x40000000 | (wire.HAS_TIME if time is not None else 0)
    timing = b"" if time is None else struct.pack(">Q", time)
    control |= sequence << 16
    return struct.pack(">II", sequence, header) + timing + struct.pack(">II", control, value)


def test_commands_act_in_order_and_a_timed_one_holds_those_behind_it():
    queue, clock, pokes = fifo()
    queue.submit(fifo_packet(1, 0x100 | 40, 5), "host")
    queue.submit(fifo_packet(2, 0x100 | 41, 6, time=1000), "host")
    queue.submit(fifo_packet(3, 11, 0), "host")
    replies = queue.run()
    assert pokes == [(0, 5)] and queue.next_tick() == 1000
    clock.advance(999)
    assert queue.run() == []
    clock.advance(1000)
    replies += queue.run()
    assert pokes == [(0, 5), (1, 6)]
    unpacked = [struct.unpack(">IIII", reply) for reply, peer in replies]
    assert [fields[2] >> 16 for fields in unpacked] == [1, 2, 3]
    assert [fields[3] for fields in unpacked] == [0, 0, 1000]  # the last one read the time
    assert [fields[0] for fields in unpacked] == [0x50010004, 0x50020004, 0x50030004]


@pytest.mark.parametrize("length", [0, 4, 8, 12, 20, 24])
def test_what_is_no_command_is_refused(length):
    queue, _, pokes = fifo()
    with pytest.raises(Malformed):
        queue.submit(fifo_packet(1, 0x100 | 40, 5).ljust(32, b"\0")[:length], "host")
    assert queue.run() == [] and pokes == []


def test_device_time_is_set_at_once_or_at_the_next_pulse():
    clock = DeviceClock()
    clock.advance(SECOND // 2)
    for register, value in ((1, 500), (3, 1), (0, 1)):
        clock.poke(register, value)
    assert clock.time == (1 << 32) + 500
    for register, value in ((1, 7), (3, 0), (0, 0)):
        clock.poke(register, value)
    clock.advance(SECOND - 1)
    assert clock.time == (1 << 32) + 499 + SECOND // 2
    clock.advance(SECOND + 3)
    assert clock.time == 10 and clock.last_pulse == 7
    clock.advance(2 * SECOND)
    assert clock.last_pulse == 7 + SECOND


def control(closed=None):
    images = {0x50: motherboard_image("127.0.0.9", "abc"), 0x55: daughterboard_image(0x54)}
    registers = Registers(DeviceClock())
    return Control(registers, I2cBus(images), closed.append if closed is not None else lambda: 0)


def request(code, body=b"", version=12, length=36):
    head = struct.pack(">III", version, ord(code), 99)
    return (head + body).ljust(length, b"\0")


def test_requests_are_answered_under_their_number():
    device = control()
    for code, answer in (("a", "A"), ("s", "S"), ("x", " ")):
        reply = device.reply(request(code))
        assert struct.unpack_from(">III", reply) == (12, ord(answer), 99) and len(reply) == 36
    # A driver that doesn't know the version yet is greeted, whatever it asked for.
    assert device.reply(request("r", version=0))[4:8] == struct.pack(">I", ord("A"))
    assert device.reply(bytes(16)) is None
    with pytest.raises(Malformed):
        device.reply(bytes(20))


@pytest.mark.parametrize("sent, wanted", [(36, 36), (1472, 36), (60, 8000), (8972, 9000)])
def test_frame_sizes_are_measured_both_ways(sent, wanted):
    reply = control().reply(request("l", struct.pack(">I", wanted), length=sent))
    assert len(reply) == wanted and struct.unpack_from(">I", reply, 12)[0] == sent


def test_too_large_frames_are_not_answered():
    device = control()
    assert device.reply(request("l", struct.pack(">I", 9001))) is None
    assert device.reply(request("l", struct.pack(">I", 36), length=9001)) is None


def test_eeproms_are_read_and_written_byte_by_byte():
    device = control()

    def read(address, offset, count=1):
        device.reply(request("h", bytes([address, 1, offset])))
        return device.reply(request("i", bytes([address, count])))[14 : 14 + count]

    assert read(0x50, 0, 2) == b"\x11\x0a"  # N210 r4, little-endian
    assert read(0x50, 12, 4) == bytes([127, 0, 0, 9])
    board = read(0x55, 0, 20) + read(0x55, 20, 12)
    assert board[0] == 0xDB and board[1:3] == b"\x54\x00" and sum(board) % 256 == 0
    assert read(0x51, 0, 4) == b"\xff" * 4
    device.reply(request("h", bytes([0x50, 2, 200, 42])))
    assert read(0x50, 200) == b"\x2a"


def test_the_last_lock_write_says_that_the_host_has_gone():
    closed = []
    device = Control(Registers(DeviceClock()), I2cBus({}), lambda: closed.append(1))
    poke = struct.Struct(">IIB").pack
    for address, value in ((0, 77), (1, 0), (0, 5)):
        device.reply(request("r", poke(address, value, 6)))
    assert not closed
    device.reply(request("r", poke(0, 0, 6)))
    assert closed == [1]
    assert struct.unpack_from(">I", device.reply(request("r", poke(3, 0, 5))), 16)[0] == 0x1234ABCD


@pytest.mark.parametrize(
    "registers, frequency_hz",
    [
        # R = 2, INT = 49, FRAC/MOD = 1/4: 50 MHz x 49.25; the divider is inside the loop.
        ([49 << 15 | 1 << 3, 4 << 3 | 1, 2 << 14 | 2, 3, 1 << 20 | 4, 5], 2462.5e6),
        # The same with feedback from before the output divider by 4.
        ([49 << 15 | 1 << 3, 4 << 3 | 1, 2 << 14 | 2, 3, 1 << 23 | 2 << 20 | 4, 5], 615.625e6),
        # Doubled and halved reference: 100 MHz x 2 / (4 x 2) = 25 MHz x 40.
        ([40 << 15, 2 << 3 | 1, 1 << 25 | 1 << 24 | 4 << 14 | 2, 3, 4, 5], 1000e6),
    ],
)
def test_a_synthesizer_s_registers_give_its_frequency(registers, frequency_hz):
    chip = Synthesizer()
    assert chip.frequency_hz == 0
    for word in reversed(registers):
        chip.write(word)
    assert chip.frequency_hz == pytest.approx(frequency_hz, rel=1e-12)


def test_samples_are_found_at_their_ticks_also_at_another_rate():
    history = SampleHistory()
    history.append(1000, 8, np.arange(1, 11).astype(np.complex64))
    history.append(2000, 8, np.full(3, 50, np.complex64))
    assert np.array_equal(history.take(984, 8, 5).real, [0, 0, 1, 2, 3])
    assert np.array_equal(history.take(1003, 8, 3).real, [1, 2, 3])  # the nearest
    assert np.array_equal(history.take(1000, 16, 6).real, [1, 3, 5, 7, 9, 0])
    assert np.array_equal(history.take(1000, 4, 4).real, [1, 2, 2, 3])
    assert np.array_equal(history.take(1992, 8, 5).real, [0, 50, 50, 50, 0])
    history.forget(1500)
    assert not history.take(1000, 8, 10).any() and history.take(2000, 8, 3).all()


def test_a_cable_forgets_what_can_no_longer_arrive():
    cable = Cable(delay_ticks=512)
    for tick in range(0, 800_000, 8000):
        cable._sent.append(tick, 8, np.ones(1000, np.complex64))
        cable.forget(tick)
    assert len(cable._sent._segments) <= 3


def test_device_time_never_runs_ahead_and_never_catches_up():
    now = [100.0]
    clock = WallClock(speed=0.5, now=lambda: now[0])
    assert clock.allowance(0) == 0
    now[0] += 0.01
    assert clock.allowance(0) == 500_000
    assert clock.allowance(500_000) == 0
    now[0] += 10  # a pause of the whole machine
    assert clock.allowance(500_000) == 1_000_000  # 20 ms of wall time
    now[0] += 0.001
    assert clock.allowance(1_500_000) == 50_000


class Backlog:
    def __init__(self, values):
        self.values = deque(values)

    def read(self, peer):
        return self.values[0] if len(self.values) == 1 else self.values.popleft()


def test_a_slow_host_is_waited_for_and_a_deaf_one_is_not():
    now = [0.0]
    throttle = Throttle(Backlog([0, 170_000, 200_000]), now=lambda: now[0])
    assert throttle.room("host", 1472) == 180_000 // 2304
    assert throttle.room("host", 1472) == 4
    assert throttle.room("host", 1472) == 0
    now[0] += 0.29
    assert throttle.room("host", 1472) == 0
    now[0] += 0.02
    assert throttle.room("host", 1472) > 0
    assert Throttle(Backlog([None])).room("host", 1472) is None


def test_missing_transmit_samples_hold_device_time_for_a_while():
    now = [0.0]
    throttle = Throttle(None, now=lambda: now[0])
    throttle.tx_arrived()
    assert throttle.transmit_until(covered=900, start=0, end=900) == 900
    assert throttle.transmit_until(covered=300, start=0, end=900) == 0  # more will come
    now[0] += 0.01
    assert throttle.transmit_until(covered=300, start=0, end=900) == 300
    now[0] += 0.3
    assert throttle.transmit_until(covered=300, start=0, end=900) == 900  # an underflow then
    assert throttle.transmit_until(covered=900, start=0, end=900) == 900
    now[0] += 10  # what lacks only now is waited for, whenever the last samples came
    assert throttle.transmit_until(covered=300, start=0, end=900) == 0


def test_what_waits_in_a_socket_is_read_from_the_kernel():
    backlog = HostBacklog()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        peer = sock.getsockname()
        assert backlog.read(peer) == 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(bytes(1472), peer)
        assert 1472 <= backlog.read(peer) <= 4096
        sock.recv(2000)
        assert backlog.read(peer) == 0
    assert backlog.read(peer) is None
    backlog.close()


def test_faults_come_at_their_time_in_order():
    clock, origin = DeviceClock(), None
    clock.poke(1, 50)
    clock.poke(3, 1)
    clock.poke(0, 0)  # device time is 50 ticks ahead
    faults = [parse_fault(t) for t in ("+0.000001 swap", "0.000002 lose 3", "0.000001 late rx")]
    queue = FaultQueue()
    for fault in faults:
        queue.add(fault)
    assert queue.next_tick(clock, origin) == 50
    clock.advance(150)
    assert [fault.kind for fault in queue.due(clock, origin)] == ["late", "lose"]
    assert queue.next_tick(clock, origin) is None
    assert queue.next_tick(clock, 1000) == 1100
    clock.advance(1100)
    assert [fault.kind for fault in queue.due(clock, 1000)] == ["swap"]


@pytest.mark.parametrize(
    "text",
    ["", "1", "x swap", "-1 swap", "1 swap 3", "nan lose 1", "1 clock arm fast", "1 clock arm nan"],
)
def test_faults_that_make_no_sense_are_refused(text):
    with pytest.raises(InputError, match="--fault"):
        parse_fault(text)
