# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of all sensors from the ratios R of a batch."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..io.readings import Flag, GroupCounts, Reading, SurfaceReading, flag_words
from .estimators import RatioUnfolder
from .groups import Groups
from .sensor_readout import SensorReadout
from .surface_readout import SurfaceReadout
from .transition import TransitionFlags

# Longest gap in the stream that is filled with rows flagged "gap": an hour, 100 000 rows. A longer
# one is more likely a wrong time of the device than lost samples.
_LONGEST_GAP_S = 3600.0
_GAP = flag_words(Flag.GAP.value)


class Readout:
    """Gives the readings of all sensors of a run.

    Readings are one group late, because a transition is detected by comparison with the neighbours.
    The first group of a touch is a transition in any case, and is given at once.

    Parameters
    ----------
    sensors : dict of str to SensorReadout
        By name, in the order of the ends, two per sensor.
    group_period_s : float
        Length of a group, in s.
    ratios : str
        Meaning of R: ``change``, ``step`` or ``square`` (see ``estimators.Estimator``).
    on_groups : callable, optional
        Called with every batch of Groups that has been read, before transitions are flagged.
    first_group : int
        The first group whose readings are given.
    counts : GroupCounts, optional
        Of the readings given before, which are counted on.
    surface : SurfaceReadout, optional
        Gives the readings of the surface, which follow those of the sensors.

    Attributes
    ----------
    sensors : dict of str to SensorReadout
        As given.
    counts : GroupCounts
        Outcomes of the readings given so far.

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> model = wiforce.load_sensor("line-900mhz")
    >>> sensors = {"arm": SensorReadout(model, 900e6, 0j, 0.036)}
    >>> readout = Readout(sensors, 0.036)
    >>> none = np.zeros((1, 2), bool)
    >>> readout.process(Groups(
    ...     [0], ratios=np.ones((1, 2)), phase_std_deg=np.full((1, 2), 0.1),
    ...     snr_db=np.full((1, 2), 10.0), locked=np.ones((1, 1), bool),
    ...     overlapping=np.zeros((1, 1), bool), new_reference=np.ones(1, bool), in_reference=~none,
    ...     late_reference=none, reshaped=none))
    []
    >>> [(reading.sensor, reading.touch, reading.flags) for reading in readout.flush()]
    [('arm', 0, ('reference',))]
    """

    def __init__(
        self,
        sensors: dict[str, SensorReadout],
        group_period_s: float,
        ratios: str = "change",
        on_groups: Callable[[Groups], None] | None = None,
        first_group: int = 0,
        counts: GroupCounts | None = None,
        surface: SurfaceReadout | None = None,
    ) -> None:
        self.sensors, self._surface = sensors, surface
        self._period_s = group_period_s
        self._unfolder = RatioUnfolder(ratios)
        self._transitions = TransitionFlags()
        self.on_groups = on_groups
        self._next = first_group
        self.counts = GroupCounts() if counts is None else counts

    def process(self, groups: Groups) -> list[Reading]:
        """Take a batch.

        Parameters
        ----------
        groups : Groups
            With ``ratios`` and the arrays of the stages before.

        Returns
        -------
        list of Reading
            The readings that are ready, in order.
        """
        if not len(groups):
            return []
        groups = self._unfolder.process(groups)
        read = [sensor.read(groups, i) for i, sensor in enumerate(self.sensors.values())]
        arrays = {name: np.array([each[name] for each in read]).swapaxes(0, 1) for name in read[0]}
        groups = groups.having(**arrays)
        if self.on_groups is not None:
            self.on_groups(groups)
        return self._rows(self._transitions.process(groups))

    def flush(self, groups: int = 0) -> list[Reading]:
        """Give the last group's readings, and those of the groups that were not received after it.

        Parameters
        ----------
        groups : int, optional
            Number of groups that the run spans.

        Returns
        -------
        list of Reading
        """
        readings = self._rows(self._transitions.flush())
        readings += self._fill(groups)
        self._next = max(self._next, groups)
        return readings

    def _rows(self, groups: Groups) -> list[Reading]:
        """Readings of groups, and of the groups before them that were not received."""
        if not len(groups):
            return []
        readings: list[Reading] = []
        columns = [self._columns(groups, i) for i in range(len(self.sensors))]
        of_surface = None if self._surface is None else self._surface.read(groups, self._period_s)
        for row, index in enumerate(groups.index.tolist()):
            if index < self._next:
                continue
            readings += self._fill(index)
            time_s = (index + 0.5) * self._period_s
            own: list[Reading] = [
                Reading(time_s, name, *column[row])
                for name, column in zip(self.sensors, columns, strict=True)
            ]
            if of_surface is not None:
                own += of_surface[row]
            self.counts.note(own)
            readings += own
            self._next = index + 1
        return readings

    @staticmethod
    def _columns(groups: Groups, sensor: int) -> list[tuple]:
        """The fields of one sensor's readings behind its name, row by row."""
        touch = groups.touch[:, sensor]
        snr_db = groups.snr_db[:, 2 * sensor : 2 * sensor + 2].min(axis=1)
        arrays = [
            groups.force_n[:, sensor],
            groups.force_std_n[:, sensor],
            groups.location_mm[:, sensor],
            groups.location_std_mm[:, sensor],
            groups.phases_deg[:, sensor, 0],
            groups.phases_deg[:, sensor, 1],
            np.where(touch >= 0, snr_db, np.nan),
        ]
        touches = [None if value < 0 else value for value in touch.tolist()]
        numbers = [[None if math.isnan(v) else v for v in a.tolist()] for a in arrays]
        words = map(flag_words, groups.flags[:, sensor].tolist())
        index, interference = groups.index.tolist(), groups.interference.tolist()
        return list(zip(touches, *numbers, words, index, interference, strict=True))

    def _fill(self, index: int) -> list[Reading]:
        first = self._next
        self.counts.dropped += max(0, index - first)
        if index - first > _LONGEST_GAP_S / self._period_s:
            return []
        surface = () if self._surface is None else self._surface.names
        kinds = {**dict.fromkeys(self.sensors, Reading), **dict.fromkeys(surface, SurfaceReading)}
        return [
            kind((absent + 0.5) * self._period_s, name, flags=_GAP, group=absent)
            for absent in range(first, index)
            for name, kind in kinds.items()
        ]
