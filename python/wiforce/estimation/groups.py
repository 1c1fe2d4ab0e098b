# SPDX-License-Identifier: GPL-3.0-or-later
"""A batch of phase groups, and everything that the receiver's stages compute for it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
        By the reference: V_i conj(V_ref,i) over the reference's power.
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
    def has_incomplete(self) -> bool:
        """Whether there may be a group that is ``incomplete``."""
        lacking = any(self.missing.tolist()) or any(self.interference.tolist())
        return self.snapshot_weights is not None or lacking

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
