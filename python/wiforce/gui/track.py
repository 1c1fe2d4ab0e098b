# SPDX-License-Identifier: GPL-3.0-or-later
"""What a display remembers of one sensor: its latest reading and the recent past."""

import dataclasses
import math
from collections import deque

import numpy as np

from ..io.readings import FLAGS, Reading

_NUMBERS = (
    "force_n",
    "force_std_n",
    "location_mm",
    "location_std_mm",
    "phase1_deg",
    "phase2_deg",
    "snr_db",
)
# Most groups kept, whatever the history's length: short groups come at some hundreds a second.
_MOST = 20_000


def as_reading(reading):
    """A Reading from what the port ``readings`` gives, or any part of it.

    Parameters
    ----------
    reading : Reading or dict
        Keys as the columns of a readings file; flags as one text or a sequence. What is absent,
        not finite, or not a number is unknown.

    Returns
    -------
    Reading or None
        None when it does not say which sensor, or not when.
    """
    if isinstance(reading, Reading):
        reading = dataclasses.asdict(reading)
    if not isinstance(reading, dict):
        return None
    time_s, sensor = _number(reading.get("time_s")), reading.get("sensor")
    if time_s is None or not isinstance(sensor, str) or not sensor:
        return None
    touch = _number(reading.get("touch"))
    flags = reading.get("flags") or ()
    flags = flags.split() if isinstance(flags, str) else flags
    return Reading(
        time_s=time_s,
        sensor=sensor,
        touch=None if touch is None else int(touch == 1),
        flags=tuple(flag for flag in flags if flag in FLAGS),
        **{name: _number(reading.get(name)) for name in _NUMBERS},
    )


def _number(value):
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


class Track:
    """One sensor's readings over the last ``history_s`` seconds of signal.

    Attributes
    ----------
    latest : Reading
    """

    def __init__(self, history_s):
        self._history_s = history_s
        self._past = deque(maxlen=_MOST)
        self.latest = None

    def add(self, reading):
        """Takes a reading; one from before the latest means that a run has begun anew."""
        if self.latest is not None and reading.time_s < self.latest.time_s:
            self._past.clear()
        self.latest = reading
        self._past.append(reading)
        while self._past[0].time_s < reading.time_s - self._history_s:
            self._past.popleft()

    def series(self, name):
        """Times in s and values of one column; two arrays.

        NaN where it is unknown, and where the press changed within the group: that mixes before
        and after.
        """
        times = [reading.time_s for reading in self._past]
        values = [
            None if "transition" in reading.flags else getattr(reading, name)
            for reading in self._past
        ]
        return np.array(times), np.array(values, float)
