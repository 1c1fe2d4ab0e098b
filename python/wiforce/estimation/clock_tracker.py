# SPDX-License-Identifier: GPL-3.0-or-later
"""A tag's free-running clock, tracked from group to group once it has been acquired."""

from __future__ import annotations

import math

import numpy as np

from .acquisition import ClockFit
from .groups import Array
from .likelihood import evaluate, turned_by

# Drift the tracker must follow, 0.5 ppm/s, taken as a random walk with this memory.
_DRIFT_PER_S = 0.5e-6
_DRIFT_MEMORY_S = 1.0
_CURVATURE_MEMORY = 24
_LARGEST_STEP = 0.2
# Standard deviations from which an error is a jump of the phase, which says nothing of the rate.
_JUMP = 6.0
# A group whose tones carry less than this part of the expected excess energy has no tag in it. A
# press changes the energy of a tag with an off reflection of .3 rho by 1.3 to .7 rho: to .29.
_PRESENCE = 0.1


class ClockTracker:
    """Two-state Kalman filter (phase, rate) on the gradient of J at the predicted phase.

    Parameters
    ----------
    fit : acquisition.ClockFit
        Where to start.
    times_s : ndarray, shape (L,)
        Centres of the groups that ``fit`` came from.
    nominal_rate : float
        2 pi fs.
    subcarriers : int
    noise_level : float
        Mean noise variance by which the likelihoods of ``fit`` are scaled.

    Attributes
    ----------
    time_s, phase, rate : float
        Phase in radians at a time, and its rate above nominal in rad/s.
    variances : (float, float, float)
        Variance of the phase, covariance, variance of the rate.
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
        # J and J'' of a mean group, free of the noise's scale, which may change.
        self._energy = noise_level * float(energy.mean())
        self._curvature = noise_level * float(curvature.mean())
        self._count = min(len(elapsed), _CURVATURE_MEMORY)

    def predict(self, time_s: float) -> tuple[float, float]:
        """Phase and rate (deviation from nominal, rad/s) expected at ``time_s``."""
        dt = time_s - self.time_s
        return self.phase + (self._nominal + self.rate) * dt, self.rate

    def update(
        self,
        time_s: float,
        tones: Array,
        inverse_noise: Array,
        noise_level: float,
        measured: tuple[float, float] | None = None,
    ) -> bool:
        """Advance to ``time_s`` and correct by the group's likelihood.

        Parameters
        ----------
        time_s : float
        tones : ndarray of complex, shape (M, K)
            Of the group, other tags taken out.
        inverse_noise : ndarray, shape (K,)
            1 / sigma_k^2 of a tone of unit noise gain.
        noise_level : float
            Mean noise variance by which the energy of a mean group is to be scaled.
        measured : (float, float), optional
            Error of the predicted phase and its variance, instead of the likelihood's.

        Returns
        -------
        present : bool
            False when the group's tones do not hold the tag; the clock then coasts.
        """
        self._advance(time_s)
        energy, slope, curvature = self.likelihood.at(self.phase, tones, inverse_noise)
        if not self._present(energy, self._energy / noise_level):
            return False
        self._count = min(self._count + 1, _CURVATURE_MEMORY)
        self._energy += (noise_level * energy - self._energy) / self._count
        self._curvature += (noise_level * curvature - self._curvature) / self._count
        error, variance = measured or self._measured(slope, noise_level)
        p00, p01, p11 = self.variances
        spread = p00 + variance
        jumped = error**2 > _JUMP**2 * spread
        error = min(max(error, -_LARGEST_STEP), _LARGEST_STEP)
        self.phase += p00 / spread * error
        if jumped:
            return True
        gain = p01 / spread
        self.rate += gain * error
        self.variances = (p00 - p00 / spread * p00, p01 - p00 / spread * p01, p11 - gain * p01)
        return True

    def correct(self, errors: Array, variances: Array) -> None:
        """Correct phase and rate at the time of the fit by errors of known variances."""
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
