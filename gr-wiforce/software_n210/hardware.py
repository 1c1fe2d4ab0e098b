# SPDX-License-Identifier: GPL-3.0-or-later
"""Clock, registers, EEPROM and control of the device, as the host programs them."""

import ipaddress
import struct
from collections import deque

from .frontend import FrontEnd
from .receive import ReceiveChain
from .transmit import TransmitChain
from .wire import (
    HAS_TIME,
    READBACK_BASE,
    SETTINGS_BASE,
    SR_GPIO,
    SR_RX_CONTROL,
    SR_RX_DSP,
    SR_SPI,
    SR_TIME,
    SR_TX_CONTROL,
    SR_TX_DSP,
    TICK_RATE,
    TYPE_MASK,
    Malformed,
    fifo_reply,
    words,
)

# Device time is a counter of 64 bits: a host may set it right before its end.
_TIME_SPAN = 1 << 64


class DeviceClock:
    """Ticks at 100 MHz, which never decrease, and device time, ``ticks + offset``, with pulses."""

    def __init__(self):
        self.ticks = 0
        self.offset = 0
        self.last_pulse = 0
        self._low = 0
        self._immediate = False
        self._at_pulse = None

    def to_ticks(self, time):
        """Ticks since power-on of a device time."""
        since = (time - self.offset) % _TIME_SPAN
        return since - _TIME_SPAN if since >= _TIME_SPAN // 2 else since

    def to_time(self, ticks):
        """Device time of a tick since power-on."""
        return (ticks + self.offset) % _TIME_SPAN

    def advance(self, ticks):
        """Advance to `ticks`, and set a time that waits for a pulse per second in between."""
        pulse = ticks // TICK_RATE * TICK_RATE
        if pulse > self.ticks:
            if self._at_pulse is not None:
                self.offset = self._at_pulse - pulse
                self._at_pulse = None
            self.last_pulse = self.to_time(pulse)
        self.ticks = ticks

    def poke(self, register, value):
        """Write register 0..5 of the time block: 0 high word (latches), 1 low, 3 immediate."""
        if register == 1:
            self._low = value
        elif register == 3:
            self._immediate = bool(value & 1)
        elif register == 0:
            time = value << 32 | self._low
            if self._immediate:
                self.offset = time - self.ticks
                self._at_pulse = None
            else:
                self._at_pulse = time


_COMPATIBILITY = (11 << 16) | 1
_REFERENCE_LOCKED = 1 << 11
_ALL_ONES = 0xFFFFFFFF


class Registers:
    """Setting registers by index, readback words by index."""

    def __init__(self, clock, *blocks):
        """``blocks``: base, count, and a function of register - base and value, of each."""
        self._clock = clock
        self._blocks = (SR_TIME, 6, clock.poke), *blocks

    def poke(self, index, value):
        """Write a setting register; registers without a block are ignored."""
        for base, count, poke in self._blocks:
            if base <= index < base + count:
                poke(index - base, value)

    def peek(self, index):
        if index in (10, 11):
            return _word(self._clock.to_time(self._clock.ticks), index - 10)
        if index in (14, 15):
            return _word(self._clock.last_pulse, index - 14)
        # Word 9, the daughterboards' pins, reads all ones: every oscillator is locked.
        return {0: 0, 8: 0, 12: _COMPATIBILITY, 13: _REFERENCE_LOCKED}.get(index, _ALL_ONES)


def _word(value, low):
    return (value if low else value >> 32) & _ALL_ONES


MOTHERBOARD = 0x50
DAUGHTERBOARD_TX = 0x54
DAUGHTERBOARD_RX = 0x55

_N210_R4, _SBX_RX, _SBX_TX = 0x0A11, 0x0054, 0x0055
_SIZE = 256


def motherboard_image(address, serial):
    """EEPROM of an N210 r4 at the given IPv4 address; 256 bytes."""
    image = bytearray(b"\xff" * _SIZE)
    packed = ipaddress.IPv4Address(address).packed
    struct.pack_into("<H", image, 0, _N210_R4)
    image[2:8] = b"\x02\x00" + packed
    image[8:12] = bytes([255, 0, 0, 0])
    image[12:16] = packed
    struct.pack_into("<HH", image, 18, 4, _N210_R4)
    image[23] = 0
    image[24:33] = serial.encode("ascii")[:9].ljust(9, b"\0")
    image[33:56] = bytes(23)  # no name
    image[56:60] = packed
    return image


def daughterboard_image(board_id):
    """EEPROM of a daughterboard with this id; 256 bytes, of which 32 are used."""
    image = bytearray(32)
    image[0] = 0xDB
    struct.pack_into("<H", image, 1, board_id)
    image[9:18] = b"1".ljust(9, b"\0")  # its serial number
    image[31] = -sum(image[:31]) & 0xFF
    return image + bytearray(b"\xff" * (_SIZE - 32))


