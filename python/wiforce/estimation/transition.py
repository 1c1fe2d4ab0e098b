# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a press changed inside a group, which shows against its neighbours."""

from __future__ import annotations

import numpy as np

from ..io.readings import Flag
from .groups import Array, Groups

# |R| below this part of its neighbours' says that the press changed inside the group ...
_DIP = 0.97
# ... when the dip is above so many standard deviations of the noise.
_CERTAIN = 3.5
# Standard deviation over a neighbour's from which another sensor's change shows in a group.
_DISTURBED = 1.5


class TransitionFlags:
    """Adds the flag ``transition``; a group leaves when the one behind it has come."""

    def __init__(self) -> None:
        self._before: Groups | None = None  # the last group that was given
        self._waiting: Groups | None = None

    def process(self, groups: Groups) -> Groups:
        """Take a batch that was read; give the groups whose neighbours are known."""
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
        """Give the group that waits for its neighbour."""
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
    # Row g: whether the group before and the one behind are neighbours.
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
            lowest - level > _CERTAIN * np.radians(groups.phase_std_deg) * lowest
        )
    dip &= of_ends.any(axis=0)
    changed = edge | (dip.reshape(count, sensors, 2).any(axis=2) & (touch >= 0))
    values = np.concatenate([touch[None], np.where(known, touches, -1)])
    begins_or_ends = (values == 0).any(axis=0) & (values == 1).any(axis=0)
    # One sensor's change disturbs what is read of the others: they are less certain beside it.
    disturbed = beside[:, :, None] & (groups.phase_std_deg > _DISTURBED * std)
    disturbed = disturbed.any(axis=0).reshape(count, sensors, 2).any(axis=2)
    anything = (changed | begins_or_ends).any(axis=1)[:, None]
    doubtful = (changed | (anything & disturbed)) & (touch >= 0)
    return groups.having(
        flags=np.where(doubtful, groups.flags | Flag.TRANSITION.value, groups.flags)
    )


def _neighbours(values: Array) -> Array:
    """Values of the group before and of the one behind; shape (2, G, ...)."""
    return np.stack([np.roll(values, 1, axis=0), np.roll(values, -1, axis=0)])
