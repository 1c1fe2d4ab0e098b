# SPDX-License-Identifier: GPL-3.0-or-later
"""Tones of the phase groups of a recording, a batch at a time."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from ...io.capture.recordings import Capture
from ...signal.waveform import Waveform
from ...signal.weights import ToneTable
from ...wiforce_kernels import folded_reader, tone_reader
from ..groups import Array, Groups, is_clipped
from .antennas import folded_ratio, ratio_noise
from .folded_groups import FoldedGroups, kernel_rows
from .snapshot_group import GroupScreen, SnapshotGroup

# Groups that are read at a time, of the default symbol; fewer of a longer one, whose tones would
# otherwise fill the memory. Larger batches are not faster, smaller ones are slower.
_BATCH, _BATCH_SYMBOL = 256, 64


def groups_at_once(waveform: Waveform) -> int:
    """Groups that are read at a time; it changes no reading."""
    return max(1, _BATCH * _BATCH_SYMBOL // max(_BATCH_SYMBOL, waveform.symbol_length))


def frame_settings(recording: Capture, waveform: Waveform, frame_offset: int) -> dict[str, Any]:
    """The parameters by which kernels and ``recording_source`` find the frames of a file.

    Returns dict: by name.

    Parameters
    ----------
    waveform : Waveform
        As it was sent.
    frame_offset : int
        Samples before the first frame.
    """
    return {
        "path": os.fsencode(recording.path),
        "datatype": recording.datatype,
        "segments": [(s.file_sample, s.global_index, s.length) for s in recording.segments],
        **waveform.folding,
        "frame_offset": frame_offset,
    }


def first_frames(
    recordings: Sequence[Capture], waveform: Waveform, frame_offset: int, count: int
) -> tuple[Array, Array]:
    """The first frames of a recording, or of the ratio of two antennas.

    Parameters
    ----------
    recordings : sequence of Capture
        Of one antenna or both.
    waveform : Waveform
        As it was sent.
    frame_offset : int
        Samples before the first frame.
    count : int
        Frames wanted.

    Returns
    -------
    snapshots : ndarray of int, shape (n,)
        Their indices; fewer than wanted where a recording ends.
    folded : ndarray of complex, shape (n, symbol_length)
    """
    kernels = [folded_reader(**frame_settings(each, waveform, frame_offset)) for each in recordings]
    if len(kernels) == 2:
        snapshots, folded, *_ = _ratio_frames(kernels, waveform, count)
        return snapshots, folded
    found = kernels[0].read(count)
    return found["snapshot"], found["folded"]


def _ratio_frames(
    kernels: Iterable[folded_reader], waveform: Waveform, count: int
) -> tuple[Array, ...]:
    """Index of the next frames that both antennas have, ratio folded, its noise, saturation."""
    first, second = (kernel.read(count) for kernel in kernels)
    common, rows, others = np.intersect1d(
        first["snapshot"], second["snapshot"], return_indices=True
    )
    folded = first["folded"][rows], second["folded"][others]
    ratio = folded_ratio(*folded, waveform)
    noise = ratio_noise(folded, (first["noise"][rows], second["noise"][others]), ratio)
    return common, ratio, noise, first["saturated"][rows]


class RecordedGroups:
    """Groups of a recording with one antenna, by the kernels.

    Parameters
    ----------
    table : ToneTable
        Weights of the run.
    waveform : Waveform
        As it was sent.
    frame_offset : int
        Samples before the first frame.

    Attributes
    ----------
    captures : tuple of Capture
    kernels : dict
        Readers of the files, by path.
    """

    def __init__(
        self, recording: Capture, table: ToneTable, waveform: Waveform, frame_offset: int
    ) -> None:
        self._length = table.group_length
        self._batch = groups_at_once(waveform)
        self._folded = FoldedGroups(table, waveform)
        weights, rotation = kernel_rows(table, waveform)
        self._kernel = tone_reader(
            **frame_settings(recording, waveform, frame_offset),
            weights=weights,
            factors=waveform.equalizer(),
            rotation=rotation,
            bins=waveform.bins,
        )
        self.captures: tuple[Capture, ...] = (recording,)
        self.kernels = {recording.path: self._kernel}

    def read(self) -> Groups:
        """Give the next groups; none at the end."""
        found = self._kernel.read(self._batch)
        static = found["tones"][:, -1]
        groups = Groups(
            found["index"],
            found["tones"][:, :-1],
            found["missing"],
            is_clipped(found["saturated"], self._length),
            interference=found["rejected"] / self._length,
            static=static,
        )
        if found["incomplete"]:
            weights = np.ones((len(groups), self._length), bool)
            for row, present, folded in found["incomplete"]:
                solved = self._folded.solve(present, folded)
                groups.tones[row], static[row], weights[row] = solved
            groups.snapshot_weights = weights
            groups.missing[~weights.any(axis=1)] = self._length
        return groups


class RecordedRatio:
    """Groups of the ratio of two antennas, recorded side by side.

    Parameters
    ----------
    recordings : tuple of Capture, length 2
        Of both antennas.
    table, waveform, frame_offset
        As for :class:`RecordedGroups`.

    Attributes
    ----------
    captures, kernels
        As for :class:`RecordedGroups`.
    """

    def __init__(
        self,
        recordings: tuple[Capture, Capture],
        table: ToneTable,
        waveform: Waveform,
        frame_offset: int,
    ) -> None:
        self._length = table.group_length
        self._waveform = waveform
        self._folded = FoldedGroups(table, waveform)
        self._screen = GroupScreen(table.group_length, waveform.symbol_length)
        self.captures = recordings
        self.kernels = {
            each.path: folded_reader(**frame_settings(each, waveform, frame_offset))
            for each in recordings
        }
        self._kept: tuple[Array, ...] = self._read_frames()

    def read(self) -> Groups:
        """Give the next groups; none at the end.

        A group ends with its last frame, or before a frame of a later one.
        """
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

    def _read_frames(self) -> tuple[Array, ...]:
        count = max(1, groups_at_once(self._waveform) // 4) * self._length
        return _ratio_frames(self.kernels.values(), self._waveform, count)

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
        self, snapshots: Array, folded: Array, noise: Array, saturated: Array
    ) -> SnapshotGroup:
        length = self._length
        slots = snapshots % length
        present = np.zeros(length, bool)
        present[slots] = True
        every = (
            np.zeros((length, self._waveform.symbol_length), np.complex64),
            np.zeros((length, 2)),
        )
        every[0][slots], every[1][slots] = folded, noise
        return SnapshotGroup(int(snapshots[0] // length), *every, present, int(saturated.sum()))
