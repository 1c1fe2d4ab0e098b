# SPDX-License-Identifier: GPL-3.0-or-later
"""The survey of the room in the untouched reference of a run."""

from __future__ import annotations

import numpy as np

from ...estimation.group_tones import power_of
from ...estimation.groups import Array
from ...estimation.room.survey import LONGEST_S, SHORTEST_S, Survey, survey_folded
from ..plan import Plan

# Snapshots that are averaged before they are compared, as in frame_watch.h.
_BLOCK = 16
# Shares of the energy by squared correlation, as there: a static path leaves more than the first
# at the same sample, whatever moves beside it; a shift that explains a change leaves the second.
_IN_PLACE, _SAME = 0.7, 0.8


def without_slip(folded: Array) -> Array:
    """The longer part of folded frames (n, 64) on one side of a slip, if one is recognised."""
    blocks = len(folded) // _BLOCK
    if blocks < 4:
        return folded
    # Integers that are read as floats may be as large as single precision allows.
    means = folded[: blocks * _BLOCK].reshape(blocks, _BLOCK, -1).mean(axis=1, dtype=complex)
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


def surveyed_snapshots(plan: Plan) -> int:
    """Snapshots from the reference on that the room is surveyed in; 0 below 0.1 s."""
    period_s = plan.waveform.snapshot_period_s
    longest = int(min(plan.require_scene().reference_s, LONGEST_S) / period_s)
    if longest < 1:
        return 0
    # A power of two is quicker to transform.
    count = 1 << (longest.bit_length() - 1)
    return count if count * period_s >= SHORTEST_S else 0


def survey_reference(plan: Plan, snapshots: np.ndarray, folded: np.ndarray) -> Survey | None:
    """Survey the room in the longest run without gap or slip of the reference.

    ``snapshots`` (n,) rise from 0; ``folded`` (n, 64) may be of a ratio. None below 0.1 s.
    """
    count = surveyed_snapshots(plan)
    whole = (snapshots < count) & np.isfinite(folded).all(axis=1)
    if not whole.all():
        snapshots, folded = snapshots[whole], folded[whole]
    if not len(snapshots):
        return None
    runs = np.split(folded, np.flatnonzero(np.diff(snapshots) > 1) + 1)
    folded = without_slip(max(runs, key=len))
    mains_hz = plan.require_scene().environment.possible_mains_hz
    return survey_folded(folded, plan.waveform, plan.clocks, mains_hz)
