# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise in H on each subcarrier, estimated from the residual of the least-squares fit.

It is the same in all groups, except where a transmitter on a few subcarriers interferes with some
of them (``NoiseEstimate.raised``).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from ..groups import Array

# Noise is averaged over two seconds, at least 32 groups: with M - 2S = 14 degrees of freedom per
# group the estimate on a subcarrier then has a standard deviation of 5 %, which costs 0.01 dB.
_MEMORY_S = 2.0
_LEAST_MEMORY_GROUPS = 32
# Smallest noise power relative to the mean tone. Tones in single precision have rounding errors of
# (6e-8)^2 = 3.6e-15.
_FLOOR = 1e-14
# Ratio of a group's residual to the noise above which the group is an outlier; its value and those
# of the two constants below are measured in docs/data/thresholds.csv.
OUTLIER_RATIO = 3.0
# The noise has changed when the median over this many groups has, by this factor. A press that
# changes disturbs fewer groups.
STEP_GROUPS = 8
_STEP = 1.33
# A transmitter on few subcarriers leaves the rest of them as they are: up to this lower quartile of
# the ratios, a group's noise may be raised on single subcarriers. Bursts, presses that change and
# errors of a clock raise it on all.
_NARROW_BAND_QUARTILE = 1.5
# Standard deviations above which a subcarrier is raised: exceeded by noise in 1 of 10 million. The
# limit grows with the cube of the quartile, since a residual with the profile of a fading tag
# (exponential powers, 14 times the quartile at most) is no narrow-band transmitter.
_RAISED_STDS = 5.2
# Least ratio that counts: with an SNR above 20 dB, what edges of the tag spread over the
# subcarriers reaches 3, and less costs hardly anything.
_LEAST_RAISED = 4.0
# Groups in a row in which it is raised after which that is its usual noise. A transmitter that is
# on a subcarrier in four groups of ten hardly ever stays for as long.
_LASTING_GROUPS = 16
_NO_GROUPS: Array = np.zeros(0, int)


class Verdict(Enum):
    """Result of comparing a group's residual with the noise.

    Attributes
    ----------
    LEARNED
        The group fits, or is a single outlier.
    STEPPED
        The noise has risen or fallen.
    MODEL_LOST
        ``STEP_GROUPS`` groups in a row do not fit: noise has risen, or a clock is tracked at a
        wrong phase.
    """

    LEARNED = auto()
    STEPPED = auto()
    MODEL_LOST = auto()


@dataclass(frozen=True)
class NoiseHistory:
    """Noise in G groups.

    Attributes
    ----------
    ratio : ndarray, shape (G,)
        Residual of each group over the noise before it, 1 when the model fits. Raised subcarriers
        count by their own noise.
    raised : ndarray, shape (G, K)
        Noise of each group over that of the groups before (``NoiseEstimate.raised``).
    inverse : ndarray, shape (G, K)
        1 / sigma_k^2 of each group, by the groups before and ``raised``.
    variance : ndarray, shape (G, K)
        sigma_k^2 after it, without ``raised``.
    verdict : Verdict
        On the last of these groups.
    """

    ratio: Array
    raised: Array
    inverse: Array
    variance: Array
    verdict: Verdict

    def __len__(self) -> int:
        return len(self.ratio)


