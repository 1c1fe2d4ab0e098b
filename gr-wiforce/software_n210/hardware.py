# SPDX-License-Identifier: GPL-3.0-or-later
"""Clock and hardware of the device, as the host programs them."""

import time

from .control import (
    DAUGHTERBOARD_RX,
    DAUGHTERBOARD_TX,
    MOTHERBOARD,
    Control,
    Fifo,
    I2cBus,
    Registers,
    daughterboard_image,
    motherboard_image,
)
from .frontend import DAUGHTERBOARDS, FrontEnd
from .receive import ReceiveChain
from .transmit import TransmitChain
from .wire import (
    SR_GPIO,
    SR_RX_CONTROL,
    SR_RX_DSP,
    SR_SPI,
    SR_TX_CONTROL,
    SR_TX_DSP,
    TICK_RATE,
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

    @property
    def time(self):
        """Device time in ticks."""
        return (self.ticks + self.offset) % _TIME_SPAN

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
            self.last_pulse = (pulse + self.offset) % _TIME_SPAN
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


# A step of streaming fits a receive buffer of the usual size several times over.
_STEP_SAMPLES = 32_000
_IDLE_STEP_TICKS = 10_000_000


class Hardware:
    """Registers, streams and air of one device, at an ``address`` that its EEPROM states.

    ``origin`` is the tick of the first sample received in this session.
    """

    def __init__(self, air, address, board, tx_socket_bytes=None, on_close=lambda: None):
        self.air = air
        self.clock = air.clock = DeviceClock()
        self.transmit = TransmitChain(self.clock, air, tx_socket_bytes)
        self.receive = ReceiveChain(self.clock, air)
        self.front_end = air.front_end = FrontEnd(DAUGHTERBOARDS[board], self.transmit.dsp)
        self.origin = None
        self._cut_until_s = -float("inf")
        self._on_close = on_close
        registers = self._registers()
        self.fifo = Fifo(registers, self.clock)
        self.control = Control(registers, _i2c_bus(address, board), self._end_session)

    def cut(self, seconds):
        """Let nothing pass between host and device for some wall time."""
        self._cut_until_s = time.monotonic() + seconds

    @property
    def is_cut(self):
        """Whether nothing passes now."""
        return time.monotonic() < self._cut_until_s

    @property
    def streaming(self):
        """Whether a stream runs or is queued in either direction."""
        return self.transmit.busy or self.receiving

    @property
    def receiving(self):
        """Whether a received stream runs or is queued."""
        return self.receive.waiting

    @property
    def longest_step(self):
        """Ticks that one step may take, so that its packets fit the host's socket."""
        busy = [self.receive] * self.receiving + [self.transmit] * self.transmit.busy
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

    def run(self, start, end):
        """Let both directions run up to ``end``; packets to send, and the size of each."""
        self.transmit.run(start, end)
        packets = self.receive.run(start, end)
        if self.origin is None:
            self.origin = self.receive.stream_start
        return packets

    def advance(self, tick):
        """Move the clock to `tick`, up to which everything has run."""
        self.clock.advance(tick)
        self.air.forget(tick)

    def status(self):
        """State and counters as a dict of plain values."""
        return {
            "device_time_s": self.clock.time / TICK_RATE,
            "streaming_s": 0.0
            if self.origin is None
            else (self.clock.ticks - self.origin) / TICK_RATE,
            "rx_streaming": self.receive.active,
            "tx_streaming": self.transmit.in_burst,
            "tx_carrier_hz": self.front_end.tx_carrier_hz,
            "rx_carrier_hz": self.front_end.rx_carrier_hz(self.receive.dsp),
            "tx_gain_db": self.front_end.tx_gain_db,
            "rx_gain_db": self.front_end.rx_gain_db,
            "rx_dropped_samples": self.receive.dropped_samples,
            "rx_dropped_packets": self.receive.packets.dropped_packets,
            "tx_underflows": self.transmit.underflows,
            "tx_late_packets": self.transmit.late_packets,
            "tx_sequence_errors": self.transmit.sequence_errors,
            **self.air.status(),
        }

    def _registers(self):
        registers = Registers(self.clock)
        registers.attach(SR_SPI, 3, self.front_end.poke_spi)
        registers.attach(SR_GPIO, 5, self.front_end.poke_gpio)
        registers.attach(SR_TX_CONTROL, 6, self.transmit.poke)
        registers.attach(SR_TX_DSP, 3, self.transmit.dsp.poke)
        registers.attach(SR_RX_CONTROL, 9, self.receive.poke)
        registers.attach(SR_RX_DSP, 3, self.receive.dsp.poke)
        return registers

    def _end_session(self):
        """Return to the state after power-on, for the next host."""
        self.receive.stop()
        self.receive.stream_start = None
        self.origin = None
        self.air.restart()
        self._on_close()


def _i2c_bus(address, board):
    boards = DAUGHTERBOARDS[board]
    serial = "".join(f"{int(part):02x}" for part in address.split("."))
    return I2cBus(
        {
            MOTHERBOARD: motherboard_image(address, serial),
            DAUGHTERBOARD_RX: daughterboard_image(boards.rx_id),
            DAUGHTERBOARD_TX: daughterboard_image(boards.tx_id),
        }
    )
