# SPDX-License-Identifier: GPL-3.0-or-later
"""The FPGA's rate and scale registers, shared by receive and transmit."""

import math

from .wire import TICK_RATE

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
