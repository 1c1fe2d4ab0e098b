# SPDX-License-Identifier: GPL-3.0-or-later
"""A second path of the tag that comes with the hand, recognised before the hand touches.

A hand that reflects the tag's signal adds a path to both ends alike: R becomes R (1 + h). While
the hand comes, h rotates, and the magnitude of both ends rises and falls by |h|. Once it touches,
the angle of 1 + h cannot be distinguished from force, but its size is known.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from statistics import median

import numpy as np

from .groups import Array
from .touch_margin import TouchMargin

# Untouched groups of this long before a touch show the hand, those before them the level without.
_COMING_S, _LEVEL_S = 0.5, 2.0
# Groups next to a touch that are not used.
_MARGIN_GROUPS = 2
_LEAST_GROUPS = 4
# Standard deviations of the magnitude's noise that are more than noise: the largest of 14 groups
# exceeds five in 1 touch of 100 000.
_SIGNIFICANT = 5.0

# Time, common change of the logarithms of both magnitudes, half their difference, and its noise.
_Group = tuple[float, float, float, float]


class NearPath:
    """Standard deviation that a path near the tag adds to the phases of a touch.

    Parameters
    ----------
    group_period_s : float
        Length of a group, in s.

    Attributes
    ----------
    std_deg : float
        Of each end's phase while the sensor is touched, in degrees; 0 where nothing came.

    Notes
    -----
    The largest deviation of the common magnitude estimates |h|. At an unknown angle, the phase of
    1 + h has the standard deviation |h| / sqrt(2).

    Examples
    --------
    >>> import math
    >>> path = NearPath(0.036)
    >>> for group in range(40):
    ...     change = 0.03 * math.cos(group) if group > 30 else 0.0
    ...     path.follow(0.036 * group, (1 + change, 1 + change), (0.05, 0.05))
    >>> path.touch_begins(0.036 * 40)
    >>> round(path.std_deg, 1)
    1.1
    """

    def __init__(self, group_period_s: float) -> None:
        self._period_s = group_period_s
        self._kept: deque[_Group] = deque(
            maxlen=max(_LEAST_GROUPS, round(_LEVEL_S / group_period_s))
        )
        self._margin = TouchMargin[_Group](_MARGIN_GROUPS)
        self._touched = False
        self.std_deg = 0.0

    def reset(self) -> None:
        """Forget the groups so far, for a new reference."""
        self._kept.clear()
        self._margin.clear()
        self._touched, self.std_deg = False, 0.0

    def process(
        self, index: Array, renewed: Array, touch: Array, ratios: Array, std_deg: Array
    ) -> Array:
        """Take a batch.

        Parameters
        ----------
        index : ndarray of int, shape (G,)
            Of the groups.
        renewed : ndarray of bool, shape (G,)
            The group is the first one with a new reference.
        touch : ndarray of int, shape (G,)
            Touch decisions; -1 where it is unknown.
        ratios : ndarray of complex, shape (G, 2)
            R.
        std_deg : ndarray, shape (G, 2)
            Standard deviations of arg R, in degrees.

        Returns
        -------
        ndarray, shape (G,)
            ``std_deg`` of the touched groups, 0 for others.
        """
        near = np.zeros(len(index))
        times_s, stds = index * self._period_s, std_deg.tolist()
        magnitudes = np.abs(ratios).tolist()
        for row, touched in enumerate(touch.tolist()):
            if renewed[row]:
                self.reset()
            if touched == 1:
                self.touch_begins(times_s[row])
                near[row] = self.std_deg
            elif touched == 0:
                self.follow(times_s[row], magnitudes[row], stds[row])
        return near

    def follow(self, time_s: float, magnitudes: Sequence[float], std_deg: Sequence[float]) -> None:
        """Take an untouched group.

        Parameters
        ----------
        time_s : float
            Centre of the group.
        magnitudes, std_deg : pair of float
            |R| of both ends, and the standard deviations of their phases in degrees.
        """
        self._touched = False
        first, second = math.log(magnitudes[0]), math.log(magnitudes[1])
        noise = math.radians(math.hypot(*std_deg)) / 2
        group = time_s, (first + second) / 2, abs(first - second) / 2, noise
        if (clear := self._margin.take(group)) is not None:
            self._kept.append(clear)

    def touch_begins(self, time_s: float) -> None:
        """Judge the groups before a touch.

        Parameters
        ----------
        time_s : float
            Centre of a touched group; only the first one of a touch counts.
        """
        if self._touched:
            return
        self._touched = True
        self._margin.touch()
        recent = [group for group in self._kept if time_s - group[0] <= _COMING_S]
        if not recent:
            return  # the hand has not gone away since the last touch
        before = [group[1] for group in self._kept if time_s - group[0] > _COMING_S]
        level = median(before) if len(before) >= _LEAST_GROUPS else 0.0
        median_noise = median(group[3] for group in recent)
        # The path is that of both ends.
        sizes = [
            size
            for _, common, half_difference, noise in recent
            if (size := abs(common - level))
            > max(_SIGNIFICANT * max(noise, median_noise), 2 * half_difference)
        ]
        # A press of another sensor may disturb a single group; a hand takes several to come.
        self.std_deg = math.degrees(max(sizes)) / math.sqrt(2) if len(sizes) > 1 else 0.0
