# SPDX-License-Identifier: GPL-3.0-or-later
"""Phase groups of folded frames: screened, read from recordings, and their tones."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...io.capture.recordings import Capture
from ...signal.waveform import Waveform
from ...signal.weights import ToneTable
from ...wiforce_kernels import (
    UNNOTICED_FRAMES,
    folded_reader,
    interference_screen,
    tone_reader,
    tone_transform,
)
from ..groups import Array, Groups, is_clipped


def folded_ratio(first: Array, second: Array, waveform: Waveform) -> Array:
    """Ratio of antennas times the symbol, like one's folded frames, (n, symbol_length).

    Of H_a = exp(j phi) (S_a + r T_a) the ratio H_1 / H_2 cancels the oscillators' phase, and is
    linear in r while the tag is weak: higher orders change a phase by up to 2 |T|/|S| rad (Y. Zeng
    et al., FarSense, 2019). It is 0 where the second antenna receives nothing.
    """
    bins = waveform.bins
    one, two = (np.fft.fft(each.astype(complex), axis=1)[:, bins] for each in (first, second))
    ratio = np.divide(one, two, out=np.zeros_like(one), where=np.abs(two) > 0)
    spectrum = np.zeros((len(first), waveform.symbol_length), complex)
    spectrum[:, bins] = ratio / waveform.equalizer()[bins]
    return np.fft.ifft(spectrum, axis=1)


def ratio_noise(antennas: tuple[Array, Array], noise: tuple[Array, Array], ratio: Array) -> Array:
    """Noise (n, 2), float32, of two antennas' ratio: smallest and largest, as of one antenna."""
    relative = sum(own / _power(folded) for own, folded in zip(noise, antennas, strict=True))
    return np.asarray(relative * _power(ratio), np.float32)


def _power(folded: Array) -> Array:
    """Mean power per sample, shape (n, 1)."""
    power = np.mean(folded.real**2 + folded.imag**2, axis=1, keepdims=True)
    return np.maximum(power, np.finfo(np.float32).tiny)


