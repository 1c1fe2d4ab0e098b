# SPDX-License-Identifier: GPL-3.0-or-later
"""Carriers and gains of the device, and the frequency shift between its two directions."""

import numpy as np

from ..wire import TICK_RATE


class Tuning:
    """Carriers and gains of the device, from its front end and its DSPs."""

    def __init__(self, front_end, tx_dsp):
        self._front_end = front_end
        self._tx_dsp = tx_dsp

    @property
    def tx_carrier_hz(self):
        return self._front_end.tx_lo_hz + self._tx_dsp.frequency_hz

    def rx_carrier_hz(self, rx_dsp):
        return self._front_end.rx_lo_hz - rx_dsp.frequency_hz

    @property
    def reference_gain_db(self):
        """Gain in the middle of the board's range, for both directions."""
        return self._front_end.reference_gain_db

    @property
    def tx_gain_db(self):
        return self._front_end.tx_gain_db

    @property
    def rx_gain_db(self):
        return self._front_end.rx_gain_db

    def to_receive_carrier(self, samples, chain, tick, spacing):
        """Transmit baseband, shifted to a receive chain's carrier; complex64.

        A signal outside the receive band becomes zero; one across its edge is kept whole.
        """
        offset_hz = self.tx_carrier_hz - self.rx_carrier_hz(chain.dsp)
        if offset_hz == 0:
            return samples
        bandwidth_hz = TICK_RATE / chain.dsp.ticks_per_sample
        if abs(offset_hz) >= (bandwidth_hz + TICK_RATE / self._tx_dsp.ticks_per_sample) / 2:
            return np.zeros_like(samples)
        turns_per_tick = offset_hz / TICK_RATE
        turns = turns_per_tick * tick % 1 + turns_per_tick * spacing * np.arange(len(samples))
        return (samples * np.exp(2j * np.pi * turns)).astype(np.complex64)
