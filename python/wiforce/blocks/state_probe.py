# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: keeps the state of the last phase groups, for who wants to show it."""

from collections import deque

from .group_block import GroupBlock, state_of


class state_probe(GroupBlock):
    """Keeps what travels as ``state`` tag with each group's vectors.

    Input: vectors of any block behind ``end_separation``.

    Parameters
    ----------
    length : int
        Of the vectors.
    kept : int
        Groups kept.

    Attributes
    ----------
    states : deque of GroupState
        The last ones, oldest first.
    """

    def __init__(self, length, kept=1):
        GroupBlock.__init__(self, "state_probe", length, 0)
        self.states = deque(maxlen=kept)

    def take(self, tags, item):
        self.states.append(state_of(tags))
        return []
