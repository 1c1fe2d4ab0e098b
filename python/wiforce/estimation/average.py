# SPDX-License-Identifier: GPL-3.0-or-later
"""Average over subcarriers, and an average over groups that follows a touch without delay."""

from __future__ import annotations

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
    The noise of the R_i is that of the group and of the reference (:func:`ratio_variance`); half
    of it lies along the phase, so that std(arg R) = sqrt(var(R) / 2) / |R|.

    Examples
    --------
    One group of a sensor whose ends have turned by 30 and -10 deg, on four subcarriers:

    >>> from gnuradio.wiforce.estimation.groups import Groups
    >>> turn = np.exp(1j * np.radians([30.0, -10.0]))
    >>> group = Groups(
    ...     [13], changes=np.tile(turn[None, :, None], 4), noise=np.full((1, 4), 1e-4),
    ...     gain=np.full((1, 2), 0.01), reference_power=np.ones((1, 2)),
    ...     reference_gain=np.full((1, 2), 0.001), in_reference=np.zeros((1, 2), bool))
    >>> averaged = SubcarrierAverage().process(group)
    >>> np.degrees(np.angle(averaged.ratios)).round(6).tolist()
    [[30.0, -10.0]]
    >>> averaged.phase_std_deg.round(4).tolist()
    [[0.0212, 0.0212]]
    """

    def __init__(self, smoothing_groups: int = 1) -> None:
        if smoothing_groups < 1:
            raise InputError("smoothing_groups", "must be at least 1", smoothing_groups)
        self._smoothing = smoothing_groups
        self._windows: list[AdaptiveAverage] = []

    def process(self, groups: Groups) -> Groups:
        """Average a batch.

        Parameters
        ----------
        groups : Groups
            With ``changes`` and the arrays of separation and reference.

        Returns
        -------
        Groups
            With ``ratios`` and ``phase_std_deg``, infinite for an end that was not received or has
            no reference; without ``changes``.
        """
        if not len(groups):
            return groups
        ratios = np.einsum("gek,gk->ge", groups.changes, subcarrier_weights(groups.noise))
        variance = ratio_variance(groups)
        if self._smoothing > 1:
            ratios, variance = self._smooth(groups, ratios, variance)
        with np.errstate(divide="ignore", invalid="ignore"):
            std = np.degrees(np.sqrt(variance / 2) / np.abs(ratios))
        std = np.where(np.abs(ratios) > 0, std, np.inf)
        return groups.having(changes=None, ratios=ratios, phase_std_deg=std)

    def _smooth(self, groups: Groups, ratios: Array, variance: Array) -> tuple[Array, Array]:
        means, variances = np.empty_like(ratios), np.empty_like(variance)
        tags = ratios.shape[1] // 2
        for row, restarts in enumerate(groups.new_reference.tolist()):
            if restarts or not self._windows:
                self._windows = [AdaptiveAverage(self._smoothing) for _ in range(tags)]
            for i, window in enumerate(self._windows):
                own = slice(2 * i, 2 * i + 2)
                mean, spread = window.update(ratios[row, own], variance[row, own])
                means[row, own], variances[row, own] = mean, spread
        return means, variances


def ratio_variance(groups: Groups) -> Array:
    """Variance of the complex R_i from the noise of group and reference.

    Parameters
    ----------
    groups : Groups
        With the arrays of separation and reference.

    Returns
    -------
    ndarray, shape (G, 2S)
        Infinite without a reference.

    Notes
    -----
    (g + g_ref + g g_ref K / E) / E with E = sum_k |V_ref|^2 / sigma_k^2, where g and g_ref are the
    variances of V and V_ref over that of H. A group that is part of the reference shares its noise,
    which is not counted twice.

    Examples
    --------
    >>> from gnuradio.wiforce.estimation.groups import Groups
    >>> group = Groups(
    ...     [13], noise=np.full((1, 4), 1e-4), gain=np.full((1, 2), 0.01),
    ...     reference_power=np.ones((1, 2)), reference_gain=np.full((1, 2), 0.001),
    ...     in_reference=np.zeros((1, 2), bool))
    >>> bool(np.allclose(ratio_variance(group), 0.011 / 4e4))
    True
    """
    inverse_noise = np.sum(1 / groups.noise, axis=1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        energy = groups.reference_power * inverse_noise
        both = groups.gain * groups.reference_gain * groups.noise.shape[1] / energy
        own = np.where(groups.in_reference, 0.0, groups.reference_gain)
        return np.where(energy > 0, (groups.gain + own + both) / energy, np.inf)


class AdaptiveAverage:
    """Mean over the last groups for as long as nothing changes.

    For every group the window is split at each position. While the newer part differs in phase
    from the older by more than noise explains, the oldest group is dropped. A step empties the
    window at once, a slow change shortens it (the idea of ADWIN, A. Bifet and R. Gavalda, 2007).

    Parameters
    ----------
    length : int
        Longest window in groups.

    Examples
    --------
    >>> average, variance = AdaptiveAverage(4), np.array([1e-4])
    >>> for phase in (0.00, 0.01, 0.50):
    ...     ratio, spread = average.update(np.array([np.exp(1j * phase)]), variance)
    ...     print(np.angle(ratio).round(3), spread)
    [0.] [0.0001]
    [0.005] [5.e-05]
    [0.5] [0.0001]
    """

    def __init__(self, length: int) -> None:
        self._length = length
        self._ratios: list[Array] = []
        self._precision: list[Array] = []

    def update(self, ratios: Array, variance: Array) -> tuple[Array, Array]:
        """Take one group.

        Parameters
        ----------
        ratios : ndarray of complex, shape (n,)
            The window is common to all of them.
        variance : ndarray, shape (n,)
            Of each ratio; the window is emptied where one is not finite.

        Returns
        -------
        ratios : ndarray of complex, shape (n,)
            Averages over the window.
        variance : ndarray, shape (n,)
            Of the averages.
        """
        if not np.isfinite(variance).all():
            self._ratios.clear()
            self._precision.clear()
            return ratios, variance
        # The newest first, so that sums over the newest 1, 2, ... groups are cumulative.
        self._ratios.insert(0, ratios / variance)
        self._precision.insert(0, 1 / variance)
        del self._ratios[self._length :], self._precision[self._length :]
        sums = np.cumsum(self._ratios, axis=0)
        precision = np.cumsum(self._precision, axis=0)
        count = len(sums)
        while count > 1 and _changed(sums[:count], precision[:count]):
            count -= 1
        del self._ratios[count:], self._precision[count:]
        return sums[count - 1] / precision[count - 1], 1 / precision[count - 1]


def _changed(sums: Array, precision: Array) -> bool:
    """Whether the phase of some newer part differs from that of the rest."""
    mean = sums[-1] / precision[-1]
    newer, older = precision[:-1], precision[-1] - precision[:-1]
    difference = sums[:-1] / newer - (sums[-1] - sums[:-1]) / older
    across = difference.imag * mean.real - difference.real * mean.imag
    # Half of a complex variance lies across the mean.
    spread = (1 / newer + 1 / older) / 2 * (mean.real**2 + mean.imag**2)
    return bool((across**2 > _CHANGE * spread).any())
