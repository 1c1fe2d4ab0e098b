# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: phase changes of the ends to readings of force and location."""

from threading import Event

import numpy as np
import pmt

from .. import names
from ..errors import InputError
from ..estimation.readout import Readout
from ..sensor import load_sensor
from .group_block import GroupBlock, state_of


class force_inversion(GroupBlock):
    """Readings from the ratios R of each group.

    Input: vectors 2S from ``subcarrier_average``, tagged ``state``.
    Message port ``readings`` (out): a dict per group and sensor, keys as the columns of a readings
    file, what is unknown left out.

    Parameters
    ----------
    models : sequence of str or SensorModel
        Shipped sensor or path, one per sensor.
    center_frequency : float
        Carrier in Hz.
    group_period : float
        Seconds.
    sensor_names : sequence of str, optional
        ``sensor1``, ``sensor2``, ... when not given.
    off_reflections : sequence, optional
        G_off / rho per sensor: complex, or two of them when the switches differ.
    tracked : bool
        Follow each press over time instead of inverting each group by itself.
    ratios : str
        What the R are: ``change`` against the untouched sensor, ``step`` against the group
        before (paper, section 3.3), or ``square`` of the change (estimator ``sideband``).
    on_reading : callable, optional
        Called with every :class:`Reading` in the block's thread. For programs that must not lose
        the last readings of a finite stream, as message ports do.

    Attributes
    ----------
    on_ratios : callable or None
        When set, called with GroupState and R (2S,) of every group before it is read.
    ended : threading.Event
        Set when the stream has ended and its last group is read.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.
    """

    def __init__(
        self,
        models=("wiforce-900mhz",),
        center_frequency=900e6,
        group_period=0.036,
        sensor_names=None,
        off_reflections=None,
        tracked=False,
        ratios="change",
        on_reading=None,
    ):
        if not models:
            raise InputError("models", "must name at least one sensor", models)
        if not group_period > 0:
            raise InputError("group_period", "must be positive", group_period)
        labels = sensor_names or [f"sensor{i + 1}" for i in range(len(models))]
        offs = off_reflections or [0.0] * len(models)
        if not len(labels) == len(offs) == len(models):
            raise InputError("sensor_names, off_reflections", f"must have {len(models)} entries")
        if not center_frequency > 0:
            raise InputError("center_frequency", "must be positive", center_frequency)
        if not np.all(np.abs(np.hstack(offs)) < 1):
            raise InputError("off_reflections", "must be below 1 in magnitude", offs)
        loaded = [load_sensor(m) if isinstance(m, str) else m for m in models]
        sensors = list(zip(labels, loaded, offs, strict=True))
        self.readout = Readout(sensors, center_frequency, group_period, tracked, ratios)
        self._on_reading = on_reading
        self.on_ratios = None
        self.ended = Event()
        GroupBlock.__init__(self, "force_inversion", 2 * len(models), 0)
        self.message_port_register_out(pmt.intern(names.READINGS))

    @property
    def counts(self):
        """Groups by what became of them: a :class:`io.readings.GroupCounts`."""
        return self.readout.counts

    def take(self, tags, item):
        self.read(state_of(tags), np.asarray(item, complex))
        return []

    def read(self, state, ratios):
        """Reads one group: R of every end, complex (2S,)."""
        if self.on_ratios is not None:
            self.on_ratios(state, ratios)
        self._publish(self.readout.process(state, ratios))

    def finish(self):
        """Gives the last group's readings, which waited for their neighbour."""
        self._publish(self.readout.flush())

    def start(self):
        self.ended.clear()
        return True

    def stop(self):
        try:
            self.finish()
        except Exception as error:
            # Raised through the scheduler it would abort the process.
            self.failure = self.failure or error
        self.ended.set()
        return True

    def _publish(self, readings):
        for reading in readings:
            if self._on_reading is not None:
                self._on_reading(reading)
            known = {key: value for key, value in reading.row().items() if value is not None}
            self.message_port_pub(pmt.intern(names.READINGS), pmt.to_pmt(known))