class I2cBus:
    """EEPROMs by address, which identify the device, and so are protected against any peer."""

    def __init__(self, address):
        serial = "".join(f"{int(part):02x}" for part in address.split("."))
        self._images = {
            MOTHERBOARD: motherboard_image(address, serial),
            DAUGHTERBOARD_RX: daughterboard_image(_SBX_RX),
            DAUGHTERBOARD_TX: daughterboard_image(_SBX_TX),
        }
        self._pointers = dict.fromkeys(self._images, 0)

    def write(self, address, data):
        """The first byte sets the pointer; raises Malformed when bytes to be stored follow."""
        if address not in self._images or not data:
            return
        if len(data) > 1:
            raise Malformed(f"write to the protected EEPROM at {address:#x}")
        self._pointers[address] = data[0]

    def read(self, address, count):
        """At most 20 bytes from the pointer on, else Malformed; erased where nobody answers."""
        if count > 20:
            raise Malformed(f"I2C read of {count} bytes")
        image = self._images.get(address)
        if image is None:
            return b"\xff" * count
        start = self._pointers[address]
        self._pointers[address] = (start + count) % len(image)
        return bytes(image[(start + i) % len(image)] for i in range(count))


PROTOCOL_VERSION = 12
_HEAD = struct.Struct(">III")
_MESSAGE_SIZE = 36
_MAX_FRAME = 9000
_PEEK_FIRMWARE, _POKE_FIRMWARE = 5, 6
_PEEKS, _POKES = (1, 2), (3, 4)
_FIRMWARE_LOCK_TIME, _FIRMWARE_LOCK_OWNER = 0, 1
_FIRMWARE_HAS_GPSDO = 3
_FIRMWARE_MINOR = 7
_NO_GPSDO = 0x1234ABCD