class Slips:
    """Slips of the frame timing: groups before each would be read as a press, and are left out.

    What is marked of a group left out, that the device was retuned, is marked of the next one.
    """

    def __init__(self, group_length: int) -> None:
        self._length = group_length
        self._known: set[tuple[int, int]] = set()
        self._misplaced: list[tuple[int, int]] = []
        self._ends: list[int] = []
        self._retunings: list[int] = []  # first frames behind them that no group was marked for
        self._retuned = False  # in a group that was left out
        # Groups before the latest one in which a slip may still be found.
        self.unsure = -(-UNNOTICED_FRAMES // group_length)

    def add(self, misplaced: Iterable[tuple[int, int]], retuned: Iterable[int] = ()) -> None:
        """Add the frames (first, end) that slips misplaced, and the first behind each retuning.

        Those that are known may come again.
        """
        for frame in retuned:
            if (frame, frame) not in self._known:
                self._known.add((frame, frame))
                self._retunings.append(frame)
        for frames in misplaced:
            if frames not in self._known:
                self._known.add(frames)
                self._misplaced.append(frames)
                self._ends.append(frames[1])

    def elsewhere(self, group: int) -> bool:
        """Whether a group holds frames that may lie elsewhere; none of a later call is earlier."""
        begin, end = group * self._length, (group + 1) * self._length
        self._misplaced = [frames for frames in self._misplaced if frames[1] > begin]
        return any(first < end for first, _ in self._misplaced)

    def mark(self, group: int, retuned: bool = False) -> tuple[bool, bool] | None:
        """Whether the next group follows a slip, and a retuned device; None where left out."""
        end = (group + 1) * self._length
        retunings = [frame for frame in self._retunings if frame >= end]
        self._retuned |= retuned or len(retunings) < len(self._retunings)
        self._retunings = retunings
        if self.elsewhere(group):
            return None
        retuned, self._retuned = self._retuned, False
        later = [end for end in self._ends if end > group * self._length]
        slipped, self._ends = len(later) < len(self._ends), later
        return slipped, retuned


@dataclass(frozen=True, eq=False)
class SnapshotGroup:
    """Snapshots of one phase group as they were received."""

    index: int  # on the grid of the run
    folded: Array = field(repr=False)  # (N, symbol_length), complex64
    present: Array = field(repr=False)  # (N,), received; what the others hold means nothing
    kept: Array = field(repr=False)  # (N,), received and without interference
    saturated: int = 0  # snapshots with samples at full scale
    retuned: bool = False  # rate or carrier was changed before the group
    # (k, 2), frames before slips found in it that may lie elsewhere: the first, the end
    misplaced: Sequence[tuple[int, int]] = ()
    slipped: bool = False  # the first one behind a slip: set by StreamReader

    @property
    def snapshots(self) -> Array:
        """Indices of the snapshots that were received, on the grid of the run."""
        return self.index * len(self.present) + np.flatnonzero(self.present)

    def copy(self) -> SnapshotGroup:
        """The same group with snapshots of its own, for when a block's buffer is reused."""
        return replace(self, folded=self.folded.copy())


def rotation_of(table: ToneTable, waveform: Waveform) -> Array:
    """Factors (M, symbol_length) of tones before the FFT; (0, symbol_length) for a long symbol."""
    if not waveform.is_derotated:
        return np.zeros((0, waveform.symbol_length), complex)
    return table.derotation(waveform.sample_rate_hz, waveform.symbol_length)


def kernel_rows(table: ToneTable, waveform: Waveform) -> tuple[Array, Array]:
    """Weights (M + 1, N) and rotation (M + 1 or 0, symbol_length); the last row is static."""
    mean = np.full((1, table.group_length), 1 / table.group_length)
    rotation = rotation_of(table, waveform)
    if len(rotation):
        rotation = np.concatenate([rotation, np.ones_like(rotation[:1])])
    return np.concatenate([table.weights, mean]), rotation


class FoldedGroups:
    """Converts folded frames of a group to tones, by weights for the snapshots received."""

    def __init__(self, table: ToneTable, waveform: Waveform, derotated: bool = True) -> None:
        self._table, self._waveform = table, waveform
        self._derotated = derotated and waveform.is_derotated
        self._bins = waveform.bins
        self._factors = waveform.equalizer()[self._bins]
        self._rotation = rotation_of(table, waveform) if self._derotated else 1.0

    @cached_property
    def _kernel(self) -> tone_transform:
        """Of complete groups, which recordings do not need."""
        weights, rotation = kernel_rows(self._table, self._waveform)
        if not self._derotated:
            rotation = rotation[:0]
        return tone_transform(weights, self._waveform.equalizer(), rotation, self._bins)

    def solve(self, present: Array, folded: Array) -> tuple[Array, Array, Array]:
        """Tones (M, K), static path (K,), and weights (N,), 0 where snapshots are too few."""
        if len(folded) == len(present):
            rows = self._kernel.transform(folded)
            return rows[:-1], rows[-1], present
        partial = self._table.for_present(present)
        if partial is None:
            shape = len(self._table.tones), len(self._bins)
            return np.zeros(shape, complex), np.zeros(shape[1], complex), np.zeros_like(present)
        tones = partial.apply(folded)
        channel = np.fft.fft(tones * self._rotation, axis=1)[:, self._bins] * self._factors
        return channel, self.static(np.mean(folded, axis=0)), present

    def static(self, mean: Array) -> Array:
        """The static path (K,), of the mean of a group's folded frames."""
        path: Array = np.fft.fft(mean)[self._bins] * self._factors
        return path

    def groups(self, received: Sequence[SnapshotGroup]) -> Groups:
        """Tones of groups, in order."""
        length = self._table.group_length
        solved = []
        missing, rejected = [0] * len(received), [0.0] * len(received)
        for row, group in enumerate(received):
            kept = group.kept
            whole = 0 not in kept.tobytes()
            solved.append(self.solve(kept, group.folded if whole else group.folded[kept]))
            if not whole:
                present = np.count_nonzero(group.present)
                missing[row] = length - present if solved[-1][2].any() else length
                rejected[row] = (present - np.count_nonzero(kept)) / length
        tones, static, weights = zip(*solved, strict=True)
        return Groups(
            np.array([group.index for group in received]),
            np.array(tones),
            np.array(missing),
            is_clipped(np.array([group.saturated for group in received]), length),
            np.array([group.retuned for group in received]),
            np.array(weights) if any(missing) or any(rejected) else None,
            np.array(rejected),
            np.array(static),
            slipped=np.array([group.slipped for group in received]),
        )


# Groups that are read at a time, of the default symbol; fewer of a longer one, whose tones would
# otherwise fill the memory. Larger batches are not faster, smaller ones are slower.
_BATCH, _BATCH_SYMBOL = 256, 64


def groups_at_once(waveform: Waveform) -> int:
    """Groups that are read at a time; it changes no reading."""
    return max(1, _BATCH * _BATCH_SYMBOL // max(_BATCH_SYMBOL, waveform.symbol_length))


def frame_settings(recording: Capture, waveform: Waveform, frame_offset: int) -> dict[str, Any]:
    """The parameters by which kernels and ``recording_source`` find the frames of a file."""
    return {
        "path": os.fsencode(recording.path),
        "datatype": recording.datatype,
        "segments": [tuple(segment) for segment in recording.segments],
        **waveform.folding,
        "frame_offset": frame_offset,
    }


def first_frames(
    recordings: Sequence[Capture],
    waveform: Waveform,
    frame_offset: int,
    count: int,
    group_length: int,
) -> tuple[Array, Array]:
    """Up to ``count`` first frames of one recording or a ratio: indices (n,) and folded frames."""
    kernels = [folded_reader(**frame_settings(each, waveform, frame_offset)) for each in recordings]
    slips = Slips(group_length)
    count += slips.unsure * group_length
    if len(kernels) == 2:
        snapshots, folded, *_ = _RatioFrames(kernels, waveform).read(count)
    else:
        found = kernels[0].read(count)
        snapshots, folded = found["snapshot"], found["folded"]
    for kernel in kernels:
        slips.add(kernel.misplaced())
    groups = (snapshots // group_length).tolist()
    kept = np.array([not slips.elsewhere(group) for group in groups], bool)
    kept[count - slips.unsure * group_length :] = False
    return snapshots[kept], folded[kept]


class _RatioFrames:
    """Frames that two antennas have in common, and their ratio; ``ended`` where one has no more."""

    def __init__(self, kernels: Iterable[folded_reader], waveform: Waveform) -> None:
        self._kernels, self._waveform = tuple(kernels), waveform
        self._held = [kernel.read(0) for kernel in self._kernels]
        self.ended = False

    def read(self, count: int) -> tuple[Array, ...]:
        """The next frames, up to ``count`` of an antenna: indices, ratio, its noise, saturation.

        A frame is saturated where either antenna is.
        """
        newest = [int(held["snapshot"].max(initial=-1)) for held in self._held]
        for each, kernel in enumerate(self._kernels):
            if newest[each] == min(newest):
                found = kernel.read(count)
                self.ended |= len(found["snapshot"]) < count
                held = self._held[each]
                self._held[each] = {k: np.concatenate([held[k], found[k]]) for k in found}
        until = min(held["snapshot"].max(initial=-1) for held in self._held)
        first, second = (self._take(each, until) for each in (0, 1))
        common, rows, others = np.intersect1d(
            first["snapshot"], second["snapshot"], return_indices=True
        )
        folded = first["folded"][rows], second["folded"][others]
        ratio = folded_ratio(*folded, self._waveform)
        noise = ratio_noise(folded, (first["noise"][rows], second["noise"][others]), ratio)
        return common, ratio, noise, first["saturated"][rows] | second["saturated"][others]

    def _take(self, each: int, until: int) -> dict[str, Array]:
        held = self._held[each]
        count = int(np.searchsorted(held["snapshot"], until, "right"))
        self._held[each] = {name: values[count:] for name, values in held.items()}
        return {name: values[:count] for name, values in held.items()}


class _Recorded:
    """Groups of ``captures``, by kernels, in which no slip can be found any more."""

    def __init__(
        self,
        captures: Sequence[Capture],
        kernels: Sequence[Any],
        table: ToneTable,
        waveform: Waveform,
    ) -> None:
        self.captures, self._length = captures, table.group_length
        self.kernels = {each.path: kernel for each, kernel in zip(captures, kernels, strict=True)}
        self._folded = FoldedGroups(table, waveform)
        self._slips = Slips(self._length)
        self._held = Groups(np.zeros(0, np.int64))  # in which a slip may still be found

    def _next(self) -> tuple[Groups, bool]:
        """The groups that follow, and whether they are the last ones."""
        raise NotImplementedError

    def read(self) -> Groups:
        """Give the next groups; none at the end."""
        groups, ended = self._held[:0], False
        while not len(groups) and not ended:
            found, ended = self._next()
            for kernel in self.kernels.values():
                self._slips.add(kernel.misplaced(), kernel.retuned())
            groups = Groups.concatenate([self._held, found])
            newest = groups.index.max(initial=0) - self._slips.unsure * (not ended)
            sure = int(groups.index.searchsorted(newest, "right"))
            groups, self._held = groups[:sure], groups[sure:]
            marks = [self._slips.mark(group) for group in groups.index.tolist()]
            kept = {row: mark for row, mark in enumerate(marks) if mark is not None}
            if len(kept) < len(marks):
                groups = groups[np.array(list(kept), int)]
            for row, (slipped, retuned) in enumerate(kept.values()):
                groups.slipped[row] |= slipped
                groups.retuned[row] |= retuned
        return groups


class RecordedGroups(_Recorded):
    """Groups of a recording with one antenna."""

    def __init__(
        self, recording: Capture, table: ToneTable, waveform: Waveform, frame_offset: int
    ) -> None:
        self._batch = groups_at_once(waveform)
        weights, rotation = kernel_rows(table, waveform)
        self._kernel = tone_reader(
            **frame_settings(recording, waveform, frame_offset),
            weights=weights,
            factors=waveform.equalizer(),
            rotation=rotation,
            bins=waveform.bins,
        )
        super().__init__([recording], [self._kernel], table, waveform)

    def _next(self) -> tuple[Groups, bool]:
        solved: list[tuple[Any, ...]] = []  # row, tones, static path, weights
        found = self._kernel.read(
            self._batch,
            lambda row, *group: solved.append((row, *self._folded.solve(*group))),
        )
        static = found["tones"][:, -1]
        groups = Groups(
            found["index"],
            found["tones"][:, :-1],
            found["missing"],
            is_clipped(found["saturated"], self._length),
            interference=found["rejected"] / self._length,
            static=static,
        )
        if solved:
            weights = np.ones((len(groups), self._length), bool)
            for row, *of in solved:
                groups.tones[row], static[row], weights[row] = of
            groups.snapshot_weights = weights
            groups.missing[~weights.any(axis=1)] = self._length
        return groups, len(groups) < self._batch


class RecordedRatio(_Recorded):
    """Groups of the ratio of two antennas, recorded side by side."""

    def __init__(
        self,
        recordings: Sequence[Capture],
        table: ToneTable,
        waveform: Waveform,
        frame_offset: int,
    ) -> None:
        kernels = [
            folded_reader(**frame_settings(each, waveform, frame_offset)) for each in recordings
        ]
        super().__init__(recordings, kernels, table, waveform)
        self._screen = interference_screen(self._length, waveform.symbol_length)
        self._at_once = max(1, groups_at_once(waveform) // 4) * self._length
        self._frames = _RatioFrames(kernels, waveform)
        self._rest = self._frames.read(0)  # of a group that is not whole

    def _next(self) -> tuple[Groups, bool]:
        read = self._frames.read(self._at_once)
        frames = tuple(map(np.concatenate, zip(self._rest, read, strict=True)))
        group = frames[0] // self._length
        stop = int(group.searchsorted((frames[0].max(initial=-1) + 1) // self._length))
        self._rest = tuple(values[stop:] for values in frames)
        if not stop:
            return self._held[:0], self._frames.ended
        starts = np.unique(group[:stop], return_index=True)[1]
        runs = zip(*(np.split(values[:stop], starts[1:]) for values in frames), strict=True)
        return self._folded.groups([self._group(*run) for run in runs]), self._frames.ended

    def _group(
        self, snapshots: Array, folded: Array, noise: Array, saturated: Array
    ) -> SnapshotGroup:
        slots = snapshots % self._length
        present = np.zeros(self._length, bool)
        present[slots] = True
        kept = present & ~self._screen.examine(present, folded, noise)
        every = np.zeros((self._length, folded.shape[1]), np.complex64)
        every[slots] = folded
        index = int(snapshots[0] // self._length)
        return SnapshotGroup(index, every, present, kept, int(saturated.sum()))
