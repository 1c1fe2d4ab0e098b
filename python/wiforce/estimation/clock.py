# SPDX-License-Identifier: GPL-3.0-or-later
"""A tag's free-running clock, tracked from group to group once it has been acquired."""

import math

import numpy as np

from .likelihood import evaluate, turned_by

# Drift the tracker must follow, 0.5 ppm/s, taken as a random walk with this memory.
_DRIFT_PER_S = 0.5e-6
_DRIFT_MEMORY_S = 1.0
_CURVATURE_MEMORY = 24
_LARGEST_STEP = 0.2
# Standard deviations from which an error is a jump of the phase, which tells nothing of the rate.
_JUMP = 6.0
# A group whose tones carry less than this part of the usual excess energy has no tag in it. A
# press turns a tag of off reflection .3 rho from 1.3 to .7 rho: to .29 of its energy.
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
    """

    def __init__(self, fit, times_s, nominal_rate, subcarriers, noise_level):
        self.likelihood = fit.likelihood
        self._nominal = nominal_rate
        self._subcarriers = subcarriers
        self._noise_variance = subcarriers * fit.likelihood.noise_variance
        self.time_s, self.phase, self.rate = fit.time_s, fit.phase, fit.rate
        elapsed = times_s - times_s.mean()
        self.covariance = fit.variance * np.diag(
            [1 / len(elapsed), 1 / max(np.sum(elapsed**2), 1e-12)]
        )
        self._drift_power = (_DRIFT_PER_S * nominal_rate) ** 2 * _DRIFT_MEMORY_S
        phases = fit.phase + (nominal_rate + fit.rate) * elapsed
        # Coefficients of a usual group, free of the noise's scale, which may change.
        self._usual = noise_level * turned_by(fit.coefficients, phases).mean(axis=0)
        self._count = min(len(elapsed), _CURVATURE_MEMORY)

    def predict(self, time_s):
        """Phase and rate (deviation from nominal, rad/s) expected at ``time_s``."""
        dt = time_s - self.time_s
        return self.phase + (self._nominal + self.rate) * dt, self.rate

    def update(self, time_s, coefficients, noise_level, measured=None):
        """Advances to ``time_s`` and corrects by the group's likelihood.

        Parameters
        ----------
        time_s : float
        coefficients : ndarray of complex, shape (D+1,)
            Of J(theta).
        noise_level : float
            Mean noise variance by which they are scaled.
        measured : (float, float), optional
            Error of the predicted phase and its variance, instead of what the likelihood says.

        Returns
        -------
        present : bool
            False when the group's tones do not hold the tag; the clock then coasts.
        """
        self._advance(time_s)
        turned = turned_by(coefficients, self.phase)
        if not self._present(turned, self._usual / noise_level):
            return False
        self._count = min(self._count + 1, _CURVATURE_MEMORY)
        self._usual += (noise_level * turned - self._usual) / self._count
        error, variance = measured or self._measured(turned, noise_level)
        spread = self.covariance[0, 0] + variance
        jumped = error**2 > _JUMP**2 * spread
        error = min(max(error, -_LARGEST_STEP), _LARGEST_STEP)
        gain = self.covariance[:, 0] / spread
        self.phase += gain[0] * error
        if jumped:
            return True
        self.rate += gain[1] * error
        self.covariance -= np.outer(gain, self.covariance[0])
        return True

    def correct(self, errors, variances):
        """Corrects phase and rate at the time of the fit by errors whose variances are known."""
        if not np.all(np.isfinite(variances)):
            return
        self.phase += errors[0]
        self.rate += errors[1]
        self.covariance = np.diag(variances)

    def _measured(self, turned, noise_level):
        kappa = max(-evaluate(self._usual)[2] / noise_level, 1e-9)
        return evaluate(turned)[1] / kappa, (kappa + self._noise_variance) / kappa**2

    def _advance(self, time_s):
        dt = time_s - self.time_s
        self.phase = (self.phase + (self._nominal + self.rate) * dt) % (2 * np.pi)
        step = np.array([[1.0, dt], [0.0, 1.0]])
        noise = self._drift_power * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        self.covariance = step @ self.covariance @ step.T + noise
        self.time_s = time_s

    def _present(self, turned, usual):
        """Whether the group's energy above that of noise, 2 per subcarrier, is about the usual."""
        excess, expected = (evaluate(q)[0] - 2 * self._subcarriers for q in (turned, usual))
        spread = 3 * math.sqrt(2 * self._subcarriers + 2 * max(expected, 0.0))
        return excess > min(_PRESENCE * expected, expected - spread)
