# SPDX-License-Identifier: GPL-3.0-or-later
"""Steps of the receiver's gain during a touch, such as those of an automatic gain control.

A step turns and scales everything that is received by the same factor. Both ends change by it, and
its angle cannot be distinguished from force. The static path changes as well: it is much stronger
than the tag, and what its step leaves on the lines of the tag disturbs the group of the step.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from .groups import Array

# Standard deviation of a group over that of the group before it that shows a disturbance.
_RISE = 3.0
# Largest standard deviation, in deg per change of R by 1, that a change of the tag itself causes in
# a group of this length; it rises as groups get shorter. Presses of 1 ms cause 0.24 deg with groups
# of 36 ms, 1.9 deg with 7 ms and 2.1 deg with 4 ms, steps of the gain 10, 88 and 150 deg with a
# static path 50 dB above the tag.
_CAUSED_DEG, _CAUSED_GROUP_S = 0.5, 0.036
# Both magnitudes change by at least this, by so many standard deviations, and equally: their
# difference is at most this share of the change. A step of 0.25 dB is 2.9 %.
_LEAST_CHANGE, _STDS, _LARGEST_DIFFERENCE = 0.02, 5.0, 0.25
# Time, and least groups, after a disturbance in which the magnitudes are compared: an average over
# groups (scene key phase_group.smoothing_s) ends within it.
_AFTER_S, _AFTER_GROUPS = 0.1, 3
# Groups before and after whose magnitudes must all show it: one may hold the begin of a press.
_AGREEING = 2
# Untouched groups after which a step is forgotten. ``NearPath`` sees earlier ones.
_FORGOTTEN_GROUPS = 3


class _Group(NamedTuple):
    """R of both ends and the standard deviations of their phases, in rad."""

    ratios: tuple[complex, complex]
    stds: tuple[float, float]


class GainStep:
    """Touched groups whose phases may have been changed by a step of the receiver's gain.

    Parameters
    ----------
    group_period_s : float
        Length of a group, in s.

    Examples
    --------
    >>> ratios = np.repeat(np.exp([[0.5j, 1j]]), 6, axis=0)
    >>> ratios[4:] *= 0.9 * np.exp(0.03j)
    >>> std_deg = np.array([[0.04], [0.04], [0.04], [1.0], [0.04], [0.04]]) * [1, 1]
    >>> step = GainStep(0.036)
    >>> step.process(np.zeros(6, bool), np.ones(6, int), ratios, std_deg).tolist()
    [False, False, False, False, True, True]
    """

    def __init__(self, group_period_s: float) -> None:
        self._caused = math.radians(_CAUSED_DEG) * _CAUSED_GROUP_S / group_period_s
        self._after = max(_AFTER_GROUPS, math.ceil(_AFTER_S / group_period_s))
        self._forget()

    def _forget(self) -> None:
        """Forget the groups so far, for a new reference."""
        self._before: deque[_Group] = deque(maxlen=_AGREEING)
        self._disturbance, self._risen, self._compared = 0.0, 0, 0
        self._stepped, self._suspected = False, False
        self._untouched, self._agreeing = 0, 0

    def process(self, renewed: Array, touch: Array, ratios: Array, std_deg: Array) -> Array:
        """Take a batch.

        Parameters
        ----------
        renewed : ndarray of bool, shape (G,)
            The group is the first one with a new reference.
        touch : ndarray of int, shape (G,)
            Touch decisions; -1 where it is unknown.
        ratios : ndarray of complex, shape (G, 2)
            R.
        std_deg : ndarray, shape (G, 2)
            Standard deviations of arg R in the group itself, in degrees.

        Returns
        -------
        ndarray of bool, shape (G,)
        """
        stepped = np.zeros(len(touch), bool)
        values, stds = ratios.tolist(), np.radians(std_deg).tolist()
        for row, touched in enumerate(touch.tolist()):
            if renewed[row]:
                self._forget()
            if touched >= 0 and all(map(math.isfinite, stds[row])):
                self._follow(_Group(tuple(values[row]), tuple(stds[row])), touched == 1)
            stepped[row] = (self._stepped or self._suspected) and touched == 1
        return stepped

    def _follow(self, group: _Group, touched: bool) -> None:
        """Take a group that was received."""
        self._untouched = 0 if touched else self._untouched + 1
        if self._untouched >= _FORGOTTEN_GROUPS:
            self._stepped = False
        rises = bool(self._before) and all(
            std > _RISE * before
            for std, before in zip(group.stds, self._before[-1].stds, strict=True)
        )
        self._risen = self._risen + 1 if rises else 0
        if self._risen > self._after:  # noise that lasts is no disturbance
            self._compared = 0
        elif rises:
            self._disturbance = max(self._disturbance, *group.stds)
            self._compared = self._after
            # Most of the group may follow the step. Its noise excuses no difference of the ends,
            # which presses cause.
            self._suspected = self._differs(_Group(group.ratios, self._before[-1].stds))
        elif self._compared:
            self._compared -= 1
            self._suspected = self._differs(group)
            self._agreeing = self._agreeing + 1 if self._suspected else 0
            if self._agreeing >= _AGREEING:
                self._stepped, self._compared = True, 0
                self._untouched = 0
            elif self._agreeing:
                self._compared = max(self._compared, 1)
        if not self._compared:
            self._suspected, self._agreeing = False, 0
            self._before.append(group)
            self._disturbance, self._risen = 0.0, 0

    def _differs(self, group: _Group) -> bool:
        """Whether the gain in a group is not that of the groups before the disturbance."""
        return all(self._steps(before, group) for before in self._before)

    def _steps(self, before: _Group, after: _Group) -> bool:
        """Whether the gain changed between two groups, with a disturbance between them."""
        pairs = list(zip(after.ratios, before.ratios, strict=True))
        if self._disturbance < self._caused * max(abs(new - old) for new, old in pairs):
            return False
        first, second = (math.log(abs(new) / abs(old)) for new, old in pairs)
        spread = math.hypot(*after.stds, *before.stds)
        common = abs(first + second) / 2
        if common < max(_LEAST_CHANGE, _STDS * spread / 2):
            return False
        return abs(first - second) < max(_STDS * spread, _LARGEST_DIFFERENCE * common)