class NoiseEstimate:
    """Variance of the noise in H per subcarrier: a mean over the last two seconds of groups.

    Parameters
    ----------
    group_period_s : float
        Length of a group, in s.
    profile : ndarray, shape (K,), optional
        Noise of the subcarriers relative to each other, where only its level is to be learned: what
        tags spread over the subcarriers within a long symbol has a pattern that would correlate
        with the weights.

    Attributes
    ----------
    known : bool
        Whether there is an estimate yet; until then the arrays below are empty.
    variance : ndarray, shape (K,)
        sigma_k^2.
    inverse : ndarray, shape (K,)
        1 / sigma_k^2.
    memory : int
        Groups that it is a mean of, at most.
    """

    def __init__(self, group_period_s: float, profile: Array | None = None) -> None:
        self.known = False
        self._profile = profile
        self.variance: Array = np.empty(0)
        self.inverse: Array = np.empty(0)
        self._groups = 0
        self.memory = max(_LEAST_MEMORY_GROUPS, int(_MEMORY_S / group_period_s))
        self._ratios: deque[float] = deque(maxlen=STEP_GROUPS)
        self._raised_groups = _NO_GROUPS

    @property
    def level(self) -> float:
        """Mean of the variance over the subcarriers."""
        return float(self.variance.sum()) / len(self.variance)

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
        if self._profile is not None:
            variance = self._profile * float(np.mean(variance / self._profile))
        self.variance = np.maximum(variance, max(_FLOOR * level, 1e-300))
        self.inverse = 1 / self.variance
        if groups is not None:
            self._groups = groups

    def raised(self, residual: Array, freedom: int) -> Array:
        """Noise of a group over that of the groups before, 1 where it is not significantly more.

        Returns ndarray, shape (K,): above 1 on subcarriers that a narrow-band transmitter
        interfered with.

        Parameters
        ----------
        residual : ndarray, shape (K,)
            Mean square of the group's whitened residual per degree of freedom.
        freedom : int
            Its complex degrees of freedom on each subcarrier.
        """
        return raised_subcarriers(residual * self.inverse, freedom)

    def follow(
        self, residuals: Array, freedom: int, levels: Sequence[float], complete: Sequence[bool]
    ) -> NoiseHistory:
        """Update the estimate group by group, up to the first one that it does not fit.

        Returns NoiseHistory: of as many groups as were taken, at least one; of all of them where
        each is LEARNED.

        Parameters
        ----------
        residuals : ndarray, shape (G, K)
            Mean square of each group's whitened residual per degree of freedom.
        freedom : int
            Complex degrees of freedom of each on every subcarrier.
        levels : sequence of float, length G
            Mean power of each group's whitened tones.
        complete : sequence of bool, length G
            Whether the group may be learned from.
        """
        limit = _raised_limit(freedom)
        ratio, raised = np.empty(len(residuals)), np.ones(residuals.shape)
        inverse, variance = np.empty((2, *residuals.shape))
        verdict, count = Verdict.LEARNED, 0
        while verdict is Verdict.LEARNED and count < len(residuals):
            inverse[count], residual = self.inverse, residuals[count]
            ratios, interfered = residual * self.inverse, None
            if ratios.max() > limit:
                interfered = raised[count] = raised_subcarriers(ratios, freedom)
                inverse[count] /= interfered
                ratios /= interfered
            ratio[count] = ratios.sum() / len(ratios)
            if complete[count]:
                verdict = self.learn(residual, float(ratio[count]), levels[count], interfered)
            variance[count] = self.variance
            count += 1
        return NoiseHistory(
            ratio[:count], raised[:count], inverse[:count], variance[:count], verdict
        )

    def learn(
        self, residual: Array, ratio: float, level: float, raised: Array | None = None
    ) -> Verdict:
        """Update the estimate by a complete group.

        Parameters
        ----------
        residual : ndarray, shape (K,)
            Mean square of the whitened residual per degree of freedom.
        ratio : float
            Mean over the subcarriers of the residual over the noise, 1 when the model fits.
            Raised subcarriers count by their own noise.
        level : float
            Mean power of the group's whitened tones.
        raised : ndarray, shape (K,), optional
            See :meth:`raised`. These subcarriers are learned only if it lasts. None where none is
            raised.
        """
        if raised is None:
            self._raised_groups = _NO_GROUPS
        else:
            residual = self._without_passing(residual, raised > 1)
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
            return Verdict.STEPPED
        self._groups = min(self._groups + 1, self.memory)
        self.set(self.variance + (residual - self.variance) / self._groups, level)
        return Verdict.LEARNED

    def _without_passing(self, residual: Array, raised: Array) -> Array:
        """A residual with the usual noise on subcarriers that are raised for a short time."""
        if len(self._raised_groups) != len(raised):
            self._raised_groups = np.zeros(len(raised), int)
        self._raised_groups = np.where(raised, self._raised_groups + 1, 0)
        passing = raised & (self._raised_groups <= _LASTING_GROUPS)
        return np.where(passing, self.variance, residual)


def raised_subcarriers(ratios: Array, freedom: int) -> Array:
    """Ratios of a group's noise to the usual one, 1 where they are not significantly more.

    Returns ndarray, shape (K,): all 1 where the lower quartile of the ratios is raised as well.

    Parameters
    ----------
    ratios : ndarray, shape (K,)
        Mean square residual over the usual noise, each of ``freedom`` complex degrees of freedom.
    """
    limit = _raised_limit(freedom)
    if ratios.max() > limit:
        quarter = len(ratios) // 4
        quartile = max(1.0, np.partition(ratios, quarter)[quarter])
        if quartile <= _NARROW_BAND_QUARTILE:
            return np.where(ratios > limit * quartile**3, ratios, 1.0)
    return np.ones_like(ratios)


def _raised_limit(freedom: int) -> float:
    return max(chi_squared_limit(freedom, _RAISED_STDS), _LEAST_RAISED)


def chi_squared_limit(freedom: float, stds: float) -> float:
    """Value that a mean of squares exceeds as seldom as a normal variable so many deviations.

    Parameters
    ----------
    freedom : float
        Complex degrees of freedom of the mean, whose expectation is 1.
    stds : float
        Standard deviations of the normal variable.

    Notes
    -----
    Approximation of a chi-squared variable of 2 ``freedom`` degrees of freedom by E. B. Wilson and
    M. M. Hilferty (1931).
    """
    return (1 - 1 / (9 * freedom) + stds / (3 * freedom**0.5)) ** 3


def robust_noise(residuals: Array, freedom: int) -> Array:
    """Mean of the residuals of some groups without subcarriers that are raised in some of them.

    Returns ndarray, shape (K,).

    Parameters
    ----------
    residuals : ndarray, shape (G, K)
        Mean square residual of each group and subcarrier.
    freedom : int
        Complex degrees of freedom of each.
    """
    quartile = np.sort(residuals, axis=0)[len(residuals) // 4]
    if not np.all(quartile > 0):
        return np.asarray(residuals.mean(axis=0))
    # The quartile of 12 groups lies below the mean, by about one standard deviation of a ratio.
    inverse = (1 - 0.7 * freedom**-0.5) / quartile if freedom > 1 else 0.3 / quartile
    kept = np.array([raised_subcarriers(each * inverse, freedom) == 1 for each in residuals])
    if kept.all():
        return np.asarray(residuals.mean(axis=0))
    return np.asarray(np.sum(residuals * kept, axis=0) / np.maximum(kept.sum(axis=0), 1))
