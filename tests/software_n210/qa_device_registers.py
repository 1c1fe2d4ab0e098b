# SPDX-License-Identifier: GPL-3.0-or-later
"""Registers, EEPROMs and device time of the software N210, as the driver accesses them."""

import struct

import pytest
from software_n210 import wire
from software_n210.hardware import DeviceClock
from software_n210.host.control import (
    Control,
    I2cBus,
    Registers,
    daughterboard_image,
    motherboard_image,
)
from software_n210.host.fifo import Fifo
from software_n210.wire import Malformed

SECOND = 100_000_000


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


def test_fifo_timed_command_holds_those_behind_it():
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
def test_fifo_malformed_command_refused(length):
    queue, _, pokes = fifo()
    with pytest.raises(Malformed):
        queue.submit(fifo_packet(1, 0x100 | 40, 5).ljust(32, b"\0")[:length], "host")
    assert queue.run() == [] and pokes == []


def test_clock_time_set_at_once_or_at_the_next_pulse():
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


def test_control_replies_carry_the_sequence_number():
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
def test_control_echo_has_the_requested_length(sent, wanted):
    reply = control().reply(request("l", struct.pack(">I", wanted), length=sent))
    assert len(reply) == wanted and struct.unpack_from(">I", reply, 12)[0] == sent


def test_control_too_large_frames_not_answered():
    device = control()
    assert device.reply(request("l", struct.pack(">I", 9001))) is None
    assert device.reply(request("l", struct.pack(">I", 36), length=9001)) is None


def test_control_eeproms_are_read_by_byte_and_protected():
    """A single crafted datagram once made every later session find another device."""
    device = control()

    def read(address, offset, count=1):
        device.reply(request("h", bytes([address, 1, offset])))
        return device.reply(request("i", bytes([address, count])))[14 : 14 + count]

    assert read(0x50, 0, 2) == b"\x11\x0a"  # N210 r4, little-endian
    assert read(0x50, 12, 4) == bytes([127, 0, 0, 9])
    board = read(0x55, 0, 20) + read(0x55, 20, 12)
    assert board[0] == 0xDB and board[1:3] == b"\x54\x00" and sum(board) % 256 == 0
    assert read(0x51, 0, 4) == b"\xff" * 4
    with pytest.raises(Malformed):
        device.reply(request("h", bytes([0x50, 2, 0, 42])))
    assert read(0x50, 0, 2) == b"\x11\x0a"


def test_control_firmware_words_that_describe_the_device_are_protected():
    device = control()
    for address in (3, 7):
        words = [struct.pack(">IIB", address, 99, action) for action in (5, 6, 5)]
        before, _, after = [device.reply(request("r", word))[12:] for word in words]
        assert before == after


def test_clock_at_the_end_of_its_range_starts_again():
    clock = DeviceClock()
    clock.poke(3, 1)
    clock.poke(1, 0xFFFFFFFF)
    clock.poke(0, 0xFFFFFFFF)
    assert clock.time == 2**64 - 1 and clock.to_ticks(3) == 4
    clock.advance(10)
    assert clock.time == 9 and clock.to_time(12) == 11 and clock.to_ticks(2**64 - 1) == 0


def test_control_zero_lock_time_ends_the_session():
    closed = []
    device = Control(Registers(DeviceClock()), I2cBus({}), lambda: closed.append(1))
    poke = struct.Struct(">IIB").pack
    for address, value in ((0, 77), (1, 0), (0, 5)):
        device.reply(request("r", poke(address, value, 6)))
    assert not closed
    device.reply(request("r", poke(0, 0, 6)))
    assert closed == [1]
    assert struct.unpack_from(">I", device.reply(request("r", poke(3, 0, 5))), 16)[0] == 0x1234ABCD
