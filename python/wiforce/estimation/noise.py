# SPDX-License-Identifier: GPL-3.0-or-later
"""The noise in H on each subcarrier, learned from what the tags leave unexplained."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from enum import Enum, auto

import numpy as np

from .group_tones import GroupTones
from .groups import Array

_MEMORY_S = 2.0
_LEAST_MEMORY_GROUPS = 32
# Smallest noise, relative to the mean tone, that counts as noise rather than rounding.
_FLOOR = 1e-14
# Residual of a group over the known noise above which the group says nothing of the noise.
UNUSUAL = 3.0
# So many groups decide whether the noise has changed, and by which factor it must have: a press
# that changes disturbs fewer.
STEP_GROUPS = 8
_STEP = 1.33


class Verdict(Enum):
    """What a group's residual says."""

    LEARNED = auto()
    #: So many groups in a row do not fit that noise has risen, or a clock is held at a wrong phase.
    MODEL_LOST = auto()


class NoiseEstimate:
    """Variance of the noise in H per subcarrier: a mean over the last two seconds of groups.

    Parameters
    ----------
    group_period_s : float

    Attributes
    ----------
    variance : ndarray, shape (K,), or None
        None while nothing is known.
    inverse : ndarray, shape (K,)
    level : float
        Its mean over the subcarriers.
    """

    def __init__(self, group_period_s: float) -> None:
        self.variance: Array | None = None
        self._groups = 0
        self._memory = max(_LEAST_MEMORY_GROUPS, int(_MEMORY_S / group_period_s))
        self._ratios: deque[float] = deque(maxlen=STEP_GROUPS)

    def set(self, variance: Array, items: Sequence[GroupTones], groups: int | None = None) -> None:
        """Take a variance (K,) for the noise, but no less than the rounding of these groups.

        ``groups`` says over how many it is a mean.
        """
        floor = _FLOOR * max(item.level() for item in items)
        self.variance = np.maximum(variance, max(floor, 1e-300))
        self.inverse = 1 / self.variance
        self.level = float(self.variance.sum()) / len(self.variance)
        if groups is not None:
            self._groups = groups

    def ratio(self, residual: Array) -> float:
        """Mean of a residual's variance (K,) over the noise; 1 when the model fits."""
        return float(residual @ self.inverse) / len(residual)

    def learn(self, residual: Array, ratio: float, item: GroupTones) -> Verdict:
        """Take a complete group's residual variance (K,) and its ratio into account."""
        assert self.variance is not None
        self._ratios.append(ratio)
        full = len(self._ratios) == STEP_GROUPS
        if full and min(self._ratios) > UNUSUAL:
            self._ratios.clear()
            return Verdict.MODEL_LOST
        if ratio > UNUSUAL:
            return Verdict.LEARNED
        median = sorted(self._ratios)[len(self._ratios) // 2]
        if full and not 1 / _STEP < median < _STEP and median <= UNUSUAL:
            # Its level has changed; its course over the subcarriers is still the best known.
            self._ratios.clear()
            self.set(median * self.variance, [item], min(self._groups, STEP_GROUPS))
            return Verdict.LEARNED
        self._groups = min(self._groups + 1, self._memory)
        self.set(self.variance + (residual - self.variance) / self._groups, [item])
        return Verdict.LEARNED
