# SPDX-License-Identifier: GPL-3.0-or-later
"""Phase groups of a recording, of one antenna or of the ratio of two."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from .estimation.antennas import folded_ratio, ratio_noise
from .estimation.folded_groups import FoldedGroups
from .estimation.groups import Groups, is_clipped
from .estimation.snapshot_group import GroupScreen, SnapshotGroup
from .io.capture import Capture, open_capture
from .io.capture_files import second_antenna
from .planning.plan import Plan
from .signal.waveform import FFT_LENGTH
from .wiforce_kernels import folded_reader, tone_reader

# Groups that are read at a time. Larger batches are not faster, smaller ones are slower.
_BATCH = 256


def groups_of(recording: Capture, plan: Plan, frame_offset: int) -> _OneAntenna | _TwoAntennas:
    """What reads the groups of a recording.

    Parameters
    ----------
    recording : Capture
    plan : Plan
        Of its scene, which says how many antennas there are.
    frame_offset : int
        Samples before the first frame.

    Returns
    -------
    object
        Its ``read()`` gives the next Groups of tones, an empty one at the end; ``kernels`` are the
        readers of the files, by path, and ``captures`` the recordings.

    Examples
    --------
    >>> groups_of(open_capture("press"), plan("demo"), 0).read()  # doctest: +SKIP
    """
    kind = _TwoAntennas if _has_two(plan) else _OneAntenna
    return kind(recording, plan, frame_offset)


def first_frames(
    recording: Capture, plan: Plan, frame_offset: int, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """The first frames of a recording, without Python's lock.

    Parameters
    ----------
    recording, plan, frame_offset
        As for :func:`groups_of`.
    count : int
        Frames wanted.

    Returns
    -------
    snapshots : ndarray of int, shape (n,)
        Their indices; fewer than wanted where the recording ends.
    folded : ndarray of complex, shape (n, 64)
        Of two antennas, those of their ratio.

    Examples
    --------
    >>> first_frames(open_capture("press"), plan("demo"), 0, 100)  # doctest: +SKIP
    """
    if _has_two(plan):
        snapshots, folded, *_ = _AntennaFrames(recording, plan, frame_offset).read(count)
        return snapshots, folded
    found = folded_reader(**_frame_settings(recording, plan, frame_offset)).read(count)
    return found["snapshot"], found["folded"]


def _has_two(plan: Plan) -> bool:
    return plan.require_scene().environment.receive_antennas == 2


def _frame_settings(recording: Capture, plan: Plan, frame_offset: int) -> dict[str, Any]:
    return {
        "path": os.fsencode(recording.path),
        "datatype": recording.datatype,
        "segments": [(s.file_sample, s.global_index, s.length) for s in recording.segments],
        **plan.waveform.folding,
        "frame_offset": frame_offset,
    }


class _OneAntenna:
    """Groups of a recording with one antenna, by the kernels."""

    def __init__(self, recording: Capture, plan: Plan, frame_offset: int) -> None:
        waveform, table = plan.waveform, plan.table
        self._length = plan.group_length
        self._folded = FoldedGroups(table, waveform)
        self._kernel = tone_reader(
            **_frame_settings(recording, plan, frame_offset),
            weights=table.weights,
            factors=waveform.equalizer(),
            rotation=table.derotation(waveform.sample_rate_hz),
            bins=waveform.bins,
        )
        self.captures: tuple[Capture, ...] = (recording,)
        self.kernels = {recording.path: self._kernel}

    def read(self) -> Groups:
        found = self._kernel.read(_BATCH)
        groups = Groups(
            found["index"],
            found["tones"],
            found["missing"],
            is_clipped(found["saturated"], self._length),
            interference=found["rejected"] / self._length,
        )
        if found["incomplete"]:
            weights = np.ones((len(groups), self._length), bool)
            for row, present, folded in found["incomplete"]:
                found["tones"][row], weights[row] = self._folded.solve(present, folded)
            groups.snapshot_weights = weights
            groups.missing[~weights.any(axis=1)] = self._length
        return groups


class _AntennaFrames:
    """Frames of the ratio of two antennas, recorded side by side."""

    def __init__(self, recording: Capture, plan: Plan, frame_offset: int) -> None:
        beside = open_capture(second_antenna(recording.path.with_suffix("")))
        beside.check_against(plan.require_scene())
        self._waveform = plan.waveform
        self.captures = recording, beside
        self.kernels = {
            each.path: folded_reader(**_frame_settings(each, plan, frame_offset))
            for each in self.captures
        }

    def read(self, count: int) -> tuple[np.ndarray, ...]:
        """Index of the next frames that both have, ratio folded, its noise, saturation."""
        first, second = (kernel.read(count) for kernel in self.kernels.values())
        common, rows, others = np.intersect1d(
            first["snapshot"], second["snapshot"], return_indices=True
        )
        folded = first["folded"][rows], second["folded"][others]
        ratio = folded_ratio(*folded, self._waveform)
        noise = ratio_noise(folded, (first["noise"][rows], second["noise"][others]), ratio)
        return common, ratio, noise, first["saturated"][rows]


class _TwoAntennas:
    """Groups of the ratio of two antennas."""

    def __init__(self, recording: Capture, plan: Plan, frame_offset: int) -> None:
        self._length = plan.group_length
        self._folded = FoldedGroups(plan.table, plan.waveform)
        self._screen = GroupScreen(plan.group_length)
        self._frames = _AntennaFrames(recording, plan, frame_offset)
        self.captures, self.kernels = self._frames.captures, self._frames.kernels
        self._kept: tuple[np.ndarray, ...] = self._read_frames()

    def read(self) -> Groups:
        """The next groups; a group ends with its last frame, or before a frame of a later one."""
        while len(self._kept[0]) and self._kept[0][0] // self._length == (
            self._kept[0][-1] // self._length
        ):
            more = self._read_frames()
            if not len(more[0]):
                return self._groups(self._frames_before(self._kept[0][-1] + 1))
            self._kept = tuple(map(np.concatenate, zip(self._kept, more, strict=True)))
        if not len(self._kept[0]):
            return Groups(np.zeros(0, np.int64))
        return self._groups(self._frames_before(self._kept[0][-1]))

    def _frames_before(self, snapshot: int) -> int:
        """Number of kept frames that belong to groups complete before a snapshot."""
        whole = snapshot // self._length * self._length
        return int(np.searchsorted(self._kept[0], whole))

    def _read_frames(self) -> tuple[np.ndarray, ...]:
        return self._frames.read(_BATCH * self._length // 4)

    def _groups(self, count: int) -> Groups:
        """Groups of the first frames that are kept."""
        if not count:
            return Groups(np.zeros(0, np.int64))
        first, self._kept = (
            tuple(values[:count] for values in self._kept),
            tuple(values[count:] for values in self._kept),
        )
        starts = np.unique(first[0] // self._length, return_index=True)[1]
        runs = zip(*(np.split(values, starts[1:]) for values in first), strict=True)
        return self._folded.groups([self._screen.process(self._group(*run)) for run in runs])

    def _group(
        self, snapshots: np.ndarray, folded: np.ndarray, noise: np.ndarray, saturated: np.ndarray
    ) -> SnapshotGroup:
        length = self._length
        slots = snapshots % length
        present = np.zeros(length, bool)
        present[slots] = True
        every = np.zeros((length, FFT_LENGTH), np.complex64), np.zeros((length, 2))
        every[0][slots], every[1][slots] = folded, noise
        return SnapshotGroup(int(snapshots[0] // length), *every, present, int(saturated.sum()))
