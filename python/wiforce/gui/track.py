# SPDX-License-Identifier: GPL-3.0-or-later
"""History of one sensor for a display: its latest reading and those of the last seconds."""

from collections import deque

import numpy as np

from ..io.readings import Reading
from .words import warning_flags

# Most groups kept, however long the history: short groups arrive at some hundreds per second.
_MOST = 20_000


class Track:
    """One sensor's readings over the last ``history_s`` seconds of signal.

    Attributes
    ----------
    latest : Reading or None
    """

    def __init__(self, history_s: float) -> None:
        self._history_s = history_s
        self._past: deque[Reading] = deque(maxlen=_MOST)
        self.latest: Reading | None = None

    def add(self, reading: Reading) -> None:
        """Add a reading; one earlier than the latest means that a new run has begun."""
        if self.latest is not None and reading.time_s < self.latest.time_s:
            self._past.clear()
        self.latest = reading
        self._past.append(reading)
        while self._past[0].time_s < reading.time_s - self._history_s:
            self._past.popleft()

    def series(self, name: str, flagged: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """One column over time, of the readings that are reliable or of those that are not.

        Returns times and values, shape (n,) each: times in s of all readings. Values are
        NaN for the other readings and where they are unknown. The force of an untouched sensor is 0
        N.

        Parameters
        ----------
        name : str
            A column with numbers.
        flagged : bool
            True gives the readings with a flag other than ``reference``, False all others.
        """
        times = [reading.time_s for reading in self._past]
        values = [
            _shown(reading, name) if bool(warning_flags(reading)) == flagged else None
            for reading in self._past
        ]
        return np.array(times), np.array(values, float)


def _shown(reading: Reading, name: str) -> float | None:
    if name == "force_n" and reading.touch == 0:
        return 0.0
    value: float | None = getattr(reading, name)
    return value
