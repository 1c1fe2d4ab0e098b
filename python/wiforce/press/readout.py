# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of all sensors from the ratios R of a batch."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..estimation.groups import Array, Groups
from ..io.readings import (
    Flag,
    GroupCounts,
    Reading,
    SurfaceReading,
    flag_words,
    reading_of,
)
from ..wiforce_kernels import reading_fields, receiver_steps
from .sensor_readout import ARRAYS, SensorReadout
from .surface_readout import SurfaceReadout

# Longest gap in the stream that is filled with rows flagged "gap": an hour, 100 000 rows. A longer
# one is more likely a wrong time of the device than lost samples.
_LONGEST_GAP_S = 3600.0
_GAP = flag_words(Flag.GAP.value)


class Readout:
    """Gives the readings of all sensors of a run, one group late.

    What a group was is clear when the next one is known. Earlier groups than ``first_group`` are
    not given; ``counts`` continues those of the readings given before. Group 0 begins at
    ``start_s``.
    """

    def __init__(
        self,
        sensors: dict[str, SensorReadout],
        group_period_s: float,
        on_groups: Callable[[Groups], None] | None = None,
        first_group: int = 0,
        counts: GroupCounts | None = None,
        surface: SurfaceReadout | None = None,
        start_s: float = 0.0,
    ) -> None:
        self.sensors, self._surface = sensors, surface
        self._period_s, self._start_s = group_period_s, start_s
        self._steps = receiver_steps(group_period_s)
        # The group that waits, and what the stages before say of it, by sensor.
        self._waiting: tuple[Groups, list[Array]] | None = None
        self.on_groups = on_groups
        self._next = first_group
        self.counts = GroupCounts() if counts is None else counts

    def process(self, groups: Groups) -> list[Reading]:
        """Take a batch; give the readings that are ready, in order."""
        if not len(groups):
            return []
        receiver = self._steps.process(
            groups.static, groups.ratios, groups.reference_power, groups.locked
        )
        taken = [sensor.take(groups, i, receiver) for i, sensor in enumerate(self.sensors.values())]
        waiting, self._waiting = self._waiting, (groups[-1:], [known[-1:] for _, known in taken])
        # Outcomes are those of the group before each.
        readings = [] if waiting is None else self._read(*waiting, [found for found, _ in taken])
        if len(groups) > 1:
            readings += self._read(
                groups[:-1], [known[:-1] for _, known in taken], [found for found, _ in taken], 1
            )
        return readings

    def _read(
        self, groups: Groups, stages: list[Array], found: list[Array], begin: int = 0
    ) -> list[Reading]:
        sensors = self.sensors.values()
        each = zip(sensors, found, stages, strict=True)
        rows = [sensor.read(of, known, begin) for sensor, of, known in each]
        # As bytes: NumPy would copy them field by field.
        read = np.stack([own.view(np.void) for own in rows], axis=1).view(rows[0].dtype)
        if self.on_groups is not None or self._surface is not None:
            groups = groups.having(**{name: read[name] for name in ARRAYS})
        if self.on_groups is not None:
            self.on_groups(groups)
        return self._rows(groups, read)

    def flush(self, groups: int = 0) -> list[Reading]:
        """Give the last group's readings, and those of groups that were not received after it.

        The run spans ``groups``.
        """
        readings: list[Reading] = []
        if self._waiting is not None:
            index = int(self._waiting[0].index[0])
            found = [sensor.state.newest_of(index) for sensor in self.sensors.values()]
            readings, self._waiting = self._read(*self._waiting, found), None
        readings += self._fill(groups)
        self._next = max(self._next, groups)
        return readings

    def _rows(self, groups: Groups, read: Array) -> list[Reading]:
        """Readings of groups, and of the groups before them that were not received."""
        readings: list[Reading] = []
        names = list(self.sensors)
        fields = reading_fields(read, names, self._period_s, self._start_s, flag_words)
        of_surface = None
        if self._surface is not None:
            times_s = (groups.index + 0.5) * self._period_s + self._start_s
            of_surface = self._surface.read(groups, times_s.tolist())
        for row, index in enumerate(groups.index.tolist()):
            if index < self._next:
                continue
            if index > self._next:
                readings += self._fill(index)
            own = list(map(reading_of, fields[len(names) * row : len(names) * (row + 1)]))
            if of_surface is not None:
                own += of_surface[row]
            self.counts.note(own)
            readings += own
            self._next = index + 1
        return readings

    def _fill(self, index: int) -> list[Reading]:
        first = self._next
        self.counts.dropped += max(0, index - first)
        if index - first > _LONGEST_GAP_S / self._period_s:
            return []
        surface = () if self._surface is None else self._surface.names
        kinds = {**dict.fromkeys(self.sensors, Reading), **dict.fromkeys(surface, SurfaceReading)}
        return [
            kind((absent + 0.5) * self._period_s + self._start_s, name, flags=_GAP, group=absent)
            for absent in range(first, index)
            for name, kind in kinds.items()
        ]
