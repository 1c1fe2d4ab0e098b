# SPDX-License-Identifier: GPL-3.0-or-later
"""What tags spread over the subcarriers of symbols so long that they switch within them.

A switch that closes within a symbol passes only a part of its samples: each of the tag's lines then
spreads over the subcarriers (intercarrier interference). Clock, ends and symbol are known, so this
part is computed and subtracted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...signal.switching import switch_edges
from ...signal.waveform import Waveform
from ...wiforce_kernels import end_fit
from ..clocks.tracked_tag import ClockPath, TrackedTag
from ..group_tones import GroupTones, GroupWeights
from ..groups import Array

# Times that the ends are corrected. Each leaves of their error the share of the power that is
# spread: -13 dB for symbols of 0.05 of the tag's period.
_ROUNDS = 3


class SpreadLines:
    """Removes what tags spread over the subcarriers from the tones of groups.

    Sample n of a symbol has tones M_i[n] y_i[n] of end i, with the symbol y_i as received, whose
    transform is X V_i. The model has the mean of M_i; the rest, the transform of (M_i[n] - mean)
    y_i[n] over X, is computed from the ends, subtracted, and the ends are solved again.
    """

    def __init__(self, waveform: Waveform) -> None:
        length, bins = waveform.symbol_length, waveform.bins
        self._length, self._repetitions = length, waveform.repetitions
        self._bins, self._factors = bins, waveform.equalizer()[bins]
        self._spectrum = np.fft.fft(waveform.symbol)
        self._spectrum /= np.mean(self._spectrum[bins] * self._factors)
        # The channel of an unused subcarrier lies between those of the nearest used ones.
        order = np.argsort(bins)
        self._unused = np.setdiff1d(np.arange(length), bins)
        above = np.searchsorted(bins[order], self._unused)
        self._below, self._above = order[above - 1], order[above % len(order)]
        distances = [
            (self._unused - bins[self._below]) % length,
            (bins[self._above] - self._unused) % length,
        ]
        self._upper_share = distances[0] / (distances[0] + distances[1])

    def removed(
        self, groups: GroupTones, fit: end_fit, tags: Sequence[TrackedTag], clocks: ClockPath
    ) -> Array:
        """Whitened parts (G, M, K) without spread lines, by a fit of these tags at these clocks."""
        white = np.empty_like(groups.white)
        for row, weights in enumerate(groups.weights):
            mixing = self._mixing(weights, tags, clocks, row)
            # All rounds but the last only need the part that the ends are solved from.
            solver, ends = fit.solver[row], fit.ends[row]
            solved, mixing_of_solved = solver @ groups.white[row], mixing @ solver.T
            for _ in range(_ROUNDS - 1):
                ends = solved - self.of_ends(mixing_of_solved, ends)
            white[row] = groups.white[row] - self.of_ends(mixing, ends)
        return white

    def of_ends(self, mixing: Array, ends: Array) -> Array:
        """What V (E, K) spread, (M, K); ``mixing`` (N, E, M) is M_i[n] less its mean."""
        channel = np.empty((len(ends), self._length), complex)
        channel[:, self._bins] = ends
        channel[:, self._unused] = ends[:, self._below] + self._upper_share * (
            ends[:, self._above] - ends[:, self._below]
        )
        received = np.fft.ifft(channel * self._spectrum, axis=1)
        spread = np.fft.fft((received.T[:, None] @ mixing)[:, 0].T, axis=1)
        found: Array = spread[:, self._bins] * self._factors
        return found

    def _mixing(
        self, weights: GroupWeights, tags: Sequence[TrackedTag], clocks: ClockPath, row: int
    ) -> Array:
        """M_i[n] less its mean over the symbol, of both ends of all tags; shape (N, E, M)."""
        mixing = np.zeros((self._length, 2 * len(tags), len(weights.whitener)))
        for i, tag in enumerate(tags):
            phase, rate = clocks.phase[row, i], tag.rate + clocks.rate[row, i]
            edges = switch_edges(
                phase + rate * weights.times_s,
                rate * tag.averaging_s / 2,
                tag.clock2_delay,
                tag.duty,
            )
            # Samples from the start of the repetition that holds the edge.
            sample = (edges.position + 1) / 2 * self._repetitions * self._length % self._length
            first, end = sample.astype(int), 2 * i + edges.waveform
            steps = weights.mixer[edges.snapshot] * (edges.step / self._repetitions)[:, None]
            # An edge within a sample leaves the mean over it; behind the last one nothing follows.
            late = (sample - first)[:, None]
            np.add.at(mixing, (first, end), steps * (1 - late))
            follows = first + 1 < self._length
            np.add.at(mixing, (first[follows] + 1, end[follows]), (steps * late)[follows])
        np.cumsum(mixing, axis=0, out=mixing)
        mixing -= mixing.mean(axis=0)
        return mixing
