# SPDX-License-Identifier: GPL-3.0-or-later
"""Carriers and their phases: angles modulo 360 deg, when two carriers are the same."""

import numpy as np

SPEED_OF_LIGHT_M_S = 299_792_458.0
# A sensor's phases at a carrier hold this far around it; channels of a band lie further apart.
_TOLERANCE = 1e-3


def same_carrier(frequency_hz, carrier_hz):
    """Whether a frequency, or each of an array, is that carrier."""
    return np.abs(frequency_hz - carrier_hz) <= _TOLERANCE * carrier_hz


def wrap_deg(angle):
    """The same angle in (-180, 180]; shape kept."""
    return 180.0 - np.mod(180.0 - np.asarray(angle, float), 360.0)
