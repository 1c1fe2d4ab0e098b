# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings to readings: tones, ends and readings of three batches at the same time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..estimation.capture.compression import measure_compression
from ..estimation.capture.folded_groups import RecordedGroups, RecordedRatio, first_frames
from ..estimation.capture.frame import samples_needed
from ..estimation.capture.recorded_frames import (
    find_frames,
    first_frame,
    offset_problem,
    preamble_problem,
)
from ..estimation.groups import Groups
from ..estimation.room.survey import Survey
from ..io.capture.names import second_antenna
from ..io.capture.recordings import Capture, open_capture
from ..io.readings import GroupCounts, Reading
from ..planning.adaptation import adapted, expecting_snr, survey_reference, surveyed_snapshots
from ..planning.plan import Plan, PlanOrScene, as_plan
from ..press.evidence import Suspicion
from ..scene.consistency import ONE_ANTENNA, lacks_antenna
from .receiver import Receiver

# Frames that the receiver's compression is measured in: noise is reduced by 30 dB.
_COMPRESSION_FRAMES = 1000
# Batches that may be folded, or separated, ahead of the one that is read: some take longer than
# others. With one of each, the threads often wait for each other.
_AHEAD = 3


class CaptureReader:
    """Reads a capture batch by batch; iterating gives the readings of each, in order.

    ``notes`` are what is wrong with the file, a sentence each, ``plan`` is the one adapted to it.
    """

    times_ignored = 0
    notes: list[str]
    plan: Plan
    receiver: Receiver

    def __init__(self, path: Path, plan: Plan, groups: int) -> None:
        needed = plan.reference_groups + 1
        if groups < needed:
            rule = (
                f"must hold {needed} phase groups or more ({needed * plan.group_period_s:.3g} s) "
                "from its first frame or packet on: the untouched reference, and one to read; "
                "`check` says whether the file is complete"
            )
            raise InputError(path, rule, max(0, groups))
        self.groups = groups  # whole ones that the capture spans

    @property
    def counts(self) -> GroupCounts:
        """Group counts by outcome, so far."""
        return self.receiver.counts

    def suspicions(self) -> dict[str, list[Suspicion]]:
        """Mistakes that the presses so far suggest: see ``Receiver.suspicions``."""
        return self.receiver.suspicions()

    def samples_missing(self) -> dict[Path, int]:
        """Samples that each file lacked because it was cut short while it was read."""
        return {}

    def frames_moved(self) -> dict[Path, int]:
        """How often the frames of each file were found at another place than before."""
        return {}

    def __iter__(self) -> Iterator[list[Reading]]:
        raise NotImplementedError


