# SPDX-License-Identifier: GPL-3.0-or-later
"""Slow tare: tracks the phase drift of an untouched sensor."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from ..signal.carrier import wrapped

# docs/estimation.md, section "Thresholds", states what other values of these constants cost.
# The tare averages one second of groups, without the newest two: a press that begins slowly is
# recognised as a touch only after its first groups.
_MEMORY_S = 1.0
_DELAY_GROUPS = 2
# A drift common to both ends is extrapolated when it is significant by this many standard
# deviations over at least this many groups.
_SIGNIFICANT_DRIFT = 4.0
_DRIFT_GROUPS = 8
# A group in which the changes of both ends differ by more than four standard deviations and 0.3 deg
# is excluded, unless five in a row show that the tare itself is wrong.
_OUTLIER_STDS = 4.0
_OUTLIER_DEG = 0.3
_OUTLIERS = 5

# The group in which a touch ends is the mean of it and of the untouched phases: the first group
# after a touch is left out if it differs from the tare by this, or the tare is not known well yet.
_MIXED_STDS = 3.0
# Groups over which the error of the tare is averaged.
_ERROR_GROUPS = 4

# Time, both phases, root of the weight, and both changes against the tare of the group before.
_Group = tuple[float, float, float, float, float, float]


class SlowTare:
    """Mean phase over the last second of untouched groups, extrapolated along a significant drift.

    A group is used two groups later, when the groups after it are known to be untouched as well.

    Parameters
    ----------
    group_period_s : float
        Length of a group, in s.

    Attributes
    ----------
    drift_deg : (float, float)
        Change of both ends' phases since the reference, in degrees.

    Examples
    --------
    >>> tare = SlowTare(0.036)
    >>> for group in range(40):
    ...     tare.follow(0.036 * group, (0.1 * group, 0.1 * group), (0.05, 0.05))
    >>> [round(drift, 6) for drift in tare.drift_deg]
    [3.9, 3.9]
    """

    def __init__(self, group_period_s: float) -> None:
        length = max(_DRIFT_GROUPS, round(_MEMORY_S / group_period_s))
        # Rows 1, time from an origin and both phases, times the root of the weight; a ring, as no
        # sum below depends on the order.
        self._untouched = np.zeros((4, length))
        self._origin_s = 0.0
        self._count = self._next = 0
        self._recent: deque[_Group] = deque()
        self._outliers: list[_Group] = []
        self._touched = False
        # Changes against the tare and variance of their difference, of the newest groups used.
        self._errors: deque[tuple[float, float, float]] = deque(maxlen=_ERROR_GROUPS)
        self.drift_deg = (0.0, 0.0)

    def reset(self) -> None:
        """Restart at 0, for a new reference."""
        self.shift((-self.drift_deg[0], -self.drift_deg[1]))

    def shift(self, change_deg: tuple[float, float]) -> None:
        """Restart at phases changed by a motion of the tag, in degrees."""
        self.drift_deg = (self.drift_deg[0] + change_deg[0], self.drift_deg[1] + change_deg[1])
        self._recent.clear()
        self._outliers.clear()
        self._errors.clear()
        self._count = self._next = 0

    def discard_newest(self, touched: bool = False) -> None:
        """Discard the groups that are not used yet: a touch may have begun in them.

        Parameters
        ----------
        touched : bool
            It has begun for certain: outliers are forgotten, and the group after it may hold
            its end.
        """
        self._recent.clear()
        if touched:
            self._outliers.clear()
            self._touched = True

    def follow(
        self, time_s: float, phases_deg: tuple[float, float], std_deg: tuple[float, float]
    ) -> None:
        """Take an untouched group.

        Parameters
        ----------
        time_s : float
            Centre of the group.
        phases_deg, std_deg : pair of float
            arg R of both ends and its standard deviation, in degrees.
        """
        first, second = self.drift_deg
        change1 = wrapped(phases_deg[0] - first)
        change2 = wrapped(phases_deg[1] - second)
        after_touch, self._touched = self._touched, False
        differs = abs(change1) > _MIXED_STDS * std_deg[0] or abs(change2) > _MIXED_STDS * std_deg[1]
        if after_touch and (differs or self._count < _DRIFT_GROUPS):
            return
        limit = max(_OUTLIER_STDS * math.hypot(*std_deg), _OUTLIER_DEG)
        variance = max(std_deg[0] ** 2 + std_deg[1] ** 2, 1e-12)
        group = (time_s, first + change1, second + change2, variance**-0.5, change1, change2)
        if abs(change1 - change2) > limit:
            self._outliers.append(group)
            if len(self._outliers) < _OUTLIERS:
                return
            self._count = self._next = 0
            self._recent.extend(self._outliers)
        else:
            self._recent.append(group)
        self._outliers.clear()
        while len(self._recent) > _DELAY_GROUPS:
            used = self._recent.popleft()
            self._keep(*used[:4])
            self._errors.append((used[4], used[5], used[3] ** -2))
            self._next = (self._next + 1) % self._untouched.shape[1]
            self._count = min(self._count + 1, self._untouched.shape[1])
        if self._count:
            self.drift_deg = self._extrapolate(time_s)

    @property
    def error_deg(self) -> tuple[float, float]:
        """By how much the tare misses the newest groups it used; 0 where noise explains it.

        It lags behind a motion that begins, and overshoots one that ends.
        """
        if not self._errors:
            return 0.0, 0.0
        count = len(self._errors)
        first, second, variance = (
            sum(values) / count for values in zip(*self._errors, strict=True)
        )
        limit = max(_OUTLIER_STDS * math.sqrt(variance / count), _OUTLIER_DEG)
        return (
            abs(first) if abs(first) > limit else 0.0,
            abs(second) if abs(second) > limit else 0.0,
        )

    def _keep(self, time_s: float, first: float, second: float, root: float) -> None:
        """Put a group into the ring, in place of the oldest."""
        rows = self._untouched
        if time_s - self._origin_s > _MEMORY_S:
            # Times remain small, so that their squares can be summed.
            rows[1] += (self._origin_s - time_s) * rows[0]
            self._origin_s = time_s
        rows[:, self._next] = root, root * (time_s - self._origin_s), root * first, root * second

    def _extrapolate(self, time_s: float) -> tuple[float, float]:
        """Phases of both ends now: their mean, extrapolated along a significant common drift."""
        groups = self._untouched[:, : self._count]
        sums = (groups @ groups.T).tolist()
        weight, times, firsts, seconds = sums[0]
        center, first, second = times / weight, firsts / weight, seconds / weight
        if self._count < _DRIFT_GROUPS:
            return first, second
        mean = (first + second) / 2
        # Central second moments of time, of the phases' mean, and of both.
        moment = sums[1][1] / weight - center**2
        joint = (sums[1][2] + sums[1][3]) / (2 * weight) - center * mean
        square = (sums[2][2] + 2 * sums[2][3] + sums[3][3]) / (4 * weight) - mean**2
        slope = joint / moment
        residual = max(square - slope * joint, 0.0)
        error = math.sqrt(residual / (self._count - 2) / moment)
        if abs(slope) > _SIGNIFICANT_DRIFT * error:
            drift = slope * (time_s - self._origin_s - center)
            return first + drift, second + drift
        return first, second
