# SPDX-License-Identifier: GPL-3.0-or-later
"""Tones of phase groups from their folded frames, exact where some of them are missing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...signal.waveform import Waveform
from ...signal.weights import ToneTable
from ...wiforce_kernels import tone_transform
from ..groups import Array, Groups, is_clipped
from .snapshot_group import SnapshotGroup


def rotation_of(table: ToneTable, waveform: Waveform) -> Array:
    """Factors by which tones are multiplied before the FFT, as kernels and blocks take them.

    Returns ndarray of complex, shape (M, symbol_length): ``ToneTable.derotation``; empty where the
    waveform's symbol is too long for it.

    Parameters
    ----------
    table : ToneTable
        Weights of the run.
    waveform : Waveform
        As it was sent.
    """
    if not waveform.is_derotated:
        return np.zeros((0, waveform.symbol_length), complex)
    return table.derotation(waveform.sample_rate_hz, waveform.symbol_length)


def kernel_rows(table: ToneTable, waveform: Waveform) -> tuple[Array, Array]:
    """Weights and rotation as the kernels take them, with a last row for the static path.

    Parameters
    ----------
    table : ToneTable
        Weights of the run.
    waveform : Waveform
        As it was sent.

    Returns
    -------
    weights : ndarray of complex, shape (M + 1, N)
    rotation : ndarray of complex, shape (M + 1, symbol_length) or (0, symbol_length)
    """
    mean = np.full((1, table.group_length), 1 / table.group_length)
    rotation = rotation_of(table, waveform)
    if len(rotation):
        rotation = np.concatenate([rotation, np.ones_like(rotation[:1])])
    return np.concatenate([table.weights, mean]), rotation


class FoldedGroups:
    """Converts the folded frames of a group to its tones.

    Zeros in place of missing snapshots would let static clutter leak into the tones. The weights
    of an incomplete group are therefore solved for the snapshots that were received.

    Parameters
    ----------
    table : ToneTable
        Weights of the run.
    waveform : Waveform
        As it was sent.
    derotated : bool
        Whether the tones of complete groups are derotated.
    """

    def __init__(self, table: ToneTable, waveform: Waveform, derotated: bool = True) -> None:
        self._table = table
        self._bins = waveform.bins
        self._factors = waveform.equalizer()[self._bins]
        weights, rotation = kernel_rows(table, waveform)
        if not derotated:
            rotation = rotation[:0]
        self._rotation = rotation[:-1] if len(rotation) else 1.0
        self._kernel = tone_transform(weights, waveform.equalizer(), rotation, waveform.bins)

    def solve(self, present: Array, folded: Array) -> tuple[Array, Array, Array]:
        """Tones of one group, and the weights of its snapshots in them.

        Parameters
        ----------
        present : ndarray of bool, shape (N,)
            Which snapshots were received and are to be used.
        folded : ndarray of complex, shape (count of present, symbol_length)
            Folded frames of these snapshots.

        Returns
        -------
        tones : ndarray of complex, shape (M, K)
        static : ndarray of complex, shape (K,)
            The channel of the static path.
        snapshot_weights : ndarray of bool, shape (N,)
            As ``present``. All are zeros when the snapshots do not determine the tones.
        """
        if np.all(present):
            rows = self._kernel.transform(folded)
            return rows[:-1], rows[-1], present
        partial = self._table.for_present(present)
        if partial is None:
            shape = len(self._table.tones), len(self._bins)
            return np.zeros(shape, complex), np.zeros(shape[1], complex), np.zeros_like(present)
        tones = partial.apply(folded)
        channel = np.fft.fft(tones * self._rotation, axis=1)[:, self._bins] * self._factors
        mean = np.fft.fft(np.mean(folded, axis=0))[self._bins] * self._factors
        return channel, mean, present

    def groups(self, received: Sequence[SnapshotGroup]) -> Groups:
        """Tones of groups that were screened.

        Parameters
        ----------
        received : sequence of SnapshotGroup
            With ``kept``, in order.
        """
        count, length = len(received), self._table.group_length
        tones = np.zeros((count, len(self._table.tones), len(self._bins)), complex)
        static = np.zeros((count, len(self._bins)), complex)
        weights = np.ones((count, length), bool)
        missing = np.array([length - np.sum(group.present) for group in received], np.int64)
        saturated = np.array([group.saturated for group in received])
        rejected = np.zeros(count)
        for row, group in enumerate(received):
            kept = group.present if group.kept is None else group.kept
            folded = group.folded if kept.all() else group.folded[kept]
            tones[row], static[row], weights[row] = self.solve(kept, folded)
            rejected[row] = np.sum(group.present & ~kept)
        missing[~weights.any(axis=1)] = length
        return Groups(
            np.array([group.index for group in received], np.int64),
            tones,
            missing,
            is_clipped(saturated, length),
            np.array([group.retuned for group in received], bool),
            None if weights.all() else weights,
            rejected / length,
            static,
        )
