# SPDX-License-Identifier: GPL-3.0-or-later
"""From one ratio per subcarrier to one per end, and averaging over groups that follows a touch."""

from collections import deque
from dataclasses import replace

import numpy as np

from ..errors import InputError
from .reference import subcarrier_weights

# Squared standard deviations by which the newer part of a window must differ from the older.
_CHANGE = 8.0


class SubcarrierAverage:
    """R_i = sum_k w_k X_i,k with w_k = 1 / sigma_k^2, and the standard deviation of its phase.

    Parameters
    ----------
    bins : ndarray of int
        Occupied FFT bins.
    smoothing_groups : int
        Groups averaged while nothing changes; 1 for none.

    Raises
    ------
    InputError
        When ``smoothing_groups`` is below 1.
    """

    def __init__(self, bins, smoothing_groups=1):
        if smoothing_groups < 1:
            raise InputError("smoothing_groups", "must be at least 1", smoothing_groups)
        self.bins = np.asarray(bins)
        self._smoothing = smoothing_groups
        self._smoothers = None

    def process(self, state, vectors):
        """Averages one group of vectors (2S, 64).

        Returns
        -------
        GroupState
            With ``std_deg``; infinite for an end that is not there or has no reference.
        ndarray of complex, shape (2S,)
            R.
        """
        weights = subcarrier_weights(state.noise)
        ratios = np.asarray(vectors)[:, self.bins] @ weights
        if state.new_reference:
            self._smoothers = None
        variance = ratio_variance(state)
        if self._smoothing > 1:
            ratios, variance = self._smooth(ratios, variance)
        with np.errstate(divide="ignore", invalid="ignore"):
            std = np.degrees(np.sqrt(variance / 2) / np.abs(ratios))
        return replace(state, std_deg=np.where(np.abs(ratios) > 0, std, np.inf)), ratios

    def _smooth(self, ratios, variance):
        tags = len(ratios) // 2
        if self._smoothers is None:
            self._smoothers = [AdaptiveAverage(self._smoothing) for _ in range(tags)]
        pairs = [
            smoother.update(ratios[2 * i : 2 * i + 2], variance[2 * i : 2 * i + 2])
            for i, smoother in enumerate(self._smoothers)
        ]
        return np.concatenate([p[0] for p in pairs]), np.concatenate([p[1] for p in pairs])


def ratio_variance(state):
    """Variance of the complex R_i, noise of group and reference included; shape (2S,).

    (g + g_ref + g g_ref K / E) / E with E = sum_k |V_ref|^2 / sigma_k^2, g the variances of V and
    V_ref over that of H.
    """
    inverse_noise = np.sum(1 / state.noise)
    with np.errstate(divide="ignore", invalid="ignore"):
        energy = state.reference_power * inverse_noise
        both = state.gain * state.reference_gain * len(state.noise) / energy
        total = state.gain + np.where(state.in_reference, 0.0, state.reference_gain) + both
        return np.where(energy > 0, total / energy, np.inf)


class AdaptiveAverage:
    """Mean over the last groups for as long as nothing changes.

    At every group the window is split at each place; while the newer part differs in phase from
    the older by more than noise explains, the oldest group is dropped. A step empties the window
    at once, a slow change shortens it.

    Parameters
    ----------
    length : int
        Longest window in groups.
    """

    def __init__(self, length):
        self._window = deque(maxlen=length)

    def update(self, ratios, variance):
        """Takes one group's ratios (n,) with their variances (n,); gives the averages of both."""
        if not np.all(np.isfinite(variance)):
            self._window.clear()
            return ratios, variance
        self._window.append((ratios / variance, 1 / variance))
        while True:
            # Sums over the newest 1, 2, ... groups.
            sums = np.cumsum([item[0] for item in reversed(self._window)], axis=0)
            precision = np.cumsum([item[1] for item in reversed(self._window)], axis=0)
            mean = sums[-1] / precision[-1]
            if len(sums) == 1 or not _changed(sums, precision, mean):
                return mean, 1 / precision[-1]
            self._window.popleft()


def _changed(sums, precision, mean):
    """Whether the phase of some newer part differs from that of the rest."""
    newer, older = precision[:-1], precision[-1] - precision[:-1]
    difference = sums[:-1] / newer - (sums[-1] - sums[:-1]) / older
    across = (difference * mean.conj()).imag
    # Half of a complex variance lies across the mean.
    spread = (1 / newer + 1 / older) / 2 * np.abs(mean) ** 2
    return bool(np.any(across**2 > _CHANGE * spread))
