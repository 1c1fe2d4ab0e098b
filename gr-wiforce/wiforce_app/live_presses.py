# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of one sensor of a live session, taken on request."""

import math
import time
from collections import deque

from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.sensor.press_measurement import LEAST_GROUPS

# Length of a measurement: a person can hold a press still for half a second.
_MEASURE_S = 0.5
_LOOK_S = 0.02
# Without readings for this long, in wall time, something is wrong.
_PATIENCE_S, _START_PATIENCE_S = 5.0, 60.0
_KEPT = 4096


class LivePresses:
    """Collects readings of one sensor.

    Parameters
    ----------
    session : LiveSession
    watch : Watch
        Notices when the device is gone.
    sensor : str
    group_period_s : float
        Length of a group, in s.
    """

    def __init__(self, session, watch, sensor, group_period_s):
        self._session, self._watch, self._sensor = session, watch, sensor
        self._period_s = group_period_s
        self._readings = deque(maxlen=_KEPT)
        self.groups = max(LEAST_GROUPS, math.ceil(_MEASURE_S / group_period_s))

    def note(self, reading):
        """Keep a reading; in the thread of the reader."""
        if reading.sensor == self._sensor:
            self._readings.append(reading)

    def idle(self):
        """Check that the session goes on.

        Raises
        ------
        DeviceLost
        """
        self._watch.look()
        if self._session.failure is not None:
            raise self._session.failure

    def collect(self, idle):
        """Readings of groups that begin after this call.

        Parameters
        ----------
        idle : callable
            Called while waiting.

        Returns
        -------
        list of Reading

        Raises
        ------
        InputError
            When too few arrive.
        """
        begin_s = self._session.time_s + self._period_s / 2
        end = time.monotonic() + _PATIENCE_S + 4 * self.groups * self._period_s
        while True:
            found = [each for each in list(self._readings) if each.time_s >= begin_s]
            if len(found) >= self.groups:
                return found[: self.groups]
            if time.monotonic() > end:
                rule = f"must give {self.groups} readings; is its tag on, and in reach?"
                raise InputError(f"sensor '{self._sensor}'", rule, len(found))
            idle()
            time.sleep(_LOOK_S)

    def wait_for_reference(self, idle):
        """Wait until readings come that are not part of the untouched reference.

        Raises
        ------
        InputError
            When none comes within a minute.
        """
        end = time.monotonic() + _START_PATIENCE_S
        while not self._readings or "reference" in self._readings[-1].flags:
            if time.monotonic() > end:
                rule = "must give readings; run `gr-wiforce check` with the same scene and gains"
                raise InputError(f"sensor '{self._sensor}'", rule)
            idle()
            time.sleep(_LOOK_S)

    def tare(self, idle):
        """Measure the untouched reference again.

        Raises
        ------
        InputError
            When the sensor is touched.
        """
        touched = sum(reading.touch == 1 for reading in self.collect(idle))
        if touched:
            raise InputError("tare", "must be of the untouched sensor; release it")
        self._session.reader.tare()
        self._readings.clear()
        end = time.monotonic() + _PATIENCE_S
        while not any("reference" in each.flags for each in list(self._readings)):
            if time.monotonic() > end:
                raise InputError("tare", "was not carried out")
            idle()
            time.sleep(_LOOK_S)
        self.wait_for_reference(idle)
