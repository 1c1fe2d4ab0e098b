# SPDX-License-Identifier: GPL-3.0-or-later
"""The untouched reference of the ends as it is summed up, group by group."""

from __future__ import annotations

import numpy as np

from ..groups import Array, Groups


class ReferenceSum:
    """Sum of the ends' channels over groups, each weighted by 1 over its variance.

    Parameters
    ----------
    ends : int
        Ends of all tags, 2S.

    Attributes
    ----------
    sum : ndarray of complex, shape (2S, K), or None
        Sum of V over its variance; None before the first group.
    precision : ndarray, shape (2S,)
        Sum of 1 over the variance; 0 for an end that was not received.
    precisions : ndarray, shape (2S, K)
        The same on each subcarrier, less where a narrow-band transmitter interfered.
    """

    def __init__(self, ends: int) -> None:
        self.sum: Array | None = None
        self.precision = np.zeros(ends)
        self.precisions: Array = np.zeros((ends, 1))
        self._mean: Array | None = None
        self._excess: Array | None = None

    def add(self, group: Groups, received: Array) -> None:
        """Add some ends of a single group.

        Parameters
        ----------
        group : Groups
            With ``ends`` and ``gain``.
        received : ndarray of bool, shape (2S,)
            The ends that are added.
        """
        values, gain = group.ends[0], group.gain[0]
        rise = np.ones(values.shape) if group.noise_rise is None else group.noise_rise
        weights = np.where(received[:, None], 1 / (gain[:, None] * rise), 0)
        total = self._started(values)
        total[received] += values[received] * weights[received]
        self.precision[received] += 1 / gain[received]
        self.precisions = self.precisions + weights
        self._mean = self._excess = None

    def replace(self, other: ReferenceSum) -> Array:
        """Take over all ends that another sum holds.

        Returns ndarray of bool, shape (2S,): these ends.
        """
        held = other.precision > 0
        if other.sum is not None:
            self.sum = np.where(held[:, None], other.sum, self._started(other.sum))
        self.precision = np.where(held, other.precision, self.precision)
        self.precisions = np.where(held[:, None], other.precisions, self.precisions)
        self._mean = self._excess = None
        return held

    def mean(self) -> Array:
        """Weighted mean of each end, shape (2S, K); 0 where there is none.

        The same array until a group is added.
        """
        if self._mean is None:
            total = np.zeros(self.precisions.shape) if self.sum is None else self.sum
            with np.errstate(divide="ignore", invalid="ignore"):
                self._mean = np.where(self.precisions > 0, total / self.precisions, 0)
        return self._mean

    def gain(self) -> Array:
        """Variance of each mean over that of H, shape (2S,); infinite where there is none."""
        none = np.full(self.precision.shape, np.inf)
        return np.divide(1, self.precision, out=none, where=self.precision > 0)

    def excess(self) -> Array:
        """Share by which interference raised the variance of the mean; shape (2S, K).

        0 where there is no mean. The same array until a group is added.
        """
        if self._excess is None:
            with np.errstate(divide="ignore", invalid="ignore"):
                excess = self.precision[:, None] / self.precisions - 1
            self._excess = np.where(self.precisions > 0, excess, 0)
        return self._excess

    def _started(self, values: Array) -> Array:
        if self.sum is None:
            self.sum = np.zeros(values.shape, complex)
        return self.sum


class NewReference:
    """The reference of a tare, while it is measured.

    Parameters
    ----------
    ends : int
        Ends of all tags, 2S.
    groups : int
        Length of the reference, from the first group that is added on.

    Attributes
    ----------
    sums : ReferenceSum
        Of the groups so far.
    """

    def __init__(self, ends: int, groups: int) -> None:
        self._groups = groups
        self._stop: int | None = None
        self.sums = ReferenceSum(ends)

    def ends_before(self, index: int) -> bool:
        """Whether the reference ends before the group of this index."""
        return self._stop is not None and index >= self._stop

    def add(self, group: Groups) -> None:
        """Take a batch of one group with ``ends`` and ``gain``."""
        if self._stop is None:
            self._stop = int(group.index[0]) + self._groups
        received = np.isfinite(group.gain[0])
        if group.locked is not None:
            # Before a silent tag is dropped its ends are still solved for, and are noise.
            received = received & np.repeat(group.locked[0], 2)
        self.sums.add(group, received)
