# SPDX-License-Identifier: GPL-3.0-or-later
"""Detection of a moving tag while the line is touched."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from ..signal.carrier import wrapped
from .touch import COMMON_STDS

# A motion changes both phases by at least 1 deg within eight groups, with a difference of at most a
# quarter of the change, and the estimated location jumps by at least 0.4 mm and four standard
# deviations. docs/estimation.md, section "Thresholds", states what other values cost.
_LEAST_MOTION_DEG, _MOTION_GROUPS = 1.0, 8
_LARGEST_DIFFERENCE = 0.25
_JUMP_MM, _JUMP_STDS = 0.4, 4.0


class _Touched(NamedTuple):
    phases_deg: tuple[float, float]
    std_deg: tuple[float, float]
    location_mm: float
    location_std_mm: float


class TouchedMotion:
    """Distinguishes a step of the tag's position during a touch from a change of force.

    Both change both phases. A change of force changes the phase of the nearer end more, or in the
    middle of the line both equally without a change of location. A step of the tag changes both
    equally, which the model explains by another force at another location. A sliding press changes
    them in opposite directions.

    Examples
    --------
    >>> motion, std = TouchedMotion(), (0.05, 0.05)
    >>> [motion.update(phases, std, location_mm, 0.05) for phases, location_mm in (
    ...     ((40.0, 20.0), 25.0), ((40.0, 20.0), 25.0), ((35.0, 15.0), 26.0))]
    [False, False, True]
    """

    def __init__(self) -> None:
        self._recent: deque[_Touched] = deque(maxlen=_MOTION_GROUPS)
        self._moved = self._begun = False

    def forget(self) -> None:
        """Forget the groups of a touch that has ended."""
        self._recent.clear()
        self._moved = self._begun = False

    def update(
        self,
        phases_deg: tuple[float, float],
        std_deg: tuple[float, float],
        location_mm: float,
        location_std_mm: float,
    ) -> bool:
        """Take a touched group.

        Parameters
        ----------
        phases_deg, std_deg : pair of float
            psi_1 and psi_2 and their standard deviations, in degrees.
        location_mm, location_std_mm : float
            As inverted.

        Returns
        -------
        bool
            Whether the tag has moved since the touch began.
        """
        if not self._begun:  # the group in which a touch begins is a mixture
            self._begun = True
            return False
        group = _Touched(phases_deg, std_deg, location_mm, location_std_mm)
        self._moved = self._moved or any(_stepped(before, group) for before in self._recent)
        self._recent.append(group)
        return self._moved


def _stepped(before: _Touched, after: _Touched) -> bool:
    """Whether both phases changed equally between two groups and the location jumped."""
    first, second = (
        wrapped(new - old) for new, old in zip(after.phases_deg, before.phases_deg, strict=True)
    )
    spreads = [math.hypot(new, old) for new, old in zip(after.std_deg, before.std_deg, strict=True)]
    common = abs((first + second) / 2)
    if common < max(_LEAST_MOTION_DEG, COMMON_STDS * max(spreads)):
        return False
    if abs(first - second) > max(COMMON_STDS * math.hypot(*spreads), _LARGEST_DIFFERENCE * common):
        return False
    jump = abs(after.location_mm - before.location_mm)
    spread_mm = math.hypot(after.location_std_mm, before.location_std_mm)
    return jump > max(_JUMP_MM, _JUMP_STDS * spread_mm)
