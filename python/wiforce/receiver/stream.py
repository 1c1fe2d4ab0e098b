# SPDX-License-Identifier: GPL-3.0-or-later
"""Streams to readings: the room is surveyed while the sensor is untouched, then it is read."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from enum import Enum

import numpy as np

from ..errors import InputError
from ..estimation.capture.compression import Compression, measure_compression
from ..estimation.capture.folded_groups import FoldedGroups, Slips, SnapshotGroup
from ..estimation.groups import Array, Groups
from ..estimation.room.survey import Survey
from ..io.readings import DOUBTED, Flag, GroupCounts, Reading
from ..planning.adaptation import (
    adapted,
    expecting_snr,
    readapted,
    survey_reference,
    surveyed_snapshots,
)
from ..planning.findings import Finding, findings
from ..planning.plan import Plan, PlanOrScene, as_plan
from ..press.evidence import Suspicion
from ..press.sensor_state import SensorState
from ..press.tares import StreamTares, TareState
from .receiver import Receiver

# Flags of untouched groups in which the tag or the receiver may have changed, or the sensor may be
# touched after all, as while a reference is unverified.
_UNSTEADY = (DOUBTED & ~Flag.REFERENCE).words


class Occasion(Enum):
    """When the room is surveyed."""

    START = "from the first group on, before any is read"
    TARE = "from the request on; the user takes care that no sensor is touched"
    UNTOUCHED = "without a request, in groups that were received without a loss, read as untouched"


class SurveyedGroups:
    """Groups that are kept until they hold the snapshots of a survey."""

    def __init__(
        self, occasion: Occasion, snapshots: int, group_length: int, untouched_groups: int = 0
    ) -> None:
        self.occasion = occasion
        self.groups: list[SnapshotGroup] = []
        self._length = group_length
        self._unasked = occasion is Occasion.UNTOUCHED
        # The last group may be touched, as readings are one group late.
        self._needed = max(-(-snapshots // group_length), untouched_groups) + self._unasked
        self._last: int | None = None  # index of the last group that is surveyed

    def add(self, group: SnapshotGroup) -> None:
        """Keep a copy of the next group."""
        if self._unasked and self.groups and group.index != self.groups[-1].index + 1:
            # What the groups after a loss hold is known only when they have been read.
            self.groups = []
        self.groups.append(group.copy())

    def check(self, readings: Iterable[Reading]) -> None:
        """Leave out all groups up to the last one that was not read as untouched and steady."""
        if not self._unasked:
            return
        for reading in readings:
            assert reading.group is not None
            if reading.touch != 0 or _UNSTEADY & set(reading.flags):
                self.groups = [group for group in self.groups if group.index > reading.group]

    @property
    def first(self) -> int:
        """Index of the group with which the survey begins."""
        return 0 if self.occasion is Occasion.START else self.groups[0].index

    def end_survey(self) -> None:
        """Survey the groups kept so far; those that follow are only kept."""
        if self._last is None:
            self._last = self.groups[-1].index

    @property
    def _to_survey(self) -> list[SnapshotGroup]:
        if self._last is None:
            return self.groups
        return [group for group in self.groups if group.index <= self._last]

    @property
    def complete(self) -> bool:
        """Whether the groups hold all snapshots of the survey, or the time for it is over."""
        return bool(self.groups) and self.groups[-1].index + 1 - self.first >= self._needed

    @property
    def snapshots(self) -> Array:
        """Indices of the surveyed snapshots, 0 for the start of the first group."""
        begin = self.first * self._length
        return np.concatenate([group.snapshots for group in self._to_survey]) - begin

    @property
    def folded(self) -> Array:
        """Folded frames of these snapshots, shape (n, 64)."""
        return np.concatenate([group.folded[group.present] for group in self._to_survey])


class GroupsInPlace:
    """Leaves out groups that hold frames before a slip; those of a reference wait for it."""

    def __init__(self, group_length: int, reference_groups: int) -> None:
        self._slips = Slips(group_length)
        self._arrived: deque[SnapshotGroup] = deque()  # in which a slip may still be found
        self._newest, self._reference_end = -1, reference_groups

    def begin_reference(self, groups: int) -> None:
        """Measure a reference in so many groups from the next one on."""
        self._reference_end = self._newest + 1 + groups

    def process(self, groups: Iterable[SnapshotGroup]) -> Iterator[SnapshotGroup]:
        """Take the next groups; give those that are in place."""
        for group in groups:
            self._newest = group.index
            self._slips.add(group.misplaced)
            self._arrived.append(group)
            sure = group.index - self._slips.unsure
            while self._arrived and (
                self._arrived[0].index >= self._reference_end or self._arrived[0].index <= sure
            ):
                yield from self._marked(self._arrived.popleft())
            if self._arrived:
                self._arrived[-1] = group.copy()

    def flush(self) -> Iterator[SnapshotGroup]:
        """Give those that still wait."""
        while self._arrived:
            yield from self._marked(self._arrived.popleft())

    def _marked(self, group: SnapshotGroup) -> list[SnapshotGroup]:
        """The group, marked as first behind a slip; none of frames before one."""
        marks = self._slips.mark(group.index, group.retuned)
        if marks is None:
            return []
        if marks != (group.slipped, group.retuned):
            group = replace(group, slipped=marks[0], retuned=marks[1])
        return [group]


# Time after a survey until the next one, in s: a survey takes a tenth of a second of one core.
AGAIN_S = 10.0


class StreamReader:
    """Reads the phase groups of a stream as they arrive.

    Groups of the reference are kept until the room is surveyed in them, then read with weights that
    suit it. It is surveyed again after a tare, and every ``survey_again_s`` as soon as no sensor is
    touched for long enough; other weights begin behind a survey, with a reference of its groups.
    All this depends on the groups alone, and none is lost.

    ``on_groups`` gets every batch, groups of a later survey twice. ``mean_frame`` gives the mean of
    the first frames (n,), for compression. Tolerances above 1000 ppm need a survey.
    """

    def __init__(
        self, plan: PlanOrScene, tracked: bool = False, survey_again_s: float = AGAIN_S
    ) -> None:
        self.plan = self._scene_plan = plan = as_plan(plan)
        self.survey: Survey | None = None
        self.findings: list[Finding] | None = None
        self.counts = GroupCounts()
        self.on_groups: Callable[[Groups], None] | None = None
        self.mean_frame: Callable[[], Array] | None = None
        self.compression: Compression | None = None
        self.tares = StreamTares(self._request_tare, self._cancel_tare)
        self._tracked, self._again_s = tracked, survey_again_s
        self._in_place = GroupsInPlace(plan.group_length, plan.reference_groups)
        self._surveyed = surveyed_snapshots(plan)
        self._kept: SurveyedGroups | None = None  # None while no survey is waited for
        self._due: int | None = None  # group from which on the room may be surveyed again
        self._receiver: Receiver | None = None
        self._tones: FoldedGroups | None = None
        self._exchanged = ""  # state of the receiver that is being replaced
        if self._surveyed:
            self._kept = self._survey_at(Occasion.START)
            _ = plan.table, plan.sensors  # errors in them are raised before samples arrive
        else:
            self._use(plan)

    def process(self, groups: Sequence[SnapshotGroup]) -> list[Reading]:
        """Take the next groups, of rising indices, valid during the call; the ready readings."""
        return self._take(self._in_place.process(groups))

    def _take(self, groups: Iterable[SnapshotGroup]) -> list[Reading]:
        readings: list[Reading] = []
        waiting: list[SnapshotGroup] = []
        for group in groups:
            if self._receiver is not None:
                waiting.append(group)
            if self._kept is None and self._due is not None and group.index >= self._due:
                untouched = max(self.plan.reference_groups, self._acquisition_groups)
                self._kept = self._survey_at(Occasion.UNTOUCHED, untouched)
            if self._kept is None:
                continue
            self._kept.add(group)
            in_tare = self._kept.occasion is Occasion.TARE
            if not (in_tare or self._kept.complete):
                continue  # what they are read as can only make the survey end later
            ready, waiting = self._read(waiting), []
            self._kept.check(ready)
            readings += ready
            if in_tare and self.tares.state.state == "failed":
                self._kept = None
            elif self._kept.complete and not self.tares.measuring:
                self._kept.end_survey()
                if len(self._kept.groups) >= self._acquisition_groups:
                    readings += self._adapt(self._kept)
        ready = self._read(waiting)
        if self._kept is not None:
            self._kept.check(ready)
        return readings + ready

    @property
    def state(self) -> str:
        """What the reader is doing: ``acquiring``, ``reference`` or ``reading``."""
        # Other threads ask. An exchange is marked before another receiver is in use, and until that
        # one has read: looked at in this order, none is asked before it has.
        receiver = self._receiver
        if receiver is not None:
            return self._exchanged or receiver.state
        return "reference" if self._kept is not None and self._kept.groups else "acquiring"

    def reference_problem(self, sensor: str) -> str:
        """Why a sensor's untouched phases are not known; empty if they are, and for a surface."""
        state = self._state_of(sensor)
        return "" if state is None else state.problem

    def lasting_problem(self, sensor: str) -> str:
        """As :meth:`reference_problem`, of a second or more of readings, also if it is solved."""
        state = self._state_of(sensor)
        return "" if state is None else state.lasting_problem

    def final_problem(self, sensor: str) -> str:
        """The problem to name where no reading at all was clear."""
        state = self._state_of(sensor)
        return "" if state is None else state.final_problem

    def _state_of(self, sensor: str) -> SensorState | None:
        return None if self._receiver is None else self._receiver.states.get(sensor)

    def suspicions(self) -> dict[str, list[Suspicion]]:
        """Mistakes that the presses suggest: see ``Receiver.suspicions``."""
        return {} if self._receiver is None else self._receiver.suspicions()

    def _request_tare(self, force: bool) -> TareState:
        if self._receiver is None:
            reason = "the first reference is not complete"
            return self.tares.report(TareState("refused", reason, force))
        state = self._receiver.tare(force)
        if state.state == "measuring":
            self._in_place.begin_reference(self.plan.reference_groups)
            # What is touched in a forced tare is no room in which nothing is touched.
            if self._surveyed:
                self._kept = None if force else self._survey_at(Occasion.TARE)
        return state

    def _cancel_tare(self, reason: str) -> None:
        if self._receiver is not None:
            self._receiver.tares.cancel(reason)

    def finish(self) -> list[Reading]:
        """Give the readings of all groups that are still held back."""
        readings = self._take(self._in_place.flush())
        if self._receiver is None and self._kept is not None and self._kept.groups:
            readings += self._adapt(self._kept)
        return readings + self._receiver.finish() if self._receiver is not None else []

    @property
    def _acquisition_groups(self) -> int:
        """Groups that another receiver needs before it reads on; 0 for the first one."""
        return 0 if self._receiver is None else self._receiver.acquisition_groups

    def _survey_at(self, occasion: Occasion, untouched_groups: int = 0) -> SurveyedGroups:
        length = self.plan.group_length
        return SurveyedGroups(occasion, self._surveyed, length, untouched_groups)

    def _adapt(self, kept: SurveyedGroups) -> list[Reading]:
        """Survey the room in the groups kept, and go on with the plan that suits it."""
        self._kept = None
        last = kept.groups[-1].index
        self._due = last + 1 + round(self._again_s / self.plan.group_period_s)
        survey = survey_reference(self._scene_plan, kept.snapshots, kept.folded)
        if self._receiver is None:
            self.survey = survey
            if self.mean_frame is not None and len(frame := self.mean_frame()):
                self.compression = measure_compression(frame, self.plan.waveform)
            self._use(adapted(self._scene_plan, survey))
            return self._read(kept.groups)
        if survey is None:
            return []
        self.survey = survey
        better = self._better(survey)
        if better is self.plan:
            self._update_findings()
            return []
        # Other threads see the state; the new receiver acquires before it gives the next reading.
        self._exchanged = self._receiver.state
        try:
            readings = self._receiver.finish()
            self._use(better, last + 1)
            self._receiver.difference.begin_at(kept.first)
            return readings + self._read(kept.groups)
        finally:
            self._exchanged = ""

    def _better(self, survey: Survey) -> Plan:
        """The plan in use, or another one where that suits the room as it is."""
        try:
            return readapted(self.plan, self._scene_plan, survey)
        except (InputError, np.linalg.LinAlgError):
            # A second tag that could be meant has appeared, and ours is tracked; or LAPACK cannot
            # solve the other weights. Neither must end a run that can be read as it is.
            return self.plan

    def _use(self, plan: Plan, first_group: int = 0) -> None:
        """Read with a plan, and give the readings from a group on."""
        self.plan = plan
        self._tones = FoldedGroups(plan.table, plan.waveform)
        former = self._receiver
        receiver = Receiver(
            expecting_snr(plan.stating(compression=self.compression), self.survey),
            self._tracked,
            on_groups=self._give,
            first_group=first_group,
            counts=self.counts,
            states=None if former is None else former.states,
        )
        receiver.tares.on_state = self.tares.report
        self._receiver = receiver
        self._update_findings()

    def _give(self, groups: Groups) -> None:
        if self.on_groups is not None:
            self.on_groups(groups)

    def _update_findings(self) -> None:
        if self.survey is not None:
            self.findings = findings(self.survey, self._scene_plan, self.plan)

    def _read(self, groups: Sequence[SnapshotGroup]) -> list[Reading]:
        if not groups or self._receiver is None or self._tones is None:
            return []
        return self._receiver.process(self._tones.groups(groups))
