# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps a warning that recurs from filling the log of a run that lasts for weeks."""

import math
from collections.abc import Callable

_SHORTEST_S, _LONGEST_S = 1.0, 600.0


class WarningPace:
    """Allows a kind of warning at once, and ever less often while its cause goes on.

    The pause between two warnings of a kind doubles from 1 s to 10 min. It is short again once
    nothing has happened for two pauses.
    """

    def __init__(self, now: Callable[[], float]):
        self._now = now
        self._last_s: dict[str, float] = {}
        self._pause_s: dict[str, float] = {}

    def allows(self, kind: str) -> bool:
        """Whether a warning that is due may be written now; if so, it counts as written."""
        now, pause_s = self._now(), self._pause_s.get(kind, 0.0)
        quiet_s = now - self._last_s.get(kind, -math.inf)
        if quiet_s < pause_s:
            return False
        longer = quiet_s < 2 * max(pause_s, _SHORTEST_S)
        self._pause_s[kind] = min(2 * pause_s, _LONGEST_S) if longer and pause_s else _SHORTEST_S
        self._last_s[kind] = now
        return True
