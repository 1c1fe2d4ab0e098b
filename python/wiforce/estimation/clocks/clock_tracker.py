# SPDX-License-Identifier: GPL-3.0-or-later
"""Tracking of a tag's free-running clock from group to group after its acquisition."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, overload

import numpy as np

from ..groups import Array
from .acquisition import ClockFit
from .likelihood import evaluate, turned_by

# The drift of up to 0.5 ppm/s is modelled as a random walk of the rate that reaches it in 1 s.
_DRIFT_PER_S = 0.5e-6
_DRIFT_MEMORY_S = 1.0
# Groups that energy and curvature of J are averaged over, and the largest correction of the phase
# in rad: half a period of J's highest term, 2 pi / 16.
_CURVATURE_MEMORY = 24
_LARGEST_STEP = 0.2
# Standard deviations above which an error is a jump of the phase, which does not change the rate.
_JUMP_STDS = 6.0
# A group with less than this share of the expected excess energy does not contain the tag. A press
# changes the amplitude of a tag with an off reflection of 0.3 rho from 1.3 to 0.7 rho, its energy
# by a factor of 0.29.
_PRESENCE = 0.1


class ClockPath(NamedTuple):
    """Clock phases in rad and rates above nominal in rad/s, (G, ...), at the centres of groups."""

    phase: Array
    rate: Array

    def of(self, tag: int, rows: slice = slice(None)) -> ClockPath:
        """The path of one of the tags, in some of the groups."""
        return ClockPath(self.phase[rows, tag], self.rate[rows, tag])


def predict_clocks(trackers: Sequence[ClockTracker], center_s: Array) -> ClockPath:
    """Clocks, (G, S), expected at the centres of groups."""
    phase, rate = np.empty((2, len(center_s), len(trackers)))
    for tag, tracker in enumerate(trackers):
        phase[:, tag], rate[:, tag] = tracker.predict(center_s)
    return ClockPath(phase, rate)


class ClockTracker:
    """Two-state Kalman filter (phase, rate) on the gradient of J at the predicted phase.

    It begins with a fit of L groups at ``times_s``; ``noise_level`` is the mean noise variance that
    the likelihoods of the fit are scaled by. ``variances`` are that of the phase, the covariance,
    and that of the rate.
    """

    def __init__(
        self,
        fit: ClockFit,
        times_s: Array,
        nominal_rate: float,
        subcarriers: int,
        noise_level: float,
    ) -> None:
        self.likelihood = fit.likelihood
        self._nominal = nominal_rate
        self._subcarriers = subcarriers
        self._noise_variance = subcarriers * fit.likelihood.noise_variance
        self.time_s, self.phase, self.rate = fit.time_s, fit.phase, fit.rate
        elapsed = times_s - times_s.mean()
        precision = max(float(np.sum(elapsed**2)), 1e-12)
        self.variances = (fit.variance / len(elapsed), 0.0, fit.variance / precision)
        self._drift_power = (_DRIFT_PER_S * nominal_rate) ** 2 * _DRIFT_MEMORY_S
        phases = fit.phase + (nominal_rate + fit.rate) * elapsed
        energy, _, curvature = evaluate(turned_by(fit.coefficients, phases))
        # J and J'' of a mean group, independent of the noise level, which may change.
        self._energy = noise_level * float(energy.mean())
        self._curvature = noise_level * float(curvature.mean())
        self._count = min(len(elapsed), _CURVATURE_MEMORY)

    @overload
    def predict(self, time_s: float) -> tuple[float, float]: ...
    @overload
    def predict(self, time_s: Array) -> tuple[Array, float]: ...
    def predict(self, time_s: float | Array) -> tuple[float | Array, float]:
        """Phase (rad) and rate (deviation from nominal, rad/s) expected at ``time_s``."""
        dt = time_s - self.time_s
        return self.phase + (self._nominal + self.rate) * dt, self.rate

    def ahead_of(self, phase: float, time_s: float) -> float:
        """By how much the phase expected at ``time_s`` exceeds another one, in rad."""
        return math.remainder(self.predict(time_s)[0] - phase, 2 * math.pi)

    def update(
        self,
        time_s: float,
        likelihood: Sequence[float],
        noise_level: float,
        measured: tuple[float, float] | None = None,
        ahead: float = 0.0,
    ) -> bool:
        """Advance to ``time_s`` and correct by the group's likelihood; False when it lacks the tag.

        The clock then coasts. ``likelihood`` are J, J' and J'' of the group, without the other
        tags, at a phase that the predicted one exceeds by ``ahead`` rad; ``noise_level`` scales the
        energy of a mean group; ``measured`` is the error of that phase and its variance, instead of
        the likelihood's.
        """
        self._advance(time_s)
        energy, slope, curvature = likelihood
        energy += ahead * (slope + ahead * curvature / 2)
        if not self._present(energy, self._energy / noise_level):
            return False
        self._count = min(self._count + 1, _CURVATURE_MEMORY)
        self._energy += (noise_level * energy - self._energy) / self._count
        self._curvature += (noise_level * curvature - self._curvature) / self._count
        if measured:
            error, variance = measured[0] - ahead, measured[1]
        else:
            error, variance = self._measured(slope + ahead * curvature, noise_level)
        p00, p01, p11 = self.variances
        spread = p00 + variance
        jumped = error**2 > _JUMP_STDS**2 * spread
        error = min(max(error, -_LARGEST_STEP), _LARGEST_STEP)
        self.phase += p00 / spread * error
        if jumped:
            return True
        gain = p01 / spread
        self.rate += gain * error
        self.variances = (p00 - p00 / spread * p00, p01 - p00 / spread * p01, p11 - gain * p01)
        return True

    def correct(self, errors: Array, variances: Array) -> None:
        """Correct phase and rate by their errors (2,) with known variances (2,)."""
        if not np.all(np.isfinite(variances)):
            return
        self.phase += float(errors[0])
        self.rate += float(errors[1])
        self.variances = (float(variances[0]), 0.0, float(variances[1]))

    def _measured(self, slope: float, noise_level: float) -> tuple[float, float]:
        kappa = max(-self._curvature / noise_level, 1e-9)
        return slope / kappa, (kappa + self._noise_variance) / kappa**2

    def _advance(self, time_s: float) -> None:
        dt = time_s - self.time_s
        self.phase = (self.phase + (self._nominal + self.rate) * dt) % (2 * math.pi)
        p00, p01, p11 = self.variances
        q = self._drift_power
        self.variances = (
            p00 + 2 * dt * p01 + dt**2 * p11 + q * dt**3 / 3,
            p01 + dt * p11 + q * dt**2 / 2,
            p11 + q * dt,
        )
        self.time_s = time_s

    def _present(self, energy: float, expected: float) -> bool:
        """Whether the energy above that of noise, 2 per subcarrier, is about as expected."""
        excess, expected = energy - 2 * self._subcarriers, expected - 2 * self._subcarriers
        spread = 3 * math.sqrt(2 * self._subcarriers + 2 * max(expected, 0.0))
        return excess > min(_PRESENCE * expected, expected - spread)
