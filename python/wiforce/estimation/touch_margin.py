# SPDX-License-Identifier: GPL-3.0-or-later
"""Untouched groups without those next to a touch."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

_Group = TypeVar("_Group")


class TouchMargin(Generic[_Group]):
    """Holds untouched groups back until it is known that no touch begins right after them.

    A press that begins or ends slowly changes groups that count as untouched.

    Parameters
    ----------
    groups : int
        Groups before and after a touch that are left out.

    Examples
    --------
    >>> margin = TouchMargin[int](2)
    >>> [margin.take(group) for group in range(4)]
    [None, None, 0, 1]
    >>> margin.touch()
    >>> [margin.take(group) for group in range(10, 15)]
    [None, None, None, None, 12]
    """

    def __init__(self, groups: int) -> None:
        self._groups = groups
        self._skipped = groups
        self._held: deque[_Group] = deque()

    def take(self, group: _Group) -> _Group | None:
        """Take an untouched group; give the one that is far enough from any touch."""
        if self._skipped < self._groups:
            self._skipped += 1
            return None
        self._held.append(group)
        return self._held.popleft() if len(self._held) > self._groups else None

    def touch(self) -> None:
        """Discard the groups held back, and leave out those that follow."""
        self._held.clear()
        self._skipped = 0

    def clear(self) -> None:
        """Discard the groups held back."""
        self._held.clear()
