# SPDX-License-Identifier: GPL-3.0-or-later
"""Tones of a single phase group, and the weights that they were computed with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..signal.partial_weights import PartialWeights
from ..signal.weights import ToneTable
from .groups import Array

# A group whose energy exceeds the median by this factor is excluded from an acquisition. A press
# changes a tag's energy by a factor of 6 at most (off reflection 0.3).
_LOUD = 10.0


class GroupWeights:
    """Weights from the n snapshots received of a group to its M tones.

    Parameters
    ----------
    weights : ToneTable or PartialWeights
        Of a complete group, or of the snapshots received.
    line_gain : ndarray, shape (M, 1)
        Gain of each line by derotation (1 / ``ToneTable.symbol_gain``).
    times_s : ndarray, shape (n,)
        Times of the snapshots from the group's centre, in s.
    loss : float
        N over the number of snapshots received.

    Examples
    --------
    >>> from gnuradio.wiforce.signal.switching import switch_averages
    >>> from gnuradio.wiforce.signal.weights import design_weights
    >>> table = design_weights([1000.0], 625, 57.6e-6)
    >>> weights = GroupWeights(table, np.ones((16, 1)), table.times_s)
    >>> waveforms = switch_averages(2 * np.pi * 1000 * table.times_s, 0.064)  # s1 and s2
    >>> weights.mix([waveforms]).shape
    (16, 2)
    """

    def __init__(
        self,
        weights: ToneTable | PartialWeights,
        line_gain: Array,
        times_s: Array,
        loss: float = 1.0,
    ) -> None:
        self.whitener = weights.whitener
        self.times_s = times_s
        self.loss = loss
        mixer = line_gain * weights.weights
        # Waveforms are real: two real products are half of a complex one.
        self._mixer = np.vstack([mixer.real, mixer.imag])

    def mix(self, waveforms: Sequence[Array]) -> Array:
        """Apply the weights to waveforms.

        Parameters
        ----------
        waveforms : sequence of ndarray, shape (n, 2)
            s_1 and s_2 of each tag at the snapshots.

        Returns
        -------
        ndarray of complex, shape (M, 2 tags)
            The mixing matrix.
        """
        rows = [waveform.T for waveform in waveforms]  # contiguous, as they were made
        mixed = self._mixer @ (rows[0] if len(rows) == 1 else np.concatenate(rows)).T
        half = len(mixed) // 2
        return mixed[:half] + 1j * mixed[half:]


@dataclass(slots=True)
class GroupTones:
    """One group as it was received.

    Attributes
    ----------
    group : int
        Index on the grid of the run.
    center_s : float
        Time of its centre, in s.
    tones : ndarray of complex, shape (M, K)
        P.
    white : ndarray of complex, shape (M, K)
        The same with white noise of the variance of H.
    weights : GroupWeights
        From snapshots to tones.
    missing : int
        Snapshots that are absent.
    usable : bool
        Whether there are tones, all of them finite.

    Examples
    --------
    >>> from gnuradio.wiforce.signal.weights import design_weights
    >>> table = design_weights([1000.0], 625, 57.6e-6)
    >>> weights = GroupWeights(table, np.ones((16, 1)), table.times_s)
    >>> tones = np.full((16, 62), 2j)
    >>> GroupTones(0, 0.018, tones, tones, weights, 0, True).level()
    4.0
    """

    group: int
    center_s: float
    tones: Array
    white: Array
    weights: GroupWeights
    missing: int
    usable: bool

    def level(self) -> float:
        """Mean of ``power`` over the subcarriers."""
        return float(np.vdot(self.white, self.white).real / self.white.size)

    def power(self) -> Array:
        """Mean power per tone and subcarrier in units of the noise in H; shape (K,)."""
        return power_of(self.white).mean(axis=0)


def without_loud(items: Sequence[GroupTones]) -> list[GroupTones]:
    """Exclude groups with a burst of interference, which would dominate a sum over groups.

    Parameters
    ----------
    items : sequence of GroupTones

    Returns
    -------
    list of GroupTones
        Those with at most ten times the median power.

    Examples
    --------
    >>> from gnuradio.wiforce.signal.weights import design_weights
    >>> table = design_weights([1000.0], 625, 57.6e-6)
    >>> weights = GroupWeights(table, np.ones((16, 1)), table.times_s)
    >>> levels = [np.full((16, 62), level) for level in (1.0, 9.0, 1.1)]
    >>> groups = [GroupTones(g, 0.0, x, x, weights, 0, True) for g, x in enumerate(levels)]
    >>> [item.group for item in without_loud(groups)]
    [0, 2]
    """
    if not items:
        return []
    levels = np.array([item.level() for item in items])
    return [items[i] for i in np.flatnonzero(levels <= _LOUD * np.median(levels))]


def power_of(values: Array) -> Array:
    """Squared magnitudes.

    Parameters
    ----------
    values : ndarray of complex

    Returns
    -------
    ndarray of float
        Of the same shape.

    Examples
    --------
    >>> power_of(np.array([3 + 4j])).tolist()
    [25.0]
    """
    return values.real**2 + values.imag**2
