# SPDX-License-Identifier: GPL-3.0-or-later
"""The daughterboard, an SBX, converters, and the cable between the connectors."""

import math
from collections import deque

import numpy as np
from gnuradio.wiforce.errors import InputError

from .wire import TICK_RATE

# Gain in the middle of the board's range, for both directions.
REFERENCE_GAIN_DB = 15.0
_GPIO_RX_ONLY, _GPIO_TX_ONLY = 1, 2
_SPI_CONTROL, _SPI_DATA = 1, 2
_SPI_RX, _SPI_TX, _SPI_ADC = 16, 128, 256
_ADC_FINE_GAIN, _ADC_GAIN_CORRECTION = 0x17, 0x1A


def _attenuator_half_db(pins):
    """Gain of the 6-bit attenuator on pins 8..13, in dB; its code counts half decibels."""
    return (pins >> 8 & 0x3F) / 2


class Synthesizer:
    """An ADF4350: frequency from its register writes."""

    def __init__(self):
        self._registers = [0] * 8

    def write(self, word):
        """Write a register; the low three bits of the 32-bit word select it."""
        self._registers[word & 7] = word

    @property
    def frequency_hz(self):
        """Output frequency with the device's 100 MHz reference; 0 before it is programmed."""
        r0, r1, r2, _, r4, *_ = self._registers
        modulus, divider = r1 >> 3 & 0xFFF, r2 >> 14 & 0x3FF
        if not modulus or not divider:
            return 0.0
        doubler, halver = r2 >> 25 & 1, r2 >> 24 & 1
        phase_detector_hz = TICK_RATE * (1 + doubler) / (divider * (1 + halver))
        frequency = phase_detector_hz * ((r0 >> 15 & 0xFFFF) + (r0 >> 3 & 0xFFF) / modulus)
        feedback_before_divider = r4 >> 23 & 1
        return frequency / (1 << (r4 >> 20 & 7)) if feedback_before_divider else frequency


class FrontEnd:
    """Oscillators and gains of the device, set through its SPI and GPIO blocks and its DSPs."""

    def __init__(self, tx_dsp):
        self._tx_dsp = tx_dsp
        self._synthesizers = {_SPI_RX: Synthesizer(), _SPI_TX: Synthesizer()}
        self._adc = {}  # registers of the ADS62P44 converter
        self._spi_control = 0
        self._pins = [0] * 5

    def poke_spi(self, register, value):
        """Write to the SPI block: register 1 selects chip and length, register 2 sends a word."""
        if register == _SPI_CONTROL:
            self._spi_control = value
        elif register == _SPI_DATA:
            select, bits = self._spi_control & 0xFFFFFF, self._spi_control >> 24 & 0x3F
            if select in self._synthesizers and bits == 32:
                self._synthesizers[select].write(value)
            elif select == _SPI_ADC and bits == 16:
                self._adc[value >> 24] = value >> 16 & 0xFF

    def poke_gpio(self, register, value):
        """Write to the GPIO block: pins in one of four modes, those of TX in the high half."""
        self._pins[register] = value

    @property
    def tx_carrier_hz(self):
        return self._synthesizers[_SPI_TX].frequency_hz + self._tx_dsp.frequency_hz

    def rx_carrier_hz(self, rx_dsp):
        return self._synthesizers[_SPI_RX].frequency_hz - rx_dsp.frequency_hz

    @property
    def tx_gain_db(self):
        return _attenuator_half_db(self._pins[_GPIO_TX_ONLY] >> 16)

    @property
    def rx_gain_db(self):
        """Gain of the attenuator and of the converter, in steps of 0.5 dB and 0.05 dB."""
        fine = self._adc.get(_ADC_FINE_GAIN, 0) & 15
        correction = self._adc.get(_ADC_GAIN_CORRECTION, 0) & 15
        attenuator_db = _attenuator_half_db(self._pins[_GPIO_RX_ONLY] & 0xFFFF)
        return attenuator_db + 0.5 * fine + 0.05 * correction

    def to_receive_carrier(self, samples, chain, tick, spacing):
        """Transmit baseband at a receive chain's carrier, complex64; zero out of band."""
        offset_hz = self.tx_carrier_hz - self.rx_carrier_hz(chain.dsp)
        if offset_hz == 0:
            return samples
        bandwidth_hz = TICK_RATE / chain.dsp.ticks_per_sample
        if abs(offset_hz) >= (bandwidth_hz + TICK_RATE / self._tx_dsp.ticks_per_sample) / 2:
            return np.zeros_like(samples)
        turns_per_tick = offset_hz / TICK_RATE
        turns = turns_per_tick * tick % 1 + turns_per_tick * spacing * np.arange(len(samples))
        return (samples * np.exp(2j * np.pi * turns)).astype(np.complex64)


