# SPDX-License-Identifier: GPL-3.0-or-later
"""The groups of a stream that its room is surveyed in."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...io.readings import Reading
from ..groups import Array
from .snapshot_group import SnapshotGroup

# A survey without a request waits for so many more groups: a press that begins slowly is
# recognised as a touch only after its first groups, and readings are one group late.
_MORE_GROUPS = 3
# Flags of untouched groups in which the tag or the receiver may have changed, or the sensor may be
# touched after all, as while a reference is unverified.
_UNSTEADY = {"ambiguous", "gap", "inconsistent", "moved", "saturated", "transition"}


class SurveyedGroups:
    """Groups that are kept until they hold a survey's snapshots.

    Parameters
    ----------
    snapshots : int
        That the survey needs, from the start of the first group on.
    group_length : int
        Snapshots per group, N.
    first : int, optional
        Index of the first group; that of the first one received when not given.
    untouched_groups : int
        0 where the user takes care that the sensor is not touched. Otherwise so many groups, and
        three more, must be received without a loss and read as untouched before the survey.

    Attributes
    ----------
    groups : list of SnapshotGroup
    """

    def __init__(
        self,
        snapshots: int,
        group_length: int,
        first: int | None = None,
        untouched_groups: int = 0,
    ) -> None:
        self.groups: list[SnapshotGroup] = []
        self._length = group_length
        self._first = first
        self._unasked = untouched_groups > 0
        needed = -(-snapshots // group_length)
        if self._unasked:
            needed = max(needed, untouched_groups) + _MORE_GROUPS
        self._needed = needed
        self._last: int | None = None  # index of the last group that is surveyed

    def add(self, group: SnapshotGroup) -> None:
        """Keep a copy of the next group."""
        if self._unasked and self.groups and group.index != self.groups[-1].index + 1:
            # What the groups after a loss hold is known only when they have been read.
            self.groups = []
        self.groups.append(group.copy())

    def check(self, readings: Iterable[Reading]) -> None:
        """Leave out all groups up to the last one that was not read as untouched and steady."""
        if not self._unasked:
            return
        for reading in readings:
            assert reading.group is not None
            if reading.touch != 0 or _UNSTEADY & set(reading.flags):
                self.groups = [group for group in self.groups if group.index > reading.group]

    @property
    def first(self) -> int:
        """Index of the group with which the survey begins."""
        return self.groups[0].index if self._first is None else self._first

    def end_survey(self) -> None:
        """Survey the groups kept so far; those that follow are only kept."""
        if self._last is None:
            self._last = self.groups[-1].index

    @property
    def _to_survey(self) -> list[SnapshotGroup]:
        if self._last is None:
            return self.groups
        return [group for group in self.groups if group.index <= self._last]

    @property
    def complete(self) -> bool:
        """Whether the groups hold all snapshots of the survey, or the time for it is over."""
        return bool(self.groups) and self.groups[-1].index + 1 - self.first >= self._needed

    @property
    def snapshots(self) -> Array:
        """Indices of the surveyed snapshots, 0 for the start of the first group."""
        begin = self.first * self._length
        return np.concatenate([group.snapshots for group in self._to_survey]) - begin

    @property
    def folded(self) -> Array:
        """Folded frames of these snapshots, shape (n, 64)."""
        return np.concatenate([group.folded[group.present] for group in self._to_survey])
