# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the tag moves while the line is touched."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from .touch import COMMON, wrapped

# Both ends turn alike, to so many per cent and by so many degrees at least, within so many groups,
# and the location that is read jumps by so many mm or standard deviations.
_ALIKE, _LEAST_MOTION_DEG, _MOTION_GROUPS = 0.25, 1.0, 8
_JUMP_MM, _JUMP = 0.4, 4.0


class _Touched(NamedTuple):
    phases_deg: tuple[float, float]
    std_deg: tuple[float, float]
    location_mm: float
    location_std_mm: float


class TouchedMotion:
    """Tells a step of the tag while the line is touched from a change of force.

    Both turn both ends. A change of force turns the nearer end more, or in the middle of the line
    both alike where the press is; a step of the tag turns both alike, which the model takes for
    another force at another location. A press that slides turns them oppositely.
    """

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """The touch has ended."""
        self._recent: deque[_Touched] = deque(maxlen=_MOTION_GROUPS)
        self._moved = self._begun = False

    def update(
        self,
        phases_deg: tuple[float, float],
        std_deg: tuple[float, float],
        location_mm: float,
        location_std_mm: float,
    ) -> bool:
        """Take a touched group's phases and location; whether the tag has moved in this touch."""
        if not self._begun:  # the group in which a touch begins is a mixture
            self._begun = True
            return False
        group = _Touched(phases_deg, std_deg, location_mm, location_std_mm)
        self._moved = self._moved or any(_stepped(before, group) for before in self._recent)
        self._recent.append(group)
        return self._moved


def _stepped(before: _Touched, after: _Touched) -> bool:
    """Whether both ends turned alike between two groups, and the press seems to jump."""
    first, second = (
        wrapped(new - old) for new, old in zip(after.phases_deg, before.phases_deg, strict=True)
    )
    spreads = [math.hypot(new, old) for new, old in zip(after.std_deg, before.std_deg, strict=True)]
    common = abs((first + second) / 2)
    if common < max(_LEAST_MOTION_DEG, COMMON * max(spreads)):
        return False
    if abs(first - second) > max(COMMON * math.hypot(*spreads), _ALIKE * common):
        return False
    jump = abs(after.location_mm - before.location_mm)
    return jump > max(_JUMP_MM, _JUMP * math.hypot(after.location_std_mm, before.location_std_mm))
