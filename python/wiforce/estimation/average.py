# SPDX-License-Identifier: GPL-3.0-or-later
"""Average over subcarriers, and an average over groups that follows a touch without delay."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import accumulate

import numpy as np

from ..errors import InputError
from .groups import Array, Groups
from .reference import subcarrier_weights

# Squared standard deviations by which the newer part of a window must differ from the older:
# exceeded by noise in 0.5 % of the comparisons (docs/estimation.md, section "Thresholds").
_CHANGE = 8.0


class SubcarrierAverage:
    """R_i = sum_k w_k X_i,k with w_k = 1 / sigma_k^2, and the standard deviation of its phase.

    Parameters
    ----------
    smoothing_groups : int
        Groups averaged while nothing changes; 1 for none.

    Raises
    ------
    InputError
        When ``smoothing_groups`` is below 1.

    Notes
    -----
    Half of the noise of the R_i (:func:`ratio_variance`) lies along the phase, so that
    std(arg R) = sqrt(var(R) / 2) / |R|. The noise of the reference is an error of the untouched
    phases, which the press filter knows (docs/press.md).
    """

    def __init__(self, smoothing_groups: int = 1) -> None:
        if smoothing_groups < 1:
            raise InputError("smoothing_groups", "must be at least 1", smoothing_groups)
        self._smoothing = smoothing_groups
        self._windows: list[AdaptiveAverage] = []

    def process(self, groups: Groups) -> Groups:
        """Average a batch.

        Returns Groups: with ``ratios``, ``phase_std_deg``, infinite for an end that was not
        received or has no reference, ``group_ratios`` and ``group_variance``; without ``changes``.

        Parameters
        ----------
        groups : Groups
            With ``changes`` and the arrays of separation and reference.
        """
        if not len(groups):
            return groups
        ratios = (groups.changes @ subcarrier_weights(groups.noise)[:, :, None])[:, :, 0]
        of_group, own = ratio_variance(groups), ratios
        variance = of_group
        if self._smoothing > 1:
            ratios, variance = self._smooth(groups, ratios, variance)
        std = phase_std_deg(ratios, variance)
        return groups.having(
            changes=None,
            ratios=ratios,
            phase_std_deg=std,
            group_ratios=own,
            group_variance=of_group,
        )

    def _smooth(self, groups: Groups, ratios: Array, variance: Array) -> tuple[Array, Array]:
        means, variances = np.empty_like(ratios), np.empty_like(variance)
        tags = ratios.shape[1] // 2
        rows = zip(groups.new_reference.tolist(), ratios.tolist(), variance.tolist(), strict=True)
        for row, (restarts, values, spreads) in enumerate(rows):
            if restarts or not self._windows:
                self._windows = [AdaptiveAverage(self._smoothing) for _ in range(tags)]
            for i, window in enumerate(self._windows):
                own = slice(2 * i, 2 * i + 2)
                means[row, own], variances[row, own] = window.update(values[own], spreads[own])
        return means, variances


def phase_std_deg(ratios: Array, variance: Array) -> Array:
    """Standard deviation of the phase of ratios with complex noise.

    Returns ndarray, of the same shape: in degrees; infinite where R is 0.

    Parameters
    ----------
    ratios : ndarray of complex
        R.
    variance : ndarray, of the same shape
        Of R.
    """
    magnitude = np.abs(ratios)
    std = np.full(magnitude.shape, np.inf)
    np.divide(np.sqrt(variance / 2), magnitude, out=std, where=magnitude > 0)
    return np.degrees(std)


def ratio_variance(groups: Groups) -> Array:
    """Variance of the complex R_i by the noise of the group; shape (G, 2S).

    g (1 + g_ref K / E) / E with E = sum_k |V_ref|^2 / sigma_k^2, where g and g_ref are the
    variances of V and V_ref over that of H; infinite without a reference.
    """
    energy = groups.reference_power * (1 / groups.noise).sum(axis=1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        rise = 1 + groups.reference_gain * groups.noise.shape[1] / energy
        return np.where(energy > 0, groups.gain * rise / energy, np.inf)


class AdaptiveAverage:
    """Mean over the last groups for as long as nothing changes.

    For every group the window is split at each position. While the newer part differs in phase
    from the older by more than noise explains, the oldest group is dropped. A step empties the
    window at once, a slow change shortens it (the idea of ADWIN, A. Bifet and R. Gavalda, 2007).

    Parameters
    ----------
    length : int
        Longest window in groups.
    """

    def __init__(self, length: int) -> None:
        # Of each group, the newest first: ratio over variance and 1 / variance of every ratio.
        self._window: deque[list[tuple[complex, float]]] = deque(maxlen=length)

    def update(
        self, ratios: Sequence[complex], variance: Sequence[float]
    ) -> tuple[list[complex], list[float]]:
        """Take one group.

        Parameters
        ----------
        ratios : sequence of complex, length n
            The window is common to all of them.
        variance : sequence of float, length n
            Of each ratio; the window is emptied where one is not finite.

        Returns
        -------
        ratios : list of complex, length n
            Averages over the window.
        variance : list of float, length n
            Of the averages.
        """
        if not all(map(math.isfinite, variance)):
            self._window.clear()
            return list(ratios), list(variance)
        pairs = zip(ratios, variance, strict=True)
        self._window.appendleft([(ratio / spread, 1 / spread) for ratio, spread in pairs])
        # Sums over the newest 1, 2, ... groups of each ratio.
        sums = [list(accumulate(item, _add)) for item in zip(*self._window, strict=True)]
        count = len(self._window)
        while count > 1 and any(_changed(each, count) for each in sums):
            count -= 1
            self._window.pop()
        return (
            [each[count - 1][0] / each[count - 1][1] for each in sums],
            [1 / each[count - 1][1] for each in sums],
        )


def _add(a: tuple[complex, float], b: tuple[complex, float]) -> tuple[complex, float]:
    return a[0] + b[0], a[1] + b[1]


def _changed(sums: list[tuple[complex, float]], count: int) -> bool:
    """Whether the phase of some newer part of ``count`` groups differs from that of the rest."""
    total, precision = sums[count - 1]
    mean = (total / precision).conjugate()
    # Half of a complex variance lies across the mean.
    limit = _CHANGE / 2 * (mean.real**2 + mean.imag**2)
    for newer, newer_precision in sums[: count - 1]:
        older_precision = precision - newer_precision
        difference = newer / newer_precision - (total - newer) / older_precision
        across = (difference * mean).imag
        if across**2 > limit * (1 / newer_precision + 1 / older_precision):
            return True
    return False
