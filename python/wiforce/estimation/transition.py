# SPDX-License-Identifier: GPL-3.0-or-later
"""Detection of groups in which a press changed, by comparison with their neighbours."""

from __future__ import annotations

from typing import NamedTuple

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

    Where a touch begins on every sensor that is received, the flag is certain whatever follows, and
    the group is given at once.

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
        self._before: _Window | None = None  # the last group that was given
        self._waiting: Groups | None = None

    def process(self, groups: Groups) -> Groups:
        """Take a batch with ``touch`` and ``flags``; give the groups whose neighbours are known."""
        if not len(groups):
            return groups
        kept = [] if self._waiting is None else [self._waiting]
        before = self._before if self._waiting is None else _Window.of(self._waiting)
        last = _Window.of(groups[-1:])
        if _begins(_Window.of(groups[-2:-1]) if len(groups) > 1 else before, last):
            given, self._waiting = Groups.concatenate([*kept, groups]), None
            flagged = self._flagged(given, _Window.of(given))
            self._before = last
            return flagged
        # One group at a time is given as it was kept, without copies of its arrays.
        given = Groups.concatenate([*kept, groups[:-1]])
        self._waiting = groups[-1:]
        if not len(given):
            return given
        window = _Window.of(given).join(last)
        flagged = self._flagged(given, window)
        self._before = window.rows(slice(-2, -1))
        return flagged

    def flush(self) -> Groups:
        """Give the last group, which has no later neighbour."""
        if self._waiting is None:
            return Groups(np.zeros(0, np.int64))
        flagged = self._flagged(self._waiting, _Window.of(self._waiting))
        self._before = self._waiting = None
        return flagged

    def _flagged(self, groups: Groups, window: _Window) -> Groups:
        """Groups with the flag; the window holds them and what is known of the next one."""
        first = 0 if self._before is None else 1
        if self._before is not None:
            window = self._before.join(window)
        rows = _changes(window)[first : first + len(groups)]
        return groups.having(flags=groups.flags | rows * Flag.TRANSITION.value)


class _Window(NamedTuple):
    """What decides on the flag, of groups that follow each other: arrays of shape (G, ...)."""

    number: Array
    level: Array
    std_deg: Array
    touch: Array

    @staticmethod
    def of(groups: Groups) -> _Window:
        return _Window(groups.index, np.abs(groups.ratios), groups.phase_std_deg, groups.touch)

    def join(self, after: _Window) -> _Window:
        return _Window(*map(np.concatenate, zip(self, after, strict=True)))

    def rows(self, rows: slice) -> _Window:
        return _Window(*(values[rows] for values in self))


def _begins(before: _Window | None, group: _Window) -> bool:
    """Whether a touch begins in a group on every sensor that is received."""
    if before is None or group.number[0] - before.number[0] != 1:
        return False
    begins = (before.touch == 0) & (group.touch == 1)
    return bool(begins.any() and np.all(begins | (group.touch < 0)))


def _changes(groups: _Window) -> Array:
    """Groups in which a press changed, (G, S); the first and last know one neighbour only."""
    count, sensors = groups.touch.shape
    adjacent = np.diff(groups.number) == 1
    # Row g: whether the previous and the next group are adjacent on the grid.
    beside = np.array([np.append(False, adjacent), np.append(adjacent, False)])
    level = groups.level
    levels = _neighbours(level)
    touches = _neighbours(groups.touch)
    std = _neighbours(groups.std_deg)
    known = beside[:, :, None] & (touches >= 0)  # (2, G, S)
    touch = groups.touch
    edge = (known & (touches != touch)).any(axis=0) & (touch == 1)
    of_ends = np.repeat(known, 2, axis=2)
    lowest = np.min(np.where(of_ends, levels, np.inf), axis=0)
    with np.errstate(invalid="ignore"):
        dip = (level < _DIP * lowest) & (
            lowest - level > _DIP_STDS * np.radians(groups.std_deg) * lowest
        )
    dip &= of_ends.any(axis=0)
    changed = edge | (dip.reshape(count, sensors, 2).any(axis=2) & (touch >= 0))
    values = np.concatenate([touch[None], np.where(known, touches, -1)])
    begins_or_ends = (values == 0).any(axis=0) & (values == 1).any(axis=0)
    # A change on one sensor disturbs the others, whose standard deviation then rises.
    disturbed = beside[:, :, None] & (groups.std_deg > _DISTURBED * std)
    disturbed = disturbed.any(axis=0).reshape(count, sensors, 2).any(axis=2)
    anything = (changed | begins_or_ends).any(axis=1)[:, None]
    transition: Array = (changed | (anything & disturbed)) & (touch >= 0)
    return transition


def _neighbours(values: Array) -> Array:
    """Values of the previous and of the next group; shape (2, G, ...)."""
    shifted = np.empty((2, *values.shape), values.dtype)
    shifted[0, 1:], shifted[0, 0] = values[:-1], values[-1]
    shifted[1, :-1], shifted[1, -1] = values[1:], values[0]
    return shifted
