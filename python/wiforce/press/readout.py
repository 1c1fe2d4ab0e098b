# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of all sensors from the ratios R of a batch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..estimation.estimators import RatioUnfolder
from ..estimation.groups import Array, Groups
from ..io.readings import Flag, GroupCounts, Reading, SurfaceReading, flag_words, reading_of
from ..wiforce_kernels import receiver_steps
from .explanations import later
from .sensor_readout import SensorReading, SensorReadout, as_arrays
from .surface_readout import SurfaceReadout

# Longest gap in the stream that is filled with rows flagged "gap": an hour, 100 000 rows. A longer
# one is more likely a wrong time of the device than lost samples.
_LONGEST_GAP_S = 3600.0
_GAP = flag_words(Flag.GAP.value)


class Readout:
    """Gives the readings of all sensors of a run, one group late.

    What a group was is clear when the next one is known. Earlier groups than ``first_group`` are
    not given; ``counts`` continues those of the readings given before. R is a ``change``, ``step``
    or ``square`` (see ``estimators.Estimator``).
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
        self._steps = receiver_steps(group_period_s)
        self._waiting: Groups | None = None
        self._flags: Array = np.zeros((0, len(sensors)), np.int64)  # of the group that waits
        self.on_groups = on_groups
        self._next = first_group
        self.counts = GroupCounts() if counts is None else counts

    def process(self, groups: Groups) -> list[Reading]:
        """Take a batch; give the readings that are ready, in order."""
        if not len(groups):
            return []
        groups = self._unfolder.process(groups)
        receiver = self._steps.process(
            groups.static, groups.ratios, groups.reference_power, groups.locked
        )
        taken = [sensor.take(groups, i, receiver) for i, sensor in enumerate(self.sensors.values())]
        flags = np.concatenate([self._flags, np.array([f for _, f in taken]).T])
        given, begins = groups[:-1], self._waiting is None
        if self._waiting is not None:
            given = Groups.concatenate([self._waiting, given]) if len(given) else self._waiting
        self._waiting, self._flags = groups[-1:], flags[-1:]
        found = [later(f[f["row"] > 0], -1) if begins else f for f, _ in taken]
        return self._read(given, found, flags[:-1])

    def _read(self, groups: Groups, found: list[Array], flags: Array) -> list[Reading]:
        if not len(groups):
            return []
        read = [
            sensor.read(groups, i, found[i], flags[:, i])
            for i, sensor in enumerate(self.sensors.values())
        ]
        if self.on_groups is not None or self._surface is not None:
            groups = groups.having(**as_arrays(read))
        if self.on_groups is not None:
            self.on_groups(groups)
        return self._rows(groups, read)

    def flush(self, groups: int = 0) -> list[Reading]:
        """Give the last group's readings, and those of groups that were not received after it.

        The run spans ``groups``.
        """
        readings: list[Reading] = []
        if self._waiting is not None:
            index = int(self._waiting.index[0])
            found = [sensor.state.newest_of(index) for sensor in self.sensors.values()]
            readings = self._read(self._waiting, found, self._flags)
            self._waiting, self._flags = None, self._flags[:0]
        readings += self._fill(groups)
        self._next = max(self._next, groups)
        return readings

    def _rows(self, groups: Groups, read: list[SensorReading]) -> list[Reading]:
        """Readings of groups, and of the groups before them that were not received."""
        readings: list[Reading] = []
        columns = [self._columns(groups, i, each) for i, each in enumerate(read)]
        of_surface = None if self._surface is None else self._surface.read(groups, self._period_s)
        for row, index in enumerate(groups.index.tolist()):
            if index < self._next:
                continue
            if index > self._next:
                readings += self._fill(index)
            time_s = (index + 0.5) * self._period_s
            own: list[Reading] = [
                reading_of((time_s, name, *column[row]))
                for name, column in zip(self.sensors, columns, strict=True)
            ]
            if of_surface is not None:
                own += of_surface[row]
            self.counts.note(own)
            readings += own
            self._next = index + 1
        return readings

    @staticmethod
    def _columns(groups: Groups, sensor: int, read: SensorReading) -> list[tuple]:
        """The fields of one sensor's readings behind its name, row by row."""
        snr_db = groups.snr_db[:, 2 * sensor : 2 * sensor + 2].min(axis=1)
        snr_db[read.touch < 0] = np.nan
        touches = [None if value < 0 else value for value in read.touch.tolist()]
        columns = *read.values.T.tolist(), *read.phases_deg.T.tolist(), snr_db.tolist()
        # NaN is the number that differs from itself.
        numbers = [[v if v == v else None for v in column] for column in columns]
        words = map(flag_words, read.flags.tolist())
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
