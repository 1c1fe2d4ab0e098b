# SPDX-License-Identifier: GPL-3.0-or-later
"""Slips of the frame timing: which phase groups hold frames that lay elsewhere."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...wiforce_kernels import UNNOTICED_FRAMES
from ..groups import Array


class Slips:
    """Slips that were found in a run whose phase groups have some snapshots.

    A slip is found some frames later. The frames before it that may lie elsewhere would be read as
    noise, and as a press: their groups are left out, as if they had not been received.
    """

    def __init__(self, group_length: int) -> None:
        self._length = group_length
        self._known: set[tuple[int, int]] = set()
        self._misplaced: list[tuple[int, int]] = []
        self._ends: list[int] = []
        self._retuned = False  # in a group that was left out
        # Groups before the latest one in which a slip may still be found.
        self.unsure = -(-UNNOTICED_FRAMES // group_length)

    def add(self, misplaced: Iterable[tuple[int, int]]) -> None:
        """Take the first frame and the one behind the last, (k, 2), that each slip misplaced.

        Those that are known already may come again.
        """
        for frames in misplaced:
            if frames not in self._known:
                self._known.add(frames)
                self._misplaced.append(frames)
                self._ends.append(frames[1])

    def elsewhere(self, group: Array) -> Array:
        """Which groups (n,) hold frames that may lie elsewhere; none of a later call is earlier."""
        found = np.zeros(len(group), bool)
        if len(group):
            begin = int(group.min()) * self._length
            self._misplaced = [frames for frames in self._misplaced if frames[1] > begin]
        for first, end in self._misplaced:
            found |= (group >= first // self._length) & (group * self._length < end)
        return found

    def behind(self, group: Array) -> Array:
        """Which of the groups (n,) that are read next are the first ones behind a slip."""
        found = np.zeros(len(group), bool)
        for end in self._ends.copy():
            later = group * self._length >= end
            if later.any():
                found[np.argmax(later)] = True
                self._ends.remove(end)
        return found

    def mark(self, group: int, retuned: bool) -> tuple[bool, bool] | None:
        """Whether the next group is the first one behind a slip, and whether the device was
        retuned since the last one that was marked; None where the group is left out.
        """
        self._retuned |= retuned
        if self._misplaced and self.elsewhere(np.array([group]))[0]:
            return None
        retuned, self._retuned = self._retuned, False
        return bool(self._ends) and bool(self.behind(np.array([group]))[0]), retuned
