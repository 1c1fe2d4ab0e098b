# SPDX-License-Identifier: GPL-3.0-or-later
"""A batch of phase groups, and everything that the receiver's stages find out about it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

# Part of a group's snapshots with samples at full scale from which on it counts as saturated. A
# recording that was scaled to its own peak reaches full scale here and there, and lost nothing.
_CLIPPED_SHARE = 0.01


def is_clipped(saturated: Array, group_length: int) -> Array:
    """Whether groups count as saturated.

    Parameters
    ----------
    saturated : ndarray of int, shape (G,)
        Snapshots of each group with samples at full scale.
    group_length : int
        Snapshots per group, N.

    Returns
    -------
    ndarray of bool, shape (G,)

    Examples
    --------
    >>> is_clipped(np.array([0, 6, 7]), 625).tolist()
    [False, False, True]
    """
    return saturated >= max(1.0, _CLIPPED_SHARE * group_length)


@dataclass
class Groups:
    """Arrays over the groups of a batch, in order of time; each stage adds its own.

    G groups of N snapshots, M tones, K occupied subcarriers, S sensors with two ends each. What
    no stage has found yet is None.

    Parameters
    ----------
    index : ndarray of int, shape (G,)
        Index of each group on the grid of the run, rising.
    tones : ndarray of complex, shape (G, M, K)
        The channel at each tone (``signal.weights.ToneTable``) and occupied subcarrier; of
        incomplete groups, solved over the snapshots that are there.
    missing : ndarray of int, shape (G,)
        Snapshots that are absent or not finite.
    saturated : ndarray of bool, shape (G,)
        Whether more samples than chance explains are at the converter's full scale.
    retuned : ndarray of bool, shape (G,)
        Whether the receiver's rate or carrier was changed before the group.
    snapshot_weights : ndarray, shape (G, N), optional
        Weight of each snapshot in the tones, 0 where it is absent. Only needed where a group of
        the batch is incomplete; a row of zeros says that its tones cannot be used.

    Attributes
    ----------
    ends : ndarray of complex, shape (G, 2S, K)
        By the separation: V_i, the channel of each end with the tag's clock taken out.
    gain : ndarray, shape (G, 2S)
        Variance of V_i over that of H; infinite for an end that is not there.
    noise : ndarray, shape (G, K)
        Variance of the noise in H on each occupied subcarrier.
    snr_db : ndarray, shape (G, 2S)
        |c1[1] V_i|^2 against the noise in H, mean over the subcarriers.
    locked : ndarray of bool, shape (G, S)
        Whether the tag's clock is tracked and the tag was there.
    clock_phase, clock_offset_ppm, clock2_delay : ndarray, shape (G, S)
        Clock phase at the group's centre in radians, offset from nominal, and by how many radians
        of clock 1 the pulses of clock 2 come late.
    overlapping : ndarray of bool, shape (G, S)
        Whether the tag's two switches are on together.
    changes : ndarray of complex, shape (G, 2S, K)
        By the reference: V_i conj(V_ref,i) over the reference's power.
    new_reference : ndarray of bool, shape (G,)
        Whether the reference is taken anew from this group on: the first one, or after a tare.
    in_reference, late_reference : ndarray of bool, shape (G, 2S)
        Whether the group is part of the end's reference, and whether that was taken later than
        the time for which the sensor was promised untouched.
    reshaped : ndarray of bool, shape (G, 2S)
        Whether the end's channel varies over the subcarriers unlike its reference.
    reference_power, reference_gain : ndarray, shape (G, 2S)
        Weighted mean of |V_ref|^2 (0 without a reference) and its variance over that of H.
    ratios : ndarray of complex, shape (G, 2S)
        By the average: R_i.
    phase_std_deg : ndarray, shape (G, 2S)
        Standard deviation of arg R_i; infinite where there is no ratio.
    touch : ndarray of int, shape (G, S)
        By the readout: 1, 0, or -1 where it is unknown.
    phases_deg : ndarray, shape (G, S, 2)
        psi_1 and psi_2; NaN where unknown, as all that follow.
    force_n, force_std_n, location_mm, location_std_mm : ndarray, shape (G, S)
    flags : ndarray of int, shape (G, S)
        Bits of ``io.readings.Flag``.

    Examples
    --------
    >>> batch = Groups(np.arange(3), np.zeros((3, 16, 62), complex))
    >>> len(batch), len(batch[1:]), int(batch[1:].index[0])
    (3, 2, 1)
    """

    index: Array
    tones: Array | None = field(default=None, repr=False)
    missing: Array = field(default=None, repr=False)  # type: ignore[assignment]
    saturated: Array = field(default=None, repr=False)  # type: ignore[assignment]
    retuned: Array = field(default=None, repr=False)  # type: ignore[assignment]
    snapshot_weights: Array | None = field(default=None, repr=False)
    ends: Array | None = field(default=None, repr=False)
    gain: Array | None = field(default=None, repr=False)
    noise: Array | None = field(default=None, repr=False)
    snr_db: Array | None = field(default=None, repr=False)
    locked: Array | None = field(default=None, repr=False)
    clock_phase: Array | None = field(default=None, repr=False)
    clock_offset_ppm: Array | None = field(default=None, repr=False)
    clock2_delay: Array | None = field(default=None, repr=False)
    overlapping: Array | None = field(default=None, repr=False)
    changes: Array | None = field(default=None, repr=False)
    new_reference: Array | None = field(default=None, repr=False)
    in_reference: Array | None = field(default=None, repr=False)
    late_reference: Array | None = field(default=None, repr=False)
    reshaped: Array | None = field(default=None, repr=False)
    reference_power: Array | None = field(default=None, repr=False)
    reference_gain: Array | None = field(default=None, repr=False)
    ratios: Array | None = field(default=None, repr=False)
    phase_std_deg: Array | None = field(default=None, repr=False)
    touch: Array | None = field(default=None, repr=False)
    phases_deg: Array | None = field(default=None, repr=False)
    force_n: Array | None = field(default=None, repr=False)
    force_std_n: Array | None = field(default=None, repr=False)
    location_mm: Array | None = field(default=None, repr=False)
    location_std_mm: Array | None = field(default=None, repr=False)
    flags: Array | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        self.index = np.asarray(self.index, np.int64)
        count = len(self.index)
        if self.missing is None:
            self.missing = np.zeros(count, np.int64)
        if self.saturated is None:
            self.saturated = np.zeros(count, bool)
        if self.retuned is None:
            self.retuned = np.zeros(count, bool)

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, rows: slice | Array) -> Groups:
        """The groups of some rows: a slice, or an array of indices or of bool."""
        found = {name: values for name in _NAMES if (values := getattr(self, name)) is not None}
        return Groups(**{name: values[rows] for name, values in found.items()})

    def having(self, **arrays: Array | None) -> Groups:
        """The same groups with some arrays added or replaced."""
        return replace(self, **arrays)

    @staticmethod
    def concatenate(batches: Iterable[Groups]) -> Groups:
        """Batches that follow each other, as one.

        Empty batches are left out: they may come from before a stage has anything to say.
        """
        kept = [batch for batch in batches if len(batch)]
        if len(kept) == 1:
            return kept[0]
        if not kept:
            return Groups(np.zeros(0, np.int64))
        arrays = {}
        for name in _NAMES:
            values = [getattr(batch, name) for batch in kept]
            if name == "snapshot_weights" and any(v is not None for v in values):
                length = next(v.shape[1] for v in values if v is not None)
                values = [
                    np.ones((len(batch), length), bool) if v is None else v
                    for batch, v in zip(kept, values, strict=True)
                ]
            if values[0] is not None:
                arrays[name] = np.concatenate(values)
        return Groups(**arrays)


_NAMES = tuple(item.name for item in fields(Groups))
