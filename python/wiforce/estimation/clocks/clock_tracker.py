# SPDX-License-Identifier: GPL-3.0-or-later
"""Tracking of a tag's free-running clock from group to group after its acquisition."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...wiforce_kernels import clock_tracker, predict_clocks
from ..groups import Array
from .acquisition import ClockFit
from .likelihood import evaluate, turned_by


class ClockPath(NamedTuple):
    """Clock phases in rad and rates above nominal in rad/s, (G, ...), at the centres of groups."""

    phase: Array
    rate: Array

    def of(self, tag: int, rows: slice = slice(None)) -> ClockPath:
        """The path of one of the tags, in some of the groups."""
        return ClockPath(self.phase[rows, tag], self.rate[rows, tag])


def expected_clocks(trackers: Sequence[clock_tracker], center_s: Array) -> ClockPath:
    """Clocks, (G, S), expected at the centres of groups."""
    return ClockPath(*predict_clocks(trackers, center_s))


class ClockTracker(clock_tracker):
    """Tracks the clock of a tag, with the likelihood of its phase.

    It begins with a fit of L groups at ``times_s``; ``noise_level`` is the mean noise variance that
    the likelihoods of the fit are scaled by.
    """

    def __init__(
        self,
        fit: ClockFit,
        times_s: Array,
        nominal_rate: float,
        subcarriers: int,
        noise_level: float,
    ) -> None:
        elapsed = times_s - times_s.mean()
        precision = max(float(np.sum(elapsed**2)), 1e-12)
        phases = fit.phase + (nominal_rate + fit.rate) * elapsed
        energy, _, curvature = evaluate(turned_by(fit.coefficients, phases))
        # J and J'' of a mean group, independent of the noise level, which may change.
        mean = noise_level * float(energy.mean()), noise_level * float(curvature.mean())
        super().__init__(
            fit.time_s,
            fit.phase,
            fit.rate,
            (fit.variance / len(elapsed), fit.variance / precision),
            nominal_rate,
            subcarriers,
            subcarriers * fit.likelihood.noise_variance,
            mean,
            len(elapsed),
            times_s[-1],
        )
        self.likelihood = fit.likelihood

    def __copy__(self) -> ClockTracker:
        other = ClockTracker.__new__(ClockTracker)
        clock_tracker.__init__(other, self)
        other.likelihood = self.likelihood
        return other

    def correct(self, errors: Array, variances: Array) -> None:
        """Correct phase and rate by their errors (2,) with known variances (2,)."""
        if not np.all(np.isfinite(variances)):
            return
        self.phase += float(errors[0])
        self.rate += float(errors[1])
        self.variances = (float(variances[0]), 0.0, float(variances[1]))
