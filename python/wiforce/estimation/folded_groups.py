# SPDX-License-Identifier: GPL-3.0-or-later
"""Tones of a phase group from its folded frames, exact where some of them are missing."""

from __future__ import annotations

import numpy as np

from ..signal.waveform import Waveform
from ..signal.weights import ToneTable
from .groups import Array


class FoldedGroups:
    """Turns the folded frames of a group into its tones.

    In an incomplete group, zeros for what is absent would let everything that stands still leak
    into the tones: weights are solved for the snapshots that are there.

    Parameters
    ----------
    table : ToneTable
    waveform : Waveform
    derotated : bool
        Whether the tones of complete groups come derotated.
    """

    def __init__(self, table: ToneTable, waveform: Waveform, derotated: bool = True) -> None:
        self._table = table
        self._bins = waveform.bins
        self._factors = waveform.equalizer()[self._bins]
        self._rotation = table.derotation(waveform.sample_rate_hz) if derotated else 1.0

    def tones(self, present: Array, folded: Array) -> Array | None:
        """Tones of one group.

        Parameters
        ----------
        present : ndarray of bool, shape (N,)
            Which snapshots there are.
        folded : ndarray of complex, shape (count of present, 64)
            The folded frames of those.

        Returns
        -------
        ndarray of complex, shape (M, K), or None
            None when the snapshots do not determine the tones.
        """
        weights = self._table.weights
        if not np.all(present):
            partial = self._table.for_present(present)
            if partial is None:
                return None
            weights = partial.weights
        tones = weights @ np.asarray(folded, complex)
        return np.fft.fft(tones * self._rotation, axis=1)[:, self._bins] * self._factors