class Control:
    """Answers requests on the control port; ``on_close`` when the host releases its lock."""

    def __init__(self, registers, bus, on_close):
        self._registers = registers
        self._bus = bus
        self._on_close = on_close
        self._firmware = {_FIRMWARE_HAS_GPSDO: _NO_GPSDO, _FIRMWARE_MINOR: 4}
        self._handlers = {
            "a": lambda body, _: bytes(24),  # a hello
            "l": self._echo,
            "i": lambda body, _: body[:2] + self._bus.read(*body[:2]),
            "h": self._i2c_write,
            "s": lambda body, _: body,
            "r": self._register,
        }

    def reply(self, request):
        """The reply to a datagram, or None; Malformed when it does not follow the protocol."""
        if len(request) < _MESSAGE_SIZE:
            if len(request) == 16:
                return None  # the X300 driver searches for its devices at this port
            raise Malformed(f"control request of {len(request)} bytes")
        version, code, sequence = _HEAD.unpack_from(request)
        # A host that does not know our version yet is sent a hello, whatever it requested.
        name = chr(code & 0x7F) if version == PROTOCOL_VERSION else "a"
        handler = self._handlers.get(name)
        if handler is None:
            return _HEAD.pack(PROTOCOL_VERSION, ord(" "), sequence) + bytes(24)
        body = handler(request[12:_MESSAGE_SIZE], request)
        if body is None:
            return None
        head = _HEAD.pack(PROTOCOL_VERSION, ord(name.upper()), sequence)
        return head + body.ljust(24, b"\0")

    def _echo(self, body, request):
        wanted = struct.unpack_from(">I", body)[0]
        if max(wanted, len(request)) > _MAX_FRAME:
            return None
        return struct.pack(">I", len(request)).ljust(max(wanted - 12, 24), b"\0")

    def _i2c_write(self, body, _):
        address, count = body[0], min(body[1], 20)
        self._bus.write(address, body[2 : 2 + count])
        return body

    def _register(self, body, _):
        address, value, action = struct.unpack_from(">IIB", body)
        if action == _PEEK_FIRMWARE:
            value = self._firmware.get(address, 0)
        elif action == _POKE_FIRMWARE:
            # The other words describe the device and must outlast a session.
            if address in (_FIRMWARE_LOCK_TIME, _FIRMWARE_LOCK_OWNER):
                self._firmware[address] = value
            if address == _FIRMWARE_LOCK_TIME and value == 0:
                self._on_close()
        elif action in _PEEKS:
            value = self._registers.peek((address - READBACK_BASE) // 4)
        elif action in _POKES and address >= SETTINGS_BASE:
            self._registers.poke((address - SETTINGS_BASE) // 4, value)
        return struct.pack(">IIB", address, value, action)


# Of a command: a write, its packet's type, and how many may wait.
_POKE = 1 << 8
_TYPE_CONTEXT = 0x40000000
_MOST_COMMANDS = 4096


class Fifo:
    """The queue of commands; a timed command holds all commands behind it."""

    def __init__(self, registers, clock):
        self._registers = registers
        self._clock = clock
        # Of each: device time in ticks or None, peer, sequence, control word and value.
        self._queue = deque()
        self.clear = self._queue.clear

    def submit(self, datagram, peer):
        """Queue the command in a datagram; Malformed when it is none, or the queue is full."""
        sequence, header = words(datagram, 2)
        if header & TYPE_MASK != _TYPE_CONTEXT:
            raise Malformed(f"command header 0x{header:08x}")
        timed = bool(header & HAS_TIME)
        layout = struct.Struct(">QII" if timed else ">II")
        if len(datagram) != 8 + layout.size:
            raise Malformed(f"command of {len(datagram)} bytes")
        if len(self._queue) >= _MOST_COMMANDS:
            raise Malformed("command queue is full")
        *time, control, value = layout.unpack_from(datagram, 8)
        self._queue.append((time[0] if timed else None, peer, sequence, control, value))

    def next_tick(self):
        """Tick at which the first command is due, or None when it is untimed or there is none."""
        time = self._queue[0][0] if self._queue else None
        return None if time is None else self._clock.to_ticks(time)

    def run(self):
        """Execute all commands that are due; list of (reply, peer)."""
        replies = []
        while self._queue:
            due = self.next_tick()
            if due is not None and due > self._clock.ticks:
                break
            _, peer, sequence, control, written = self._queue.popleft()
            index, read = control & 0xFF, 0
            if control & _POKE:
                self._registers.poke(index, written)
            else:
                read = self._registers.peek(index)
            replies.append((fifo_reply(sequence, control, read), peer))
        return replies


# A step of streaming fits a receive buffer of the usual size several times over.
_STEP_SAMPLES = 32_000
_IDLE_STEP_TICKS = 10_000_000


class Hardware:
    """Registers, streams and air of one device, at an ``address`` that its EEPROM states."""

    def __init__(self, air, address, tx_socket_bytes):
        self.air = air
        self.clock = DeviceClock()
        self.transmit = TransmitChain(self.clock, air, tx_socket_bytes)
        self.receive = ReceiveChain(self.clock, air)
        self.front_end = air.front_end = FrontEnd(self.transmit.dsp)
        registers = Registers(
            self.clock,
            (SR_SPI, 3, self.front_end.poke_spi),
            (SR_GPIO, 5, self.front_end.poke_gpio),
            (SR_TX_CONTROL, 6, self.transmit.poke),
            (SR_TX_DSP, 3, self.transmit.dsp.poke),
            (SR_RX_CONTROL, 9, self.receive.poke),
            (SR_RX_DSP, 3, self.receive.dsp.poke),
        )
        self.fifo = Fifo(registers, self.clock)
        self.control = Control(registers, I2cBus(address), self._end_session)

    @property
    def streaming(self):
        """Whether a stream runs or is queued in either direction."""
        return self.transmit.busy or self.receive.waiting

    @property
    def longest_step(self):
        """Ticks that one step may take, so that its packets fit the host's socket."""
        busy = [self.receive] * self.receive.waiting + [self.transmit] * self.transmit.busy
        spacings = [chain.dsp.ticks_per_sample for chain in busy]
        return min((_STEP_SAMPLES * spacing for spacing in spacings), default=_IDLE_STEP_TICKS)

    def next_event(self, start, end):
        """First tick up to `end` at which a command acts or a reception is complete."""
        ticks = [end]
        command = self.fifo.next_tick()
        if command is not None:
            ticks.append(max(command, start))
        finished = self.receive.finish_tick()
        if finished is not None and finished > start:
            ticks.append(finished)
        return min(ticks)

    def status(self):
        begun = self.receive.stream_start
        return {
            "device_time_s": self.clock.to_time(self.clock.ticks) / TICK_RATE,
            "streaming_s": 0.0 if begun is None else (self.clock.ticks - begun) / TICK_RATE,
            "rx_streaming": self.receive.active,
            "tx_streaming": self.transmit.in_burst,
            "tx_carrier_hz": self.front_end.tx_carrier_hz,
            "rx_carrier_hz": self.front_end.rx_carrier_hz(self.receive.dsp),
            "tx_gain_db": self.front_end.tx_gain_db,
            "rx_gain_db": self.front_end.rx_gain_db,
            "rx_dropped_samples": self.receive.dropped_samples,
            "rx_dropped_packets": self.receive.packets.dropped_packets,
            **self.transmit.counts,
            **self.air.status(),
        }

    def _end_session(self):
        """Return to the state after power-on, for the next host."""
        self.receive.stop()
        self.receive.packets.ready.clear()
        self.receive.stream_start = None
        self.air.restart()
