# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise in H on each subcarrier, estimated from the residual of the least-squares fit.

It is the same in all groups, except where a transmitter on a few subcarriers interferes with some
of them (``NoiseHistory.raised``). The estimate itself is a kernel (``noise_estimate.h``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from ...wiforce_kernels import noise_estimate, raised_subcarriers
from ..group_tones import GroupFit, GroupTones, power_of
from ..groups import Array


class Verdict(Enum):
    """Result of comparing a group's residual with the noise.

    LEARNED: the group fits, or is a single outlier; STEPPED: the noise has risen or fallen;
    MODEL_LOST: ``STEP_GROUPS`` groups in a row do not fit: noise has risen, or a clock is tracked
    at a wrong phase.
    """

    LEARNED = 0
    STEPPED = 1
    MODEL_LOST = 2


@dataclass(frozen=True)
class NoiseHistory:
    """Noise in G groups."""

    # (G,), residual over the noise before, 1 when the model fits; raised subcarriers by their own
    # noise
    ratio: Array
    # (G, K), over the groups before where a narrow-band transmitter interfered; else 1
    raised: Array
    inverse: Array  # (G, K), 1 / sigma_k^2, by the groups before and ``raised``
    variance: Array  # (G, K), sigma_k^2 after it, without ``raised``
    verdict: Verdict  # on the last of these groups

    def __len__(self) -> int:
        return len(self.ratio)


class NoiseEstimate(noise_estimate):
    """Variance of the noise in H per subcarrier: a mean over the last two seconds of groups.

    ``profile`` (K,) is the noise of the subcarriers relative to each other, where only its level is
    to be learned. ``variance`` and ``inverse`` (K,) are empty until ``known``.
    """

    def follow(
        self, residuals: Array, freedom: int, levels: Sequence[float], complete: Sequence[bool]
    ) -> NoiseHistory:
        """Learn from groups up to the first one that the noise does not fit, at least one.

        ``residuals`` (G, K) are mean squares of the whitened residual per complex degree of
        ``freedom``, ``levels`` (G,) mean powers of the whitened tones; groups are learned from
        where ``complete``.
        """
        followed = super().follow(residuals, freedom, levels, complete)
        ratio, raised, inverse, variance, verdict = followed
        return NoiseHistory(ratio, raised, inverse, variance, Verdict(verdict))


def robust_noise(residuals: Array, freedom: int) -> Array:
    """Mean (K,) of the residuals (G, K) without subcarriers that are raised in some groups."""
    quartile = np.sort(residuals, axis=0)[len(residuals) // 4]
    if not np.all(quartile > 0):
        return np.asarray(residuals.mean(axis=0))
    # The quartile of 12 groups lies below the mean, by about one standard deviation of a ratio.
    inverse = (1 - 0.7 * freedom**-0.5) / quartile if freedom > 1 else 0.3 / quartile
    kept = raised_subcarriers(residuals * inverse, freedom) == 1
    if kept.all():
        return np.asarray(residuals.mean(axis=0))
    return np.asarray(np.sum(residuals * kept, axis=0) / np.maximum(kept.sum(axis=0), 1))


# Error of a phase, in rad, that noise does not explain: 0.003 deg (1024 and 4096 samples, SNR
# 60 dB, symbol of 0.05 of the tag's period; tests/models/waveform_captures.py).
_LEAST_ERROR = 6e-5


class CleanNoise:
    """Noise beside that of the clock tracking, which sees groups at clocks that it predicts.

    An error of a clock leaves spread lines in proportion to it: too few to matter for the clocks,
    but as much as noise of -15 dB.
    """

    def __init__(self, group_period_s: float) -> None:
        self._noise = NoiseEstimate(group_period_s)
        # Of the first groups that are given, since the clocks were acquired from all of these.
        self._from_all = True

    def reset(self) -> None:
        """Forget the groups so far, when the clocks were acquired again."""
        self._noise.known = self._from_all = False

    def follow(self, groups: GroupTones, fit: GroupFit) -> NoiseHistory:
        """Update the estimate by all of some groups, fitted without spread lines."""
        residuals, levels = fit.noise(), groups.level.tolist()
        complete = (groups.missing == 0).tolist()
        parts: list[NoiseHistory] = []
        first = 0
        while first < len(residuals):
            if not self._noise.known:
                block = slice(None) if self._from_all else slice(first, first + 1)
                start = robust_noise(residuals[block], fit.freedom)
                self._noise.set(start, max(levels[block]), len(residuals[block]))
            part = self._noise.follow(
                residuals[first:], fit.freedom, levels[first:], complete[first:]
            )
            if part.verdict is Verdict.MODEL_LOST:
                self.reset()
            parts.append(part)
            first += len(part)
        return NoiseHistory(
            np.concatenate([part.ratio for part in parts]),
            np.concatenate([part.raised for part in parts]),
            np.concatenate([part.inverse for part in parts]),
            np.concatenate([part.variance for part in parts]),
            Verdict.LEARNED,
        )


def gain_of_least_error(fit: GroupFit, inverse_noise: Array) -> Array:
    """Gain (G, E) of each end that is due to errors that are no noise.

    Variance of V over ``sigma_k^2``, for the error of a phase that remains of spread lines.
    """
    energy = np.sum(power_of(fit.ends) * inverse_noise[:, None], axis=2)
    gain: Array = 2 * _LEAST_ERROR**2 * energy
    return gain
