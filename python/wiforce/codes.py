# SPDX-License-Identifier: GPL-3.0-or-later
"""Complex samples as a converter gives them: pairs of 16-bit integers."""

import numpy as np

FULL_SCALE = 32768


def samples_of(codes):
    """Complex samples (n,), full scale 1 per component, of codes (n, 2) or I Q I Q (2n,)."""
    return (np.asarray(codes).astype(np.float32) / FULL_SCALE).view(np.complex64).ravel()
