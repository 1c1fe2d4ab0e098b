# SPDX-License-Identifier: GPL-3.0-or-later
"""Carriers and their phases: angles modulo 360 deg, and when two carriers are the same."""

import numpy as np
from numpy.typing import ArrayLike

SPEED_OF_LIGHT_M_S = 299_792_458.0
# Lowest and highest carrier of scenes and of what is calibrated for them, in Hz.
CARRIERS_HZ = 1e6, 100e9
# Relative distance within which a sensor's phases at a carrier are taken as valid: 0.9 MHz at
# 900 MHz. Channels that are calibrated separately lie further apart.
_TOLERANCE = 1e-3


def same_carrier(frequency_hz: ArrayLike, carrier_hz: float) -> np.ndarray:
    """Whether frequencies lie so close to a carrier, within 0.1 %, that its phases apply."""
    return np.abs(np.asarray(frequency_hz) - carrier_hz) <= _TOLERANCE * carrier_hz


def wrap_deg(angle: ArrayLike) -> np.ndarray:
    """Wrap angles in degrees into (-180, 180]."""
    return 180.0 - np.mod(180.0 - np.asarray(angle, float), 360.0)
