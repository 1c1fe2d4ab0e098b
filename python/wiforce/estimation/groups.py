# SPDX-License-Identifier: GPL-3.0-or-later
"""Batches of phase groups with what the stages compute, and the tones of groups as received."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..signal.weights import PartialWeights, ToneTable
from ..wiforce_kernels import end_fit, group_weights, whiten

Array = NDArray[Any]

# Part of a group's snapshots with samples at full scale from which on it counts as saturated. A
# recording that was scaled to its own peak reaches full scale here and there, and lost nothing.
_CLIPPED_SHARE = 0.01


def is_clipped(saturated: Array, group_length: int) -> Array:
    """Whether groups of N snapshots count as saturated, by how many reach full scale (G,)."""
    return saturated >= max(1.0, _CLIPPED_SHARE * group_length)


# Arrays (G,) that are zeros where they are not given.
_ZEROS: dict[str, type] = {
    "missing": np.int64,
    "saturated": bool,
    "retuned": bool,
    "interference": float,
    "common_std_deg": float,
    "slipped": bool,
    "in_tare": bool,
}


_SET_BY_STAGE: Any = None


@dataclass(eq=False, repr=False)
class Groups:
    """Arrays over the groups of a batch, in order of time; each stage adds its own.

    G groups of N snapshots, M tones, K occupied subcarriers, S sensors with two ends each. An
    array is None until the stage that computes it has run. A batch is indexed like an array over
    its groups; an index or an iteration gives batches of one group.

    Parameters
    ----------
    index : ndarray of int, shape (G,)
        Index of each group on the grid of the run, rising.
    tones : ndarray of complex, shape (G, M, K)
        The channel at each tone (``signal.weights.ToneTable``) and occupied subcarrier; of
        incomplete groups, solved over the snapshots that were received.
    missing : ndarray of int, shape (G,)
        Snapshots that are absent or not finite; all of them where interference leaves too few.
    saturated : ndarray of bool, shape (G,)
        Whether more samples than chance explains are at the converter's full scale.
    retuned : ndarray of bool, shape (G,)
        Whether the receiver's rate or carrier was changed before the group.
    snapshot_weights : ndarray, shape (G, N), optional
        Weight of each snapshot in the tones, 0 where it is absent or rejected. Only needed where a
        group of the batch is incomplete; a row of zeros says that its tones cannot be used.
    interference : ndarray of float, shape (G,), optional
        Share of the snapshots that were rejected because another transmitter interfered with them.
    static : ndarray of complex, shape (G, K), optional
        The channel of the static path: the mean over the group's snapshots.
    common_std_deg : ndarray, shape (G,), optional
        Standard deviation of a rotation of all ends by changes of the static paths, which packets
        with phases of their own are referred to; 0 unless given.
    slipped : ndarray of bool, shape (G,)
        Whether samples were lost or inserted before the group without a trace, so that times from
        there on are known but for whole frames.
    timed : ndarray of PartialWeights, shape (G,), optional
        Weights of groups whose snapshots have times of their own, which the tones were computed
        with; None in the place of a group whose tones cannot be used.

    Attributes
    ----------
    ends : ndarray of complex, shape (G, 2S, K)
        By the separation: V_i, the channel of each end with the tag's clock taken out.
    gain : ndarray, shape (G, 2S)
        Variance of V_i over that of H, with what is coherent over the subcarriers in proportion;
        infinite for an end that was not received.
    noise : ndarray, shape (G, K)
        Variance of the noise in H on each occupied subcarrier.
    noise_rise : ndarray, shape (G, K)
        The same over that of the groups before: above 1 where a narrow-band transmitter interfered
        with the group.
    snr_db : ndarray, shape (G, 2S)
        |c1[1] V_i|^2 against the noise in H, mean over the subcarriers.
    locked : ndarray of bool, shape (G, S)
        Whether the tag's clock is tracked and the tag was received.
    clock_phase, clock_offset_ppm, clock2_delay : ndarray, shape (G, S)
        Clock phase at the group's centre in radians, offset from nominal, and by how many radians
        of clock 1 the pulses of clock 2 come late.
    overlapping : ndarray of bool, shape (G, S)
        Whether the tag's two switches are on together.
    disturbed : ndarray of bool, shape (G, S)
        Whether something is received on the tag's own lines that is no noise.
    changes : ndarray of complex, shape (G, 2S, K)
        By the difference: V_i conj(V_ref,i) over the reference's power.
    new_reference : ndarray of bool, shape (G,)
        Whether this group is the first that is compared with its reference: the first of a run, or
        the first after a tare.
    reference_step : ndarray of complex, shape (G, 2S)
        This reference over the former one, where it is new; 1 for ends that keep theirs.
    in_tare : ndarray of bool, shape (G,)
        Whether a new reference is measured in the group, which is compared with the former one.
    in_reference, late_reference : ndarray of bool, shape (G, 2S)
        Whether the group is part of the end's reference, and whether the reference was taken after
        the time in which the scene says that the sensor is untouched.
    reshaped : ndarray of bool, shape (G, 2S)
        Whether the end's channel varies over the subcarriers unlike its reference.
    reference_power, reference_gain : ndarray, shape (G, 2S)
        Weighted mean of |V_ref|^2 (0 without a reference) and its variance over that of H.
    ratios : ndarray of complex, shape (G, 2S)
        By the average: R_i.
    phase_std_deg : ndarray, shape (G, 2S)
        Standard deviation of arg R_i by the noise of the groups averaged; infinite where there is
        no ratio. That of the reference is common to all groups.
    touch : ndarray of int, shape (G, S)
        By the readout: 1, 0, or -1 where it is unknown.
    phases_deg : ndarray, shape (G, S, 2)
        psi_1 and psi_2; NaN where unknown, as all that follow.
    psi_std_deg : ndarray, shape (G, S, 2)
        Standard deviations of psi_1 and psi_2.
    force_n, force_std_n, location_mm, location_std_mm : ndarray, shape (G, S)
        Force in N, location from port 1 in mm, and their standard deviations.
    flags : ndarray of int, shape (G, S)
        Bits of ``io.readings.Flag``.

    Examples
    --------
    >>> batch = Groups(np.arange(3), np.zeros((3, 16, 62), complex))
    >>> len(batch), len(batch[1:]), batch[1:].index.tolist()
    (3, 2, [1, 2])
    >>> [group.tones.shape for group in batch]
    [(1, 16, 62), (1, 16, 62), (1, 16, 62)]
    """

    index: Array
    tones: Array = _SET_BY_STAGE
    missing: Array = _SET_BY_STAGE
    saturated: Array = _SET_BY_STAGE
    retuned: Array = _SET_BY_STAGE
    snapshot_weights: Array | None = _SET_BY_STAGE
    interference: Array = _SET_BY_STAGE
    static: Array | None = _SET_BY_STAGE
    common_std_deg: Array = _SET_BY_STAGE
    slipped: Array = _SET_BY_STAGE
    timed: Array | None = _SET_BY_STAGE
    ends: Array = _SET_BY_STAGE
    gain: Array = _SET_BY_STAGE
    noise: Array = _SET_BY_STAGE
    noise_rise: Array = _SET_BY_STAGE
    snr_db: Array = _SET_BY_STAGE
    locked: Array = _SET_BY_STAGE
    clock_phase: Array = _SET_BY_STAGE
    clock_offset_ppm: Array = _SET_BY_STAGE
    clock2_delay: Array = _SET_BY_STAGE
    overlapping: Array = _SET_BY_STAGE
    disturbed: Array = _SET_BY_STAGE
    changes: Array = _SET_BY_STAGE
    new_reference: Array = _SET_BY_STAGE
    reference_step: Array = _SET_BY_STAGE
    in_tare: Array = _SET_BY_STAGE
    in_reference: Array = _SET_BY_STAGE
    late_reference: Array = _SET_BY_STAGE
    reshaped: Array = _SET_BY_STAGE
    reference_power: Array = _SET_BY_STAGE
    reference_gain: Array = _SET_BY_STAGE
    ratios: Array = _SET_BY_STAGE
    phase_std_deg: Array = _SET_BY_STAGE
    touch: Array = _SET_BY_STAGE
    phases_deg: Array = _SET_BY_STAGE
    psi_std_deg: Array = _SET_BY_STAGE
    force_n: Array = _SET_BY_STAGE
    force_std_n: Array = _SET_BY_STAGE
    location_mm: Array = _SET_BY_STAGE
    location_std_mm: Array = _SET_BY_STAGE
    flags: Array = _SET_BY_STAGE

    def __post_init__(self) -> None:
        self.index = np.asarray(self.index, np.int64)
        count = len(self.index)
        given = {name: values for name, values in vars(self).items() if values is not None}
        # What is not set is not an attribute of the batch, but the None of the class: every stage
        # that takes rows of a batch would otherwise look at all names.
        absent = {name: kind for name, kind in _ZEROS.items() if name not in given}
        self.__dict__ = given | {name: np.zeros(count, kind) for name, kind in absent.items()}

    def __len__(self) -> int:
        return len(self.index)

    @property
    def incomplete(self) -> Array:
        """Whether tones are those of a part of the snapshots; ndarray of bool, shape (G,)."""
        lacking = (self.missing > 0) | (self.interference > 0)
        if self.snapshot_weights is not None:
            lacking |= ~np.all(self.snapshot_weights > 0, axis=1)
        return lacking

    def __iter__(self) -> Iterator[Groups]:
        return (self[row] for row in range(len(self)))

    def __getitem__(self, rows: int | slice | Array) -> Groups:
        """The groups of some rows: an index, a slice, or an array of indices or of bool."""
        count = len(self.index)
        if isinstance(rows, slice):
            if rows.indices(count) == (0, count, 1):
                return self
        elif isinstance(rows, int | np.integer):
            if not -count <= rows < count:
                raise IndexError(f"group {rows} of a batch of {count}")
            rows = np.array([rows])
        return _of({name: values[rows] for name, values in vars(self).items()})

    def having(self, **arrays: Any) -> Groups:
        """The same groups with some arrays added or replaced, or removed where None is given."""
        if not arrays.keys() <= _NAMES:
            raise TypeError(f"Groups has no array {', '.join(sorted(arrays.keys() - _NAMES))}")
        every = vars(self) | arrays
        for name in arrays:
            if every[name] is None:
                del every[name]
        return _of(every)

    @staticmethod
    def concatenate(batches: Iterable[Groups]) -> Groups:
        """Join batches that follow each other, without empty ones, which lack arrays."""
        kept = [batch for batch in batches if len(batch)]
        if len(kept) == 1:
            return kept[0]
        if not kept:
            return Groups(np.zeros(0, np.int64))
        weighted = [batch for batch in kept if batch.snapshot_weights is not None]
        if weighted:
            length = weighted[0].snapshot_weights.shape[1]  # type: ignore[union-attr]
            kept = [
                batch.having(snapshot_weights=np.ones((len(batch), length), bool))
                if batch.snapshot_weights is None
                else batch
                for batch in kept
            ]
        names = vars(kept[0])
        return _of({name: np.concatenate([vars(batch)[name] for batch in kept]) for name in names})


def _of(arrays: dict[str, Any]) -> Groups:
    """Groups of arrays that were checked before: batches of one group must not wait for it."""
    groups = object.__new__(Groups)
    groups.__dict__ = arrays
    return groups


_NAMES = frozenset(item.name for item in fields(Groups))


# A group whose energy exceeds the median by this factor is excluded from an acquisition. A press
# changes a tag's energy by a factor of 6 at most (off reflection 0.3).
_LOUD = 10.0


class GroupWeights(group_weights):
    """Weights from the n snapshots received of a group to its M tones.

    ``line_gain`` (M, 1) is 1 / ``ToneTable.symbol_gain``, ``loss`` N over n, ``times_s`` (n,) are
    times from the group's centre. ``whitener`` (M, M) makes the noise of the tones' parts
    (``signal.weights.parts_of``) white, with the variance of H, ``colorer`` tones of these;
    ``parts`` (M, n) leads from snapshots to parts, ``mixer`` (n, M) and ``mix`` to whitened ones,
    ``switched`` from clocks.
    """

    def __init__(
        self, weights: ToneTable | PartialWeights, line_gain: Array, loss: float = 1.0
    ) -> None:
        pairs = np.repeat(line_gain[len(line_gain) // 2 :], 2, axis=0)
        self.whitener, self.times_s = weights.whitener, weights.times_s
        self.parts = pairs * weights.parts
        super().__init__(self.parts.T, self.times_s, self.whitener, loss)

    @cached_property
    def mixer(self) -> Array:
        """From snapshots to whitened parts; shape (n, M)."""
        return np.asarray((self.whitener @ self.parts).T)

    @cached_property
    def colorer(self) -> Array:
        """From whitened parts to tones; shape (M, M)."""
        parts = np.linalg.inv(self.whitener)
        first, second = parts[::2], 1j * parts[1::2]
        return np.concatenate([(first - second)[::-1], first + second])

    def mix(self, waveforms: Array) -> Array:
        """Whitened parts (..., M, C) of C waveforms (..., n, C) at the snapshots of some groups."""
        return np.asarray(self.mixer.T @ waveforms)


@dataclass(eq=False, repr=False)
class GroupTones:
    """Some groups as they were received, G of them."""

    group: Array  # (G,), indices on the grid of the run
    center_s: Array  # (G,), times of their centres
    tones: Array  # (G, M, K), P
    missing: Array  # (G,), snapshots that are absent
    weights: Array  # (G,), GroupWeights from snapshots to tones

    def __len__(self) -> int:
        return len(self.group)

    def __getitem__(self, rows: slice | Array) -> GroupTones:
        """The groups of some rows: a slice, or an array of indices."""
        count = len(self.group)
        if isinstance(rows, slice) and rows.indices(count) == (0, count, 1):
            return self
        return GroupTones(*(values[rows] for values in self._arrays))

    @property
    def _arrays(self) -> tuple[Array, ...]:
        return self.group, self.center_s, self.tones, self.missing, self.weights

    @staticmethod
    def concatenate(parts: Sequence[GroupTones]) -> GroupTones:
        """Join groups that follow each other."""
        every = zip(*(part._arrays for part in parts), strict=True)
        return GroupTones(*map(np.concatenate, every))

    @cached_property
    def _whitened(self) -> tuple[Array, Array]:
        parts = [whiten(by.whitener, self.tones[rows]) for by, rows in self.by_weights()]
        white, level = (np.concatenate(each) for each in zip(*parts, strict=True))
        return white, level

    @property
    def white(self) -> Array:
        """Parts of the tones, with white noise of the variance of H; shape (G, M, K)."""
        return self._whitened[0]

    @property
    def level(self) -> Array:
        """Mean power of ``white``; shape (G,)."""
        return self._whitened[1]

    @property
    def loss(self) -> Array:
        """Snapshots of a group over those received, as a column; shape (G, 1)."""
        return np.array([[weights.loss] for weights in self.weights])

    def power(self) -> Array:
        """Mean power per tone and subcarrier in units of the noise in H; shape (G, K)."""
        return power_of(self.white).mean(axis=1)

    def by_weights(self) -> Iterator[tuple[GroupWeights, slice]]:
        """Runs of groups with the same weights: these, and the rows."""
        start = 0
        for weights, same in groupby(self.weights):
            stop = start + len(list(same))
            yield weights, slice(start, stop)
            start = stop


def without_loud(groups: GroupTones) -> GroupTones:
    """Groups of at most ten times the median power: bursts would dominate a sum over groups."""
    if not len(groups):
        return groups
    return groups[np.flatnonzero(groups.level <= _LOUD * np.median(groups.level))]


def power_of(values: Array) -> Array:
    """Squared magnitudes."""
    return values.real**2 + values.imag**2


class GroupFit(end_fit):
    """Whitened tones = white @ ends + residual, for the E ends of the locked tags in G groups.

    ``rows`` (E,) are these among all ends, ``mixed`` (G, M, 2E) the tags' waveforms, and behind
    them their slopes by phase. ``ends`` (G, E, K) are V, ``gain`` (G, E) its variance over that of
    H, ``white`` (G, M, E) is W [s1, s2, ...], ``solver`` (G, E, M) its pseudo-inverse, ``residual``
    (G, M, K).
    """

    def __init__(self, rows: Array, mixed: Array, tones: Array) -> None:
        super().__init__(mixed, tones)
        self.rows = rows

    def noise(self) -> Array:
        """Mean square of the residual per degree of freedom; shape (G, K)."""
        noise: Array = self.power() / self.freedom
        return noise
