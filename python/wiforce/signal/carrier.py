# SPDX-License-Identifier: GPL-3.0-or-later
"""Carriers: angles modulo 360 deg, when two are the same, and which bands hold a signal."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .waveform import Waveform

SPEED_OF_LIGHT_M_S = 299_792_458.0
VACUUM_PERMITTIVITY_F_M = 8.8541878128e-12  # CODATA 2018
# Lowest and highest carrier of scenes and of what is calibrated for them, in Hz.
CARRIERS_HZ = 1e6, 100e9
# Relative distance within which a sensor's phases at a carrier are taken as valid: 0.9 MHz at
# 900 MHz. Channels that are calibrated separately lie further apart.
CARRIER_TOLERANCE = 1e-3


def same_carrier(frequency_hz: ArrayLike, carrier_hz: float) -> np.ndarray:
    """Whether frequencies lie so close to a carrier, within 0.1 %, that its phases apply."""
    return np.abs(np.asarray(frequency_hz) - carrier_hz) <= CARRIER_TOLERANCE * carrier_hz


def wrap_deg(angle: ArrayLike) -> np.ndarray:
    """Wrap angles in degrees into (-180, 180]."""
    return 180.0 - np.mod(180.0 - np.asarray(angle, float), 360.0)


class Band(NamedTuple):
    """A frequency band, by its edges."""

    low_hz: float
    high_hz: float

    def holds(self, low_hz: float, high_hz: float) -> bool:
        """Whether all frequencies from ``low_hz`` to ``high_hz`` lie inside."""
        return self.low_hz <= low_hz and high_hz <= self.high_hz


# Only the edges are compared. Power, power density, duty cycle and channels are limited as well,
# by the rules named here; docs/reference/scenes.md says so.
BANDS = {
    # 47 CFR 15.247(a): 902-928, 2400-2483.5 and 5725-5850 MHz.
    "us-902-928": Band(902e6, 928e6),
    "us-2400-2483.5": Band(2400e6, 2483.5e6),
    "us-5725-5850": Band(5725e6, 5850e6),
    # ERC Recommendation 70-03, annex 1 (short range devices), with EN 300 220-2 below 1 GHz and
    # EN 300 440 above.
    "eu-433.05-434.79": Band(433.05e6, 434.79e6),
    "eu-863-870": Band(863e6, 870e6),
    "eu-5725-5875": Band(5725e6, 5875e6),
    # ERC Recommendation 70-03, annex 3 (wideband data transmission), with EN 300 328.
    "eu-2400-2483.5": Band(2400e6, 2483.5e6),
}


def occupied_band_hz(carrier_hz: float, waveform: Waveform) -> tuple[float, float]:
    """Lowest and highest frequency that a signal occupies, by its outermost subcarriers."""
    edges = waveform.outermost_hz
    return carrier_hz + edges[0], carrier_hz + edges[1]
