# SPDX-License-Identifier: GPL-3.0-or-later
"""Replacements of the device around a single stream of the software N210."""

import numpy as np

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
