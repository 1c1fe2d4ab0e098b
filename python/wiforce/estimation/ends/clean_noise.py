# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise of groups that were freed from spread lines at the clocks that they have shown."""

from __future__ import annotations

import numpy as np

from ..group_tones import GroupTones, power_of
from ..groups import Array
from .group_fit import GroupFit
from .noise import NoiseEstimate, NoiseHistory, Verdict, robust_noise

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
