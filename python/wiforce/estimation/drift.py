# SPDX-License-Identifier: GPL-3.0-or-later
"""Drift of an untouched sensor's phases, learned so that it can be stated during a touch.

Temperature, humidity and cables change the phases slowly. While the line is not touched, the tare
follows. During a touch drift cannot be distinguished from force, and what is known is its size.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from ..signal.carrier import wrapped
from .touch_margin import TouchMargin

# Distances in groups over which changes are compared. Short ones show fast drift soon, long ones
# slow drift, which the noise of single groups hides.
_LAGS = (1, 4, 12)
# Changes count for about this long, in s.
_MEMORY_S = 20.0
# Standard deviations by which the mean square of the changes must exceed that of noise.
_SIGNIFICANT = 4.0
_LEAST_CHANGES = 4
# Relative standard deviation of a mean square below which it may set such a limit.
_CERTAIN = 0.5
# Standard deviations of the mean square at which the upper limit lies.
_UPPER = 2.0
# Groups next to a touch that are not used.
_MARGIN_GROUPS = 2
# Untouched groups before and after a touch that are compared, at most.
_ACROSS_GROUPS = 4
# A change beyond this, in degrees, is an event and not drift.
_EVENT_DEG = 5.0


# Time, phases of both ends and their standard deviations.
_Group = tuple[float, Sequence[float], Sequence[float]]


class DriftRate:
    """Random walk of both phases: its standard deviation after one second.

    Parameters
    ----------
    group_period_s : float
        Length of a group, in s.
    stated_deg : float or None
        Known standard deviation after one second, in degrees; learned when None.

    Notes
    -----
    Changes over a time tau have the variance q tau + 2 sigma^2 for phases with noise of variance
    sigma^2. Of the upper limits that several tau set to q the lowest counts: noise that was stated
    too small shows at all tau alike, and limits q at the longest of them.

    Examples
    --------
    >>> import numpy as np
    >>> rate, rng = DriftRate(0.036), np.random.default_rng(1)
    >>> walk = np.cumsum(0.5 * np.sqrt(0.036) * rng.standard_normal((300, 2)), axis=0)
    >>> measured = walk + 0.05 * rng.standard_normal((300, 2))
    >>> for group, phases in enumerate(measured.tolist()):
    ...     rate.follow(0.036 * group, phases, (0.05, 0.05))
    >>> 0.4 < rate.std_deg(1.0)[0] < 0.8
    True
    """

    def __init__(self, group_period_s: float, stated_deg: float | None = None) -> None:
        self._period_s = group_period_s
        self._stated = stated_deg
        self._keep = 1 - group_period_s / _MEMORY_S
        self._recent: deque[_Group] = deque(maxlen=max(_LAGS) + 1)
        self._margin = TouchMargin[_Group](_MARGIN_GROUPS)
        self._before: tuple[float, list[float], list[float]] | None = None
        # Time, squared change and its noise from before a touch to after it, of both ends.
        self._across = ([0.0, 0.0], [0.0, 0.0], [0.0, 0.0])
        # Of each lag: number, squared changes of both ends, and the noise expected in them.
        self._sums = {lag: [0.0, 0.0, 0.0, 0.0, 0.0] for lag in _LAGS}

    def interrupt(self) -> None:
        """Do not compare the next groups with those before: a touch lies between."""
        if self._recent:  # fewer groups than usual, where presses follow each other quickly
            self._compare_across()
            self._before = self._newest()
        self._recent.clear()
        self._margin.touch()

    def follow(self, time_s: float, phases_deg: Sequence[float], std_deg: Sequence[float]) -> None:
        """Take an untouched group.

        Parameters
        ----------
        time_s : float
            Centre of the group.
        phases_deg, std_deg : pair of float
            Phase changes of both ends and their standard deviations.
        """
        if self._stated is not None:
            return
        if (group := self._margin.take((time_s, phases_deg, std_deg))) is not None:
            self._compare(*group)

    def _compare(
        self, time_s: float, phases_deg: Sequence[float], std_deg: Sequence[float]
    ) -> None:
        self._recent.append((time_s, phases_deg, std_deg))
        keep, first, second = self._keep, phases_deg[0], phases_deg[1]
        noise1, noise2 = std_deg[0] ** 2, std_deg[1] ** 2
        for lag, sums in self._sums.items():
            if len(self._recent) <= lag:
                continue
            before_s, before, noise = self._recent[-1 - lag]
            if time_s - before_s > (lag + 0.5) * self._period_s:
                continue  # groups are missing
            change1 = wrapped(first - before[0])
            change2 = wrapped(second - before[1])
            if abs(change1) > _EVENT_DEG or abs(change2) > _EVENT_DEG:
                self.interrupt()
                return
            sums[0] = keep * sums[0] + 1.0
            sums[1] = keep * sums[1] + change1 * change1
            sums[2] = keep * sums[2] + change2 * change2
            sums[3] = keep * sums[3] + noise1 + noise[0] ** 2
            sums[4] = keep * sums[4] + noise2 + noise[1] ** 2
        if len(self._recent) == _ACROSS_GROUPS:
            self._compare_across()

    def _newest(self) -> tuple[float, list[float], list[float]]:
        """Mean time and phases of the newest groups, and the variance of these phases."""
        newest = list(self._recent)[-_ACROSS_GROUPS:]
        first = newest[0][1]
        means, variances = [], []
        for end in (0, 1):
            changes = [wrapped(p[end] - first[end]) for _, p, _ in newest]
            means.append(first[end] + sum(changes) / len(newest))
            variances.append(sum(std[end] ** 2 for _, _, std in newest) / len(newest) ** 2)
        return sum(time_s for time_s, _, _ in newest) / len(newest), means, variances

    def _compare_across(self) -> None:
        """Learn once from what a touch hid: a change of the untouched phases across it."""
        if self._before is None:
            return
        before, after, self._before = self._before, self._newest(), None
        changes = [wrapped(after[1][i] - before[1][i]) for i in (0, 1)]
        if max(map(abs, changes)) > _EVENT_DEG:
            return  # the tag was moved
        for end, change in enumerate(changes):
            new = after[0] - before[0], change * change, after[2][end] + before[2][end]
            for sums, value in zip(self._across, new, strict=True):
                sums[end] += value

    def std_deg(self, elapsed_s: float) -> tuple[float, float]:
        """Standard deviation of both phases' drift after a time.

        Parameters
        ----------
        elapsed_s : float
            Since the last untouched group.

        Returns
        -------
        (float, float)
            In degrees; 0 where no drift was found.
        """
        root = math.sqrt(max(elapsed_s, 0.0))
        if self._stated is not None:
            return self._stated * root, self._stated * root
        return self._learned(1) * root, self._learned(2) * root

    def _learned(self, end: int) -> float:
        significant, smallest, shortest = False, math.inf, math.inf
        for lag, sums in self._sums.items():
            count = sums[0]
            if count < _LEAST_CHANGES:
                continue
            mean, noise = sums[end] / count, sums[end + 2] / count
            if lag == _LAGS[0]:
                # A stated noise may be too large; that of the phases is not larger than this.
                shortest = mean
            noise = min(noise, shortest)
            # Changes that overlap are not independent.
            share = math.sqrt(2 * lag / count)
            significant |= mean - noise > _SIGNIFICANT * noise * share
            upper = max(mean - noise, 0.0) + _UPPER * mean * share
            if lag == _LAGS[0] or share <= _CERTAIN:
                smallest = min(smallest, upper / (lag * self._period_s))
        largest = smallest if significant else 0.0
        elapsed_s, change, noise = (values[end - 1] for values in self._across)
        if change > _SIGNIFICANT**2 * noise:
            largest = max(largest, (change - noise) / elapsed_s)
        return math.sqrt(largest)