FULL_SCALE = 32767
_UNIT_SCALE = 131072


class DspRegisters:
    """Frequency, scale and rate of a converter; the CIC filter's gain has a power of 4 or 3."""

    def __init__(self, cic_power):
        self._cic_power = cic_power
        self._frequency_word = 0
        self._scale = _UNIT_SCALE
        self._rate_word = 1

    def poke(self, register, value):
        """Write register 0 (frequency), 1 (scale) or 2 (rate); others do not affect samples."""
        if register == 0:
            self._frequency_word = value - (1 << 32) if value >> 31 else value
        elif register == 1:
            self._scale = value & 0x3FFFF
        elif register == 2:
            self._rate_word = value

    @property
    def frequency_hz(self):
        """Frequency shift by the CORDIC, signed."""
        return self._frequency_word / (1 << 32) * TICK_RATE

    @property
    def _cic(self):
        return (self._rate_word & 0xFF) or 256

    @property
    def ticks_per_sample(self):
        """Ticks between samples: the decimation or interpolation."""
        half_bands = (self._rate_word >> 8 & 1) + (self._rate_word >> 9 & 1)
        return self._cic << half_bands

    @property
    def gain(self):
        """Amplitude on the wire over that at the converter: the rounding of the scale register."""
        cic_gain = self._cic**self._cic_power
        adjustment = 2 ** math.ceil(math.log2(cic_gain)) / (1.65 * cic_gain)
        return self._scale / (_UNIT_SCALE * adjustment)


class SampleHistory:
    """Recent samples on the device's time line; zero where there are none."""

    def __init__(self):
        self._segments = deque()

    def append(self, tick, spacing, samples):
        self._segments.append((tick, spacing, samples))

    def forget(self, tick):
        while self._segments:
            start, spacing, samples = self._segments[0]
            if start + (len(samples) + 1) * spacing > tick:
                break
            self._segments.popleft()

    def take(self, tick, spacing, count):
        """`count` samples from `tick` on, every `spacing` ticks, of those with this spacing."""
        out = np.zeros(count, np.complex64)
        for start, step, samples in self._segments:
            first = (tick - start + step // 2) // step
            low, high = max(0, -first), min(count, len(samples) - first)
            if step == spacing and low < high:
                out[low:high] = samples[first + low : first + high]
        return out


class Cable:
    """A cable between the connectors, of unit gain at 0 dB each, with the device's own delay.

    ``front_end`` is that of the device that it is connected to.
    """

    def __init__(self, delay_ticks):
        self._delay = delay_ticks
        self._sent = SampleHistory()
        self.front_end = None

    def restart(self):
        self._sent = SampleHistory()

    def forget(self, tick):
        self._sent.forget(tick - self._delay)

    def transmit(self, tick, spacing, samples):
        """Take samples that are transmitted from `tick` on; complex64, 1.0 at full scale."""
        self._sent.append(tick, spacing, samples * amplitude(self.front_end.tx_gain_db))

    def receive(self, chain, tick, spacing, count):
        """Samples that are received from `tick` on; complex64, 1.0 at full scale."""
        samples = self._sent.take(tick - self._delay, spacing, count)
        samples = self.front_end.to_receive_carrier(samples, chain, tick, spacing)
        return samples * amplitude(self.front_end.rx_gain_db)

    def status(self):
        return {}

    def sensor(self, name):
        """A sensor on the air; InputError for another name."""
        raise InputError("sensor", "requires --air scene", name)


def amplitude(db):
    """Amplitude ratio of a level in dB; float32."""
    return np.float32(10 ** (db / 20))
