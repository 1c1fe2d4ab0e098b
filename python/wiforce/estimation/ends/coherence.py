# SPDX-License-Identifier: GPL-3.0-or-later
"""Interference that has the tag's own profile over the subcarriers, seen in the residual.

The average over K subcarriers reduces independent noise by K. Leakage of movers, another tag, or an
error of the clock is coherent over all of them, and is not reduced at all. What counts for the
phase of an end is the residual's component along that end's channel, c_m = sum_k E_mk conj(V_k) /
sigma_k^2: noise alone leaves sum_k |V_k|^2 / sigma_k^2 of it on every tone.
"""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import deque

import numpy as np

from ..groups import Array
from .group_fit import GroupFit

# Standard deviations above which a group's own ratio, or the median, is more than noise. With
# 22 degrees of freedom, five are exceeded by 1 group in 10 000.
_GROUP_STDS = 5.0
_LASTING_STDS = 4.0
# Groups of the median. Bursts and presses that change disturb fewer than half of them.
_MEDIAN_GROUPS = 48
# Lasting factor above which what is received is not this tag and noise: a second tag on nearly the
# same clock hides most of itself in the ends. Rooms whose disturbances lie beside the lines reach
# 36, such tags 47 and more (SNR 10 dB, tests/rooms).
_DISTURBED = 42.0
# The sandwich estimate has about a third of the degrees of freedom.
_FREEDOM_SHARE = 3.0


class CoherentResidual:
    """Factor by which the variance of each end exceeds that of independent noise.

    Parameters
    ----------
    ends : int
        Ends of all tags, 2S.

    Notes
    -----
    Two estimates of sum_m |S_im|^2 var(c_im), S being the solver: the sandwich estimator HC2 of
    J. MacKinnon and H. White (1985) takes each tone's own power, in the median of the last groups.
    A sudden rise in a single group is judged with equal power on all tones, which fewer groups
    determine.
    """

    def __init__(self, ends: int) -> None:
        self._ends = ends
        self.reset()

    def reset(self) -> None:
        """Forget the groups so far, when the clocks were acquired again."""
        self._medians = [_RunningMedian() for _ in range(self._ends)]

    def update(self, fit: GroupFit, inverse_noise: Array) -> tuple[Array, Array]:
        """Take the fit of some groups.

        Parameters
        ----------
        inverse_noise : ndarray, shape (G, K) or (K,)
            1 / sigma_k^2.

        Returns
        -------
        factors : ndarray, shape (G, E)
            Of each end that was fitted, at least 1.
        disturbed : ndarray of bool, shape (G, E)
            Whether something lasting is received on the lines of the end that is no noise.
        """
        count, freedom = len(fit.residual), fit.freedom
        sandwich, own = fit.coherent(np.broadcast_to(inverse_noise, (count, fit.ends.shape[2])))
        spread = freedom**-0.5
        factors = np.where(own > 1 + _GROUP_STDS * spread, own, 1)
        lasting, count = np.empty((2, *sandwich.shape))
        for column, row in enumerate(fit.rows.tolist()):
            of_end = [self._medians[row].update(ratio) for ratio in sandwich[:, column].tolist()]
            lasting[:, column], count[:, column] = zip(*of_end, strict=True)
        # The median of a gamma distribution lies below its mean.
        lasting /= 1 - _FREEDOM_SHARE / (3 * freedom)
        significant = lasting > 1 + _LASTING_STDS * spread * np.sqrt(_FREEDOM_SHARE / count)
        return np.where(significant, np.maximum(factors, lasting), factors), lasting > _DISTURBED


class _RunningMedian:
    """Median of the last groups."""

    def __init__(self) -> None:
        self._latest: deque[float] = deque()
        self._sorted: list[float] = []

    def update(self, value: float) -> tuple[float, int]:
        """Take a group; give the median of all that are finite, and their number."""
        self._latest.append(value)
        if math.isfinite(value):
            insort(self._sorted, value)
        if len(self._latest) > _MEDIAN_GROUPS and math.isfinite(oldest := self._latest.popleft()):
            del self._sorted[bisect_left(self._sorted, oldest)]
        count = len(self._sorted)
        if not count:
            return math.inf, 0
        return (self._sorted[(count - 1) // 2] + self._sorted[count // 2]) / 2, count
