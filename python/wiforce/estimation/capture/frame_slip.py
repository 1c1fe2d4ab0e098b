# SPDX-License-Identifier: GPL-3.0-or-later
"""Slips of the frame timing among consecutive snapshots that nobody has noticed yet.

Samples that are lost without a trace shift all later frames. The fold recognises this after up to
a thousand frames and resynchronises (``lib/kernel/timing/frame_watch.h``); until then the static
path has moved to other samples, which to a survey of the room looks like a strong moving path.
"""

from __future__ import annotations

import numpy as np

from ..group_tones import power_of
from ..groups import Array

# Snapshots that are averaged before they are compared, as in frame_watch.h.
_BLOCK = 16
# Shares of the energy by squared correlation, as there: a static path leaves more than the first
# at the same sample, whatever moves beside it; a shift that explains a change leaves the second.
_IN_PLACE, _SAME = 0.7, 0.8


def without_slip(folded: Array) -> Array:
    """The longer part of a run of snapshots in which the frame timing slipped.

    Returns ndarray: all of them where there was none, or where no static path stands out by which
    it would be recognised.

    Parameters
    ----------
    folded : ndarray of complex, shape (n, 64)
        Consecutive folded frames, with at most one slip among them.
    """
    blocks = len(folded) // _BLOCK
    if blocks < 4:
        return folded
    means = folded[: blocks * _BLOCK].reshape(blocks, _BLOCK, -1).mean(axis=1)
    # A DC offset of the receiver does not move with the frames.
    sums = np.cumsum(means - means.mean(axis=1, keepdims=True), axis=0)
    # Two constant frames explain most energy when the change between them is where the slip is.
    count = np.arange(2, blocks - 1)
    before, behind = sums[count - 1], sums[-1] - sums[count - 1]
    explained = power_of(before).sum(axis=1) / count
    explained += power_of(behind).sum(axis=1) / (blocks - count)
    best = int(np.argmax(explained))
    matches = _matches(before[best], behind[best])
    if matches[0] > _IN_PLACE or matches.max() < _SAME:
        return folded
    # The slip lies in the block before this boundary, or in the one behind it.
    boundary = int(count[best])
    parts = folded[: (boundary - 1) * _BLOCK], folded[(boundary + 1) * _BLOCK :]
    return max(parts, key=len)


def _matches(first: Array, second: Array) -> Array:
    """Squared correlation of two frames at every cyclic shift; shape (64,)."""
    # In single precision, which NumPy 2 keeps, 1e-300 is 0.
    spectrum = np.fft.fft(first.astype(complex)).conj() * np.fft.fft(second.astype(complex))
    energy = float(power_of(first).sum() * power_of(second).sum())
    correlations: Array = power_of(np.fft.ifft(spectrum)) / max(energy, 1e-300)
    return correlations