class RecordingReader(CaptureReader):
    """Reads a recording of samples.

    ``frame_offset`` is searched if not given, and compared otherwise (``notes``). Refuses captures
    without frames, of another length, or shorter than the reference and one group.
    """

    def __init__(
        self,
        recording: Capture,
        plan: PlanOrScene,
        frame_offset: int | None = None,
        tracked: bool = False,
        on_groups: Callable[[Groups], None] | None = None,
    ) -> None:
        if frame_offset is not None and not (
            isinstance(frame_offset, int | np.integer) and frame_offset >= 0
        ):
            raise InputError("frame_offset", "must be an integer of at least 0", frame_offset)
        plan = as_plan(plan)
        scene = plan.require_scene()
        if scene.packets is not None:
            rule = "holds samples, but the scene has 'packets': it describes channel snapshots"
            raise InputError(recording.path, rule)
        recording.check_against(scene)
        self.recording = recording
        problem = ""
        if frame_offset is None:
            frame_offset, place = first_frame(recording, plan.waveform)
            samples = recording.read_span(place, samples_needed(plan.waveform.frame_length))
            problem = preamble_problem(samples, plan.waveform)
        # Who states where frames begin may know of some that are too weak to be found.
        elif (seen := find_frames(recording, plan.waveform)) is not None:
            problem = offset_problem(recording, plan.waveform, seen, frame_offset)
        self.notes = [problem] if problem else []
        if lacks_antenna(scene):
            self.notes.append(
                f"{ONE_ANTENNA}: no reading is usable, unless both share a clock; record two "
                "antennas (receive_antennas: 2)"
            )
        self.frame_offset = frame_offset
        self.plan = plan = plan.with_first_frame(frame_offset)
        samples_of_group = plan.group_length * plan.waveform.frame_length
        super().__init__(recording.path, plan, (recording.span - frame_offset) // samples_of_group)
        self._folding, self._ends = ThreadPoolExecutor(1, "tones"), ThreadPoolExecutor(1, "ends")
        with ExitStack() as refused:
            for pool in (self._ends, self._folding):
                refused.callback(partial(pool.shutdown, cancel_futures=True))
            # The first batch is folded while the room is surveyed: most rooms need no other
            # weights. Those that do wait for it.
            self._fold(plan)
            self.survey = survey_recording(recording, plan, frame_offset)
            expected, plan = plan, adapted(plan, self.survey)
            if plan.table is not expected.table:
                self._fold(plan)
            if scene.environment.receive_antennas == 1:
                # As measured before the first gap.
                stop = frame_offset + _COMPRESSION_FRAMES * plan.waveform.frame_length
                samples = recording.read(stop)[frame_offset : recording.segments[0].length]
                found = measure_compression(samples, plan.waveform)
                plan = expecting_snr(plan.stating(compression=found), self.survey)
            self.plan = plan
            self.receiver = Receiver(plan, tracked, on_groups=on_groups)
            # Batches are folded and separated, without Python's lock, while one is read.
            self._folded.extend(self._folding.submit(self.source.read) for _ in range(_AHEAD - 1))
            self._separated = deque(self._ends.submit(self._separate) for _ in range(_AHEAD))
            refused.pop_all()

    def _fold(self, plan: Plan) -> None:
        """Fold the groups from the first one on by the weights of a plan."""
        self.source = groups_of(self.recording, plan, self.frame_offset)
        self._folded = deque([self._folding.submit(self.source.read)])

    def _separate(self) -> Groups | None:
        """The next batch with its ends; None at the end."""
        groups = self._folded.popleft().result()
        self._folded.append(self._folding.submit(self.source.read))
        return self.receiver.separate(groups) if len(groups) else None

    def samples_missing(self) -> dict[Path, int]:
        return {path: kernel.samples_missing() for path, kernel in self.source.kernels.items()}

    def frames_moved(self) -> dict[Path, int]:
        return {path: kernel.frames_moved() for path, kernel in self.source.kernels.items()}

    def __iter__(self) -> Iterator[list[Reading]]:
        with self._folding, self._ends:
            try:
                separated = self._separated.popleft().result()
                if separated is None:
                    raise InputError(self.recording.path, "holds no whole frame of finite samples")
                while separated is not None:
                    self._separated.append(self._ends.submit(self._separate))
                    yield self.receiver.read(separated)
                    separated = self._separated.popleft().result()
            finally:
                for pool in (self._ends, self._folding):
                    pool.shutdown(wait=False, cancel_futures=True)
        yield self.receiver.finish(self.groups)


def survey_recording(recording: Capture, plan: Plan, frame_offset: int) -> Survey | None:
    """Survey the room at the start of a recording; None below 0.1 s without gaps."""
    count = surveyed_snapshots(plan)
    if not count:
        return None
    recordings = _recordings(recording, plan)
    frames = first_frames(recordings, plan.waveform, frame_offset, count, plan.group_length)
    return survey_reference(plan, *frames)


def groups_of(recording: Capture, plan: Plan, frame_offset: int) -> RecordedGroups | RecordedRatio:
    """What reads the groups of a recording, or of it and that of a second antenna beside it."""
    first, *second = _recordings(recording, plan)
    if not second:
        return RecordedGroups(first, plan.table, plan.waveform, frame_offset)
    return RecordedRatio((first, second[0]), plan.table, plan.waveform, frame_offset)


def _recordings(recording: Capture, plan: Plan) -> tuple[Capture, ...]:
    """A recording and, where the scene has two antennas, that of the second one beside it."""
    scene = plan.require_scene()
    if scene.environment.receive_antennas == 1:
        return (recording,)
    beside = open_capture(second_antenna(recording.path.with_suffix("")))
    beside.check_against(scene)
    return recording, beside
