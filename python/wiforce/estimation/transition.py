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
        self._waiting: Groups | None = None
        # The last two groups that were given and the one that waits, as far as there are any.
        self._window: _Window | None = None

    def process(self, groups: Groups) -> Groups:
        """Take a batch with ``touch`` and ``flags``; give the groups whose neighbours are known."""
        if not len(groups):
            return groups
        window = _Window.of(groups)
        if self._window is not None:
            window = self._window.join(window)
        kept = [] if self._waiting is None else [self._waiting]
        # One group at a time is given as it was kept, without copies of its arrays.
        if window.begins():
            given, self._waiting = Groups.concatenate([*kept, groups]), None
            known = 2
        else:
            before = [*kept, groups[:-1]] if len(groups) > 1 else kept
            given, self._waiting = Groups.concatenate(before), groups[-1:]
            known = 3
        first = len(window) - len(kept) - len(groups)
        self._window = window.last(known)
        return _flagged(given, window, first) if len(given) else given

    def flush(self) -> Groups:
        """Give the last group, which has no later neighbour."""
        given, window = self._waiting, self._window
        self._waiting = self._window = None
        if given is None or window is None:
            return Groups(np.zeros(0, np.int64))
        return _flagged(given, window, len(window) - 1)


class _Window(NamedTuple):
    """What decides on the flag, of G groups that follow each other.

    Attributes
    ----------
    number : ndarray of int, shape (G,)
        Indices of the groups.
    values : ndarray, shape (G, 5S)
        Magnitude of R and standard deviation of its phase of 2S ends, touch of S sensors.
    """

    number: Array
    values: Array

    @staticmethod
    def of(groups: Groups) -> _Window:
        ratios, std_deg, touch = groups.ratios, groups.phase_std_deg, groups.touch
        return _Window(groups.index, np.concatenate([np.abs(ratios), std_deg, touch], axis=1))

    def __len__(self) -> int:
        return len(self.number)

    @property
    def sensors(self) -> int:
        """S."""
        return self.values.shape[1] // 5

    def join(self, after: _Window) -> _Window:
        return _Window(
            np.concatenate([self.number, after.number]), np.concatenate([self.values, after.values])
        )

    def last(self, count: int) -> _Window:
        return _Window(self.number[-count:], self.values[-count:])

    def begins(self) -> bool:
        """Whether a touch begins in the last group on every sensor that is received."""
        if len(self.number) < 2 or self.number[-1] - self.number[-2] != 1:
            return False
        touches = self.values[-2:, 4 * self.sensors :].tolist()
        begins = [was == 0 and now == 1 for was, now in zip(*touches, strict=True)]
        return any(begins) and all(b or now < 0 for b, now in zip(begins, touches[1], strict=True))


def _flagged(groups: Groups, window: _Window, first: int) -> Groups:
    """Groups with the flag; they are the rows of the window from the first one on."""
    rows = _changes(window)[first : first + len(groups)]
    if not rows.any():
        return groups
    return groups.having(flags=groups.flags | rows * Flag.TRANSITION.value)


def _changes(groups: _Window) -> Array:
    """Groups in which a press changed, (G, S); the first and last know one neighbour only."""
    count, ends = len(groups), 2 * groups.sensors
    lowest, highest = groups.values.min(axis=0), groups.values.max(axis=0)
    if (lowest[2 * ends :] == highest[2 * ends :]).all() and (
        lowest[:ends] >= _DIP * highest[:ends]
    ).all():
        return np.zeros((count, groups.sensors), bool)  # no touch changes, and nothing dips
    # Row g: the previous and the next group, and whether they are adjacent on the grid.
    beside = np.zeros((2, count, 1), bool)
    beside[0, 1:, 0] = beside[1, :-1, 0] = np.diff(groups.number) == 1
    neighbours = np.zeros((2, *groups.values.shape))
    neighbours[0, 1:], neighbours[1, :-1] = groups.values[:-1], groups.values[1:]
    level, std, touch = np.split(groups.values, [ends, 2 * ends], axis=1)
    levels, stds, touches = np.split(neighbours, [ends, 2 * ends], axis=2)
    known = beside & (touches >= 0)  # (2, G, S)
    edge = (known & (touches != touch)).any(axis=0) & (touch == 1)
    of_ends = np.repeat(known, 2, axis=2)
    dip = _dips(level, std, np.min(levels, axis=0, initial=np.inf, where=of_ends))
    # Of two groups in a row that dip, the second may be above the first.
    after_dip = np.zeros((count, groups.sensors), bool)
    after_dip[1:] = _any_end(dip)[:-1] & beside[0, 1:]
    following = np.where(of_ends[1], levels[1], np.inf)
    dip |= np.repeat(after_dip, 2, axis=1) & _dips(level, std, following)
    changed = edge | (_any_end(dip) & (touch >= 0))
    untouched = (touch == 0) | (known & (touches == 0)).any(axis=0)
    touched = (touch == 1) | (known & (touches == 1)).any(axis=0)
    anything = (changed | (untouched & touched)).any(axis=1)[:, None]
    # A change on one sensor disturbs the others, whose standard deviation then rises.
    disturbed = _any_end((beside & (std > _DISTURBED * stds)).any(axis=0))
    transition: Array = (changed | (anything & disturbed)) & (touch >= 0)
    return transition


def _dips(level: Array, std: Array, lowest: Array) -> Array:
    """Whether magnitudes are below those of the neighbours, infinite where there is none."""
    with np.errstate(invalid="ignore"):
        deep = (level < _DIP * lowest) & (lowest - level > _DIP_STDS * np.radians(std) * lowest)
    dips: Array = deep & np.isfinite(lowest)
    return dips


def _any_end(of_ends: Array) -> Array:
    """Whether it is so of an end of each sensor: (G, 2S) to (G, S)."""
    any_end: Array = of_ends[:, ::2] | of_ends[:, 1::2]
    return any_end
