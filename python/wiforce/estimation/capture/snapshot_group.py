# SPDX-License-Identifier: GPL-3.0-or-later
"""The snapshots of one phase group, before its tones are computed."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ...wiforce_kernels import interference_screen
from ..groups import Array


@dataclass(frozen=True, eq=False)
class SnapshotGroup:
    """Snapshots of one phase group as they were received.

    Attributes
    ----------
    index : int
        On the grid of the run.
    folded : ndarray of complex64, shape (N, symbol_length)
        Folded frames.
    noise : ndarray, shape (N, 2), or None
        Smallest and largest difference of the averaged repetitions, as a power per sample; not
        needed where ``kept`` is known.
    present : ndarray of bool, shape (N,)
        Which snapshots were received; what the others hold means nothing.
    saturated : int
        Snapshots with samples at full scale.
    retuned : bool
        Whether the receiver's rate or carrier was changed before the group.
    kept : ndarray of bool, shape (N,), optional
        Which snapshots are to be used; set by the blocks that collect them, or by
        :class:`GroupScreen`.

    Examples
    --------
    >>> group = SnapshotGroup(7, np.ones((4, 64)), np.ones((4, 2)), np.array([1, 1, 0, 1]) > 0)
    >>> group.snapshots.tolist()
    [28, 29, 31]
    """

    index: int
    folded: Array = field(repr=False)
    noise: Array | None = field(repr=False)
    present: Array = field(repr=False)
    saturated: int = 0
    retuned: bool = False
    kept: Array | None = field(default=None, repr=False)

    @property
    def snapshots(self) -> Array:
        """Indices of the snapshots that were received, on the grid of the run."""
        return self.index * len(self.present) + np.flatnonzero(self.present)

    def copy(self) -> SnapshotGroup:
        """The same group with snapshots of its own, for when a block's buffer is reused."""
        return replace(self, folded=self.folded.copy())


class GroupScreen:
    """Finds the snapshots that other transmitters interfered with, group by group.

    Parameters
    ----------
    group_length : int
        Snapshots per group, N.
    symbol_length : int
        Samples of a snapshot.

    Examples
    --------
    >>> screen = GroupScreen(4)
    >>> group = SnapshotGroup(7, np.ones((4, 64)), np.ones((4, 2)), np.array([1, 1, 0, 1]) > 0)
    >>> screen.process(group).kept.tolist()
    [True, True, False, True]
    """

    def __init__(self, group_length: int, symbol_length: int = 64) -> None:
        self._kernel = interference_screen(group_length, symbol_length)

    def process(self, group: SnapshotGroup) -> SnapshotGroup:
        """Take the next group; give it with ``kept``."""
        if group.kept is not None or group.noise is None:
            return group
        present = group.present
        marks = self._kernel.examine(present, group.folded[present], group.noise[present])
        return replace(group, kept=present & ~marks)
