# SPDX-License-Identifier: GPL-3.0-or-later
"""Detection of groups in which a press changed, by comparison with their neighbours."""

from __future__ import annotations

import numpy as np

from ..io.readings import Flag
from .groups import Array, Groups

# A press changed inside a group when |R| is below 0.97 of its neighbours' and the dip exceeds 3.5
# standard deviations. The mean of two phasors that differ by 28 deg has a magnitude of 0.97.
# docs/estimation.md, section "Thresholds", states what other values cost.
_DIP = 0.97
_DIP_STDS = 3.5
# Increase of the standard deviation over a neighbour's that shows another sensor's change. In
# steady groups it differs by a few per cent.
_DISTURBED = 1.5


class TransitionFlags:
    """Adds the flag ``transition``; a group is given when the following one has been received.

    Examples
    --------
    >>> level = np.array([1.0, 1.0, 0.9, 1.0, 1.0])
    >>> groups = Groups(
    ...     np.arange(5), ratios=np.stack([level, level], axis=1) + 0j,
    ...     phase_std_deg=np.full((5, 2), 0.1), touch=np.ones((5, 1), int),
    ...     flags=np.zeros((5, 1), int))
    >>> transitions = TransitionFlags()
    >>> flagged = Groups.concatenate([transitions.process(groups), transitions.flush()])
    >>> (flagged.flags[:, 0] == Flag.TRANSITION.value).tolist()
    [False, False, True, False, False]
    """

    def __init__(self) -> None:
        self._before: Groups | None = None  # the last group that was given
        self._waiting: Groups | None = None

    def process(self, groups: Groups) -> Groups:
        """Take a batch with ``touch`` and ``flags``; give the groups whose neighbours are known."""
        if not len(groups):
            return groups
        kept = [part for part in (self._before, self._waiting) if part is not None]
        window = Groups.concatenate([*kept, groups])
        first = 0 if self._before is None else 1
        flagged = _flagged(window)[first:-1]
        self._before = window[-2:-1] if len(window) > 1 else None
        self._waiting = window[-1:]
        return flagged

    def flush(self) -> Groups:
        """Give the last group, which has no later neighbour."""
        if self._waiting is None:
            return Groups(np.zeros(0, np.int64))
        kept = [part for part in (self._before, self._waiting) if part is not None]
        flagged = _flagged(Groups.concatenate(kept))[-1:]
        self._before = self._waiting = None
        return flagged


def _flagged(groups: Groups) -> Groups:
    """Groups with the flag; the first and last of them know one neighbour only."""
    count, sensors = groups.touch.shape
    adjacent = np.diff(groups.index) == 1
    # Row g: whether the previous and the next group are adjacent on the grid.
    beside = np.array([np.append(False, adjacent), np.append(adjacent, False)])
    levels = _neighbours(np.abs(groups.ratios))
    touches = _neighbours(groups.touch)
    std = _neighbours(groups.phase_std_deg)
    known = beside[:, :, None] & (touches >= 0)  # (2, G, S)
    touch = groups.touch
    edge = (known & (touches != touch)).any(axis=0) & (touch == 1)
    of_ends = np.repeat(known, 2, axis=2)
    lowest = np.min(np.where(of_ends, levels, np.inf), axis=0)
    level = np.abs(groups.ratios)
    with np.errstate(invalid="ignore"):
        dip = (level < _DIP * lowest) & (
            lowest - level > _DIP_STDS * np.radians(groups.phase_std_deg) * lowest
        )
    dip &= of_ends.any(axis=0)
    changed = edge | (dip.reshape(count, sensors, 2).any(axis=2) & (touch >= 0))
    values = np.concatenate([touch[None], np.where(known, touches, -1)])
    begins_or_ends = (values == 0).any(axis=0) & (values == 1).any(axis=0)
    # A change on one sensor disturbs the others, whose standard deviation then rises.
    disturbed = beside[:, :, None] & (groups.phase_std_deg > _DISTURBED * std)
    disturbed = disturbed.any(axis=0).reshape(count, sensors, 2).any(axis=2)
    anything = (changed | begins_or_ends).any(axis=1)[:, None]
    transition = (changed | (anything & disturbed)) & (touch >= 0)
    return groups.having(
        flags=np.where(transition, groups.flags | Flag.TRANSITION.value, groups.flags)
    )


def _neighbours(values: Array) -> Array:
    """Values of the previous and of the next group; shape (2, G, ...)."""
    shifted = np.empty((2, *values.shape), values.dtype)
    shifted[0, 1:], shifted[0, 0] = values[:-1], values[-1]
    shifted[1, :-1], shifted[1, -1] = values[1:], values[0]
    return shifted
