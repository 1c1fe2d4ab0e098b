# SPDX-License-Identifier: GPL-3.0-or-later
"""Tones of phase groups, the weights that they were computed with, and the fit of ends to them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby

import numpy as np

from ..signal.weights import PartialWeights, ToneTable
from ..wiforce_kernels import end_fit, group_weights, whiten
from .groups import Array

# A group whose energy exceeds the median by this factor is excluded from an acquisition. A press
# changes a tag's energy by a factor of 6 at most (off reflection 0.3).
_LOUD = 10.0


class GroupWeights(group_weights):
    """Weights from the n snapshots received of a group to its M tones.

    ``line_gain`` (M, 1) is 1 / ``ToneTable.symbol_gain``, ``loss`` N over n, ``times_s`` (n,) are
    times from the group's centre. ``whitener`` (M, M) makes the noise of the tones' parts
    (``signal.weights.parts_of``) white, with the variance of H, ``colorer`` tones of these;
    ``mixer`` (n, M) leads from snapshots to whitened parts, ``switched`` from clocks.
    """

    def __init__(
        self, weights: ToneTable | PartialWeights, line_gain: Array, loss: float = 1.0
    ) -> None:
        pairs = np.repeat(line_gain[len(line_gain) // 2 :], 2, axis=0)
        self.whitener, self.times_s = weights.whitener, weights.times_s
        self.mixer = (self.whitener @ (pairs * weights.parts)).T
        super().__init__(self.mixer, self.times_s, self.whitener, loss)

    def mix(self, waveforms: Array) -> Array:
        """Whitened parts (..., M, C) of C waveforms (..., n, C) at the snapshots of some groups."""
        # Contiguous in the order in which the switching waveforms are made.
        return np.asarray((waveforms.swapaxes(-1, -2) @ self.mixer).swapaxes(-1, -2))


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
