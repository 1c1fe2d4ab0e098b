# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise in H on each subcarrier, estimated from the residual of the least-squares fit.

It is the same in all groups, except where a transmitter on a few subcarriers interferes with some
of them. The estimate itself is a kernel (``noise_estimate.h``); here is the first one of a block.
"""

from __future__ import annotations

import numpy as np

from ...wiforce_kernels import raised_subcarriers
from ..groups import Array


def robust_noise(residuals: Array, freedom: int) -> Array:
    """Mean (K,) of the residuals (G, K) without subcarriers that are raised in some groups."""
    quartile = np.sort(residuals, axis=0)[len(residuals) // 4]
    if not np.all(quartile > 0):
        return np.asarray(residuals.mean(axis=0))
    # The quartile of 12 groups lies below the mean, by about one standard deviation of a ratio.
    inverse = (1 - 0.7 * freedom**-0.5) / quartile if freedom > 1 else 0.3 / quartile
    kept = raised_subcarriers(residuals * inverse, freedom) == 1
    if kept.all():
        return np.asarray(residuals.mean(axis=0))
    return np.asarray(np.sum(residuals * kept, axis=0) / np.maximum(kept.sum(axis=0), 1))
