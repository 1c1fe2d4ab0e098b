# SPDX-License-Identifier: GPL-3.0-or-later
"""Tones of a phase group from its folded frames, exact where some of them are missing."""

from __future__ import annotations

import numpy as np

from ..signal.waveform import Waveform
from ..signal.weights import ToneTable
from .groups import Array


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

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> plan = wiforce.plan("demo")
    >>> folded = np.tile(plan.waveform.frame()[64:128], (plan.group_length, 1))  # a static channel
    >>> present = np.arange(plan.group_length) != 100
    >>> tones, _ = FoldedGroups(plan.table, plan.waveform).solve(present, folded[present])
    >>> tones.shape, bool(np.abs(tones).max() < 1e-6)
    ((24, 62), True)
    """

    def __init__(self, table: ToneTable, waveform: Waveform, derotated: bool = True) -> None:
        self._table = table
        self._bins = waveform.bins
        self._factors = waveform.equalizer()[self._bins]
        self._rotation = table.derotation(waveform.sample_rate_hz) if derotated else 1.0

    def solve(self, present: Array, folded: Array) -> tuple[Array, Array]:
        """Tones of one group, and the weights of its snapshots in them.

        Parameters
        ----------
        present : ndarray of bool, shape (N,)
            Which snapshots were received and are to be used.
        folded : ndarray of complex, shape (count of present, 64)
            Folded frames of these snapshots.

        Returns
        -------
        tones : ndarray of complex, shape (M, K)
        snapshot_weights : ndarray of bool, shape (N,)
            As ``present``. Both are zeros when the snapshots do not determine the tones.
        """
        if np.all(present):
            tones = self._table.weights @ np.asarray(folded, complex)
        else:
            partial = self._table.for_present(present)
            if partial is None:
                shape = len(self._table.tones), len(self._bins)
                return np.zeros(shape, complex), np.zeros_like(present)
            tones = partial.apply(folded)
        channel = np.fft.fft(tones * self._rotation, axis=1)[:, self._bins] * self._factors
        return channel, present
