# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise in H on each subcarrier, estimated from the residual of the least-squares fit."""

from __future__ import annotations

from collections import deque
from enum import Enum, auto

import numpy as np

from .groups import Array

# Noise is averaged over two seconds, at least 32 groups: with M - 2S = 14 degrees of freedom per
# group the estimate on a subcarrier then has a standard deviation of 5 %, which costs 0.01 dB.
_MEMORY_S = 2.0
_LEAST_MEMORY_GROUPS = 32
# Smallest noise power relative to the mean tone. Tones in single precision have rounding errors of
# (6e-8)^2 = 3.6e-15.
_FLOOR = 1e-14
# Ratio of a group's residual to the noise above which the group is an outlier; its value and those
# of the two constants below are measured in docs/estimation.md, section "Thresholds".
OUTLIER_RATIO = 3.0
# The noise has changed when the median over this many groups has, by this factor. A press that
# changes disturbs fewer groups.
STEP_GROUPS = 8
_STEP = 1.33


class Verdict(Enum):
    """Result of comparing a group's residual with the noise.

    Attributes
    ----------
    LEARNED
        The group fits, or is a single outlier.
    MODEL_LOST
        ``STEP_GROUPS`` groups in a row do not fit: noise has risen, or a clock is tracked at a
        wrong phase.

    Examples
    --------
    >>> [verdict.name for verdict in Verdict]
    ['LEARNED', 'MODEL_LOST']
    """

    LEARNED = auto()
    MODEL_LOST = auto()


class NoiseEstimate:
    """Variance of the noise in H per subcarrier: a mean over the last two seconds of groups.

    Parameters
    ----------
    group_period_s : float
        Length of a group, in s.

    Attributes
    ----------
    known : bool
        Whether there is an estimate yet; until then the arrays below are empty.
    variance : ndarray, shape (K,)
        sigma_k^2.
    inverse : ndarray, shape (K,)
        1 / sigma_k^2.
    level : float
        Mean of the variance over the subcarriers.
    memory : int
        Groups that it is a mean of, at most.

    Examples
    --------
    >>> noise = NoiseEstimate(0.036)
    >>> noise.set(np.array([1.0, 2.0, 3.0]), level=1.0)
    >>> noise.level, noise.ratio(np.array([2.0, 4.0, 6.0]))
    (2.0, 2.0)
    """

    def __init__(self, group_period_s: float) -> None:
        self.known = False
        self.variance: Array = np.empty(0)
        self.inverse: Array = np.empty(0)
        self.level = 0.0
        self._groups = 0
        self.memory = max(_LEAST_MEMORY_GROUPS, int(_MEMORY_S / group_period_s))
        self._ratios: deque[float] = deque(maxlen=STEP_GROUPS)

    def set(self, variance: Array, level: float, groups: int | None = None) -> None:
        """Set the variance of the noise, limited to the rounding errors of the tones.

        Parameters
        ----------
        variance : ndarray, shape (K,)
        level : float
            Mean power of the whitened tones, the largest of the groups that it was measured in.
        groups : int, optional
            Number of groups that it is a mean of; unchanged when not given.
        """
        self.known = True
        self.variance = np.maximum(variance, max(_FLOOR * level, 1e-300))
        self.inverse = 1 / self.variance
        self.level = float(self.variance.sum()) / len(self.variance)
        if groups is not None:
            self._groups = groups

    def ratio(self, residual: Array) -> float:
        """Mean of a residual's variance (K,) over the noise; 1 when the model fits."""
        return float(residual @ self.inverse) / len(residual)

    def learn(self, residual: Array, ratio: float, level: float) -> Verdict:
        """Update the estimate by a complete group.

        Parameters
        ----------
        residual : ndarray, shape (K,)
            Mean square of the whitened residual per degree of freedom.
        ratio : float
            See :meth:`ratio`.
        level : float
            Mean power of the group's whitened tones.

        Returns
        -------
        Verdict
        """
        self._ratios.append(ratio)
        full = len(self._ratios) == STEP_GROUPS
        if full and min(self._ratios) > OUTLIER_RATIO:
            self._ratios.clear()
            return Verdict.MODEL_LOST
        if ratio > OUTLIER_RATIO:
            return Verdict.LEARNED
        median = sorted(self._ratios)[len(self._ratios) // 2]
        if full and not 1 / _STEP < median < _STEP and median <= OUTLIER_RATIO:
            # The level has changed; the profile over the subcarriers is still the best estimate.
            self._ratios.clear()
            self.set(median * self.variance, level, min(self._groups, STEP_GROUPS))
            return Verdict.LEARNED
        self._groups = min(self._groups + 1, self.memory)
        self.set(self.variance + (residual - self.variance) / self._groups, level)
        return Verdict.LEARNED
