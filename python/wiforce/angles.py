# SPDX-License-Identifier: GPL-3.0-or-later
"""Angles in degrees, modulo 360."""

import numpy as np


def wrap_deg(angle):
    """The same angle in (-180, 180]; shape kept."""
    return 180.0 - np.mod(180.0 - np.asarray(angle, float), 360.0)
