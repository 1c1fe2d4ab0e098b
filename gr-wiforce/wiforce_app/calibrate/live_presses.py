# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of one sensor of a live session, taken on request."""

import math
import time
from collections import deque
from queue import SimpleQueue

from gnuradio.wiforce.calibration.guided.press_measurement import LEAST_GROUPS
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.press.uncalibrated_readings import uncalibrated_readings

# Length of a measurement: a person can hold a press still for half a second.
_MEASURE_S = 0.5
_LOOK_S = 0.02
# Without readings for this long, in wall time, something is wrong.
_PATIENCE_S, _START_PATIENCE_S = 5.0, 60.0
_KEPT = 4096


class LivePresses:
    """Collects readings of one sensor, made without its model (see `uncalibrated_readings`).

    ``keeper``: notices when the device is gone.
    """

    def __init__(self, session, keeper, sensor, scene):
        self._session, self._keeper, self._sensor = session, keeper, sensor
        self._period_s, self._reference_s = scene.group_period_s, scene.reference_s
        self._readings = deque(maxlen=_KEPT)
        self.groups = max(LEAST_GROUPS, math.ceil(_MEASURE_S / self._period_s))
        index = scene.sensor_names.index(sensor)
        planned = session.reader.plan.sensors[index]
        untouched_deg = planned.model.untouched_deg(scene.radio.center_frequency_hz)
        self._made_of = index, sensor, untouched_deg, planned.off_reflection, self._period_s
        stream = session.reader.stream
        self._on_groups, stream.on_groups = stream.on_groups, self._note

    def _note(self, groups):
        """Keep the readings of a batch; in the thread of the reader."""
        self._on_groups(groups)
        self._readings.extend(uncalibrated_readings(groups, *self._made_of))

    def idle(self):
        """Check that the session goes on.

        Raises DeviceLost when the device is gone.
        """
        self._keeper.look()
        if self._session.failure is not None:
            raise self._session.failure

    def collect(self, idle):
        """Readings of groups that begin after this call.

        ``idle``: called while waiting.
        """
        return self._after(self._session.time_s, self.groups, idle)

    def _after(self, begin_s, groups, idle):
        """Readings of the first groups that begin after a time of the run."""
        wait_s = begin_s - self._session.time_s + 4 * groups * self._period_s
        end = time.monotonic() + _PATIENCE_S + 2 * wait_s
        while True:
            found = [
                each for each in list(self._readings) if each.time_s - self._period_s / 2 >= begin_s
            ]
            if len(found) >= groups:
                return found[:groups]
            if time.monotonic() > end:
                rule = f"must give {groups} readings; is its tag on, and in reach?"
                raise InputError(f"sensor '{self._sensor}'", rule, len(found))
            idle()
            time.sleep(_LOOK_S)

    def wait_for_reference(self, idle):
        """Wait until readings come that are not part of the untouched reference."""
        end = time.monotonic() + _START_PATIENCE_S
        while not self._readings or "reference" in self._readings[-1].flags:
            if time.monotonic() > end:
                rule = "must give readings; run `gr-wiforce check` with the same scene and gains"
                raise InputError(f"sensor '{self._sensor}'", rule)
            idle()
            time.sleep(_LOOK_S)

    def tare(self, idle, force=False):
        """Measure the untouched reference again.

        ``idle``: called while waiting; ``force``: even if readings say that the sensor is touched,
        as they do when it was touched during the last reference.
        """
        touched = sum(reading.touch == 1 for reading in self.collect(idle))
        if touched and not force:
            raise InputError("tare", "must be of the untouched sensor; release it")
        outcomes = SimpleQueue()
        self._session.reader.tare(force, outcomes.put)
        end = time.monotonic() + _PATIENCE_S + 2 * self._reference_s
        while outcomes.empty():
            if time.monotonic() > end:
                self._session.reader.cancel_tare("no groups are received")
            idle()
            time.sleep(_LOOK_S)
        outcome = outcomes.get()
        if outcome.state != "complete":
            raise InputError("tare", f"{outcome.state}: {outcome.reason}")
        # The first group after the reference is not part of it.
        self._after(self._session.time_s + self._period_s, 1, idle)
        self.wait_for_reference(idle)
