# SPDX-License-Identifier: GPL-3.0-or-later
"""A tag's free-running clock: found without knowing phase, offset or channel, then tracked.

With the two ends' channels unknown on every subcarrier, the energy that the tones P of a group
have in the span of the tag's harmonics, J(theta) = sum_k P_k^H Pi(theta) P_k, is the likelihood
of the clock phase theta. Pi turns with theta as exp(j (m - m') theta), so J is a trigonometric
polynomial, and a group is summed up in its few coefficients. Odd and even lines together also
tell theta from theta + pi.
"""

from dataclasses import dataclass

import numpy as np

from .tag_clock import harmonics

# Lines beyond this carry too little energy to help the clock.
_HIGHEST_LINE = 8
_PHASES = 512
# Drift the tracker must follow, 0.5 ppm/s, taken as a random walk with this memory.
_DRIFT_PER_S = 0.5e-6
_DRIFT_MEMORY_S = 1.0
_CURVATURE_MEMORY = 24
# A group whose tones carry less than this part of the usual excess energy has no tag in it.
_PRESENCE = 0.35


def explained_part(tones, tag, averaging_phase, clock2_delay=0.0):
    """Lines of one tag that serve its clock, and the projection onto their two waveforms.

    Parameters
    ----------
    tones : sequence of Tone
    tag : int
    averaging_phase : float
        fs Ta.
    clock2_delay : float
        Radians of clock 1 by which clock 2's pulses come late.

    Returns
    -------
    rows : ndarray of int, shape (L,)
    lines : ndarray of int, shape (L,)
        Harmonic number of each row.
    coefficients : ndarray of complex, shape (L, 2)
    """
    rows, lines = [], []
    for row, tone in enumerate(tones):
        if len(tone.owners) == 1 and tone.owners[0][0] == tag:
            m = tone.owners[0][1]
            unaliased = np.sign(m) == np.sign(tone.frequency_hz)
            if abs(m) <= _HIGHEST_LINE and unaliased:
                rows.append(row)
                lines.append(m)
    lines = np.array(lines)
    coefficients = harmonics(lines, averaging_phase).astype(complex)
    coefficients[:, 1] *= np.exp(-1j * lines * clock2_delay)
    return np.array(rows), lines, coefficients


class PhaseLikelihood:
    """Turns the tones of a group into the coefficients of J(theta).

    Parameters
    ----------
    table : ToneTable
    tag : int
    averaging_phase : float
        fs Ta.
    clock2_delay : float
        Radians.
    """

    def __init__(self, table, tag, averaging_phase, clock2_delay=0.0):
        self.rows, self.lines, coefficients = explained_part(
            table.tones, tag, averaging_phase, clock2_delay
        )
        # Rows are scaled to unit noise; the lines are then close enough to orthogonal.
        self.scale = 1 / np.linalg.norm(table.weights[self.rows], axis=1)
        basis, _ = np.linalg.qr(coefficients * self.scale[:, None])
        self.projection = basis @ basis.conj().T
        self._steps = self.lines[:, None] - self.lines[None, :]
        self.degree = int(self._steps.max())
        self._members = [self._steps == d for d in range(self.degree + 1)]
        # Variance of dJ/dtheta per subcarrier from unit noise alone: tr (dPi/dtheta)^2.
        self.noise_variance = float(np.sum(self._steps**2 * np.abs(self.projection) ** 2))

    def coefficients(self, tones, noise):
        """Coefficients q of J(theta) = q_0 + 2 Re sum_d q_d exp(j d theta).

        Parameters
        ----------
        tones : ndarray of complex, shape (M, K)
        noise : ndarray, shape (K,)
            Noise variance of a tone of unit noise gain on each subcarrier.

        Returns
        -------
        q : ndarray of complex, shape (degree + 1,)
        energy : float
            Of all lines, in units of the noise.
        """
        scaled = tones[self.rows] * self.scale[:, None]
        covariance = (scaled.conj() / noise) @ scaled.T
        terms = self.projection * covariance
        q = np.array([terms[member].sum() for member in self._members])
        return q, float(np.trace(covariance).real)


def evaluate(q, phase):
    """J, J' and J'' of coefficients q (..., D+1) at ``phase`` (scalar)."""
    d = np.arange(q.shape[-1])
    terms = 2 * q * np.exp(1j * d * phase)
    terms[..., 0] /= 2
    return (
        terms.real.sum(-1),
        (1j * d * terms).real.sum(-1),
        -(d**2 * terms).real.sum(-1),
    )


@dataclass(frozen=True)
class ClockFit:
    """A clock over a block of groups: phase at ``time_s`` and offset from nominal."""

    time_s: float
    phase: float
    rate: float
    energy: float
    total: float
    variance: float


def acquire(times_s, coefficients, energies, nominal_rate, tolerance_ppm, subcarriers, likelihood):
    """Fits phase and offset of a clock to a block of groups.

    Parameters
    ----------
    times_s : ndarray, shape (L,)
        Centres of the groups.
    coefficients : ndarray of complex, shape (L, D+1)
    energies : ndarray, shape (L,)
    nominal_rate : float
        2 pi fs.
    tolerance_ppm : float
        Offsets up to 1.5 times this are tried.
    subcarriers : int
    likelihood : PhaseLikelihood

    Returns
    -------
    ClockFit
    """
    d = np.arange(coefficients.shape[1])
    span = max(times_s[-1] - times_s[0], 1e-3)
    center = times_s.mean()
    # At the top degree the block must not turn by more than a quarter radian between two trials.
    step = 0.5 / (d[-1] * span)
    limit = 1.5e-6 * tolerance_ppm * nominal_rate
    rates = np.linspace(-limit, limit, 2 * int(np.ceil(limit / step)) + 1)
    elapsed = times_s - center
    best = (-np.inf, 0.0, 0.0)
    for rate in rates:
        turned = coefficients * np.exp(1j * np.outer((nominal_rate + rate) * elapsed, d))
        total = turned.sum(0)
        spectrum = np.zeros(_PHASES, complex)
        spectrum[: len(d)] = 2 * total
        spectrum[0] /= 2
        profile = (np.fft.ifft(spectrum) * _PHASES).real
        peak = int(np.argmax(profile))
        if profile[peak] > best[0]:
            best = (profile[peak], 2 * np.pi * peak / _PHASES, rate)
    _, phase, rate = best
    phase, rate = _refine(coefficients, elapsed, nominal_rate, phase, rate)
    value, _, curvature = evaluate_each(coefficients, phase + (nominal_rate + rate) * elapsed)
    kappa = max(-curvature.mean(), 1e-9)
    variance = (kappa + subcarriers * likelihood.noise_variance) / kappa**2
    return ClockFit(center, phase, rate, float(value.sum()), float(np.sum(energies)), variance)


def evaluate_each(coefficients, phases):
    """J, J', J'' of each group at its own phase; shapes (L,)."""
    d = np.arange(coefficients.shape[1])
    turned = coefficients * np.exp(1j * np.outer(phases, d))
    return evaluate(turned, 0.0)


def _refine(coefficients, elapsed, nominal_rate, phase, rate, iterations=6):
    """Newton steps on J over phase and rate, held to the neighbourhood of the grid's best."""
    for _ in range(iterations):
        _, slope, curvature = evaluate_each(coefficients, phase + (nominal_rate + rate) * elapsed)
        gradient = np.array([slope.sum(), (slope * elapsed).sum()])
        mean = min(curvature.mean(), 0.0)
        if mean == 0.0:
            break
        # Expected rather than observed curvature: single groups are too noisy at low SNR.
        matrix = -mean * np.array(
            [[len(elapsed), elapsed.sum()], [elapsed.sum(), (elapsed**2).sum()]]
        )
        move = np.linalg.solve(matrix + 1e-12 * np.eye(2) * matrix[0, 0], gradient)
        phase += np.clip(move[0], -0.05, 0.05)
        rate += np.clip(move[1], -0.1, 0.1)
    return phase, rate


class ClockTracker:
    """Two-state Kalman filter (phase, rate) on the gradient of J at the predicted phase.

    Parameters
    ----------
    likelihood : PhaseLikelihood
    nominal_rate : float
        2 pi fs.
    fit : ClockFit
        Where to start.
    groups : int
        Length of the block that ``fit`` came from.
    group_period_s : float
    subcarriers : int
    """

    def __init__(self, likelihood, nominal_rate, fit, groups, group_period_s, subcarriers):
        self._likelihood = likelihood
        self._nominal = nominal_rate
        self._subcarriers = subcarriers
        self.time_s, self.phase, self.rate = fit.time_s, fit.phase, fit.rate
        elapsed = (np.arange(groups) - (groups - 1) / 2) * group_period_s
        self.covariance = fit.variance * np.diag([1 / groups, 1 / max(np.sum(elapsed**2), 1e-12)])
        self._drift_power = (_DRIFT_PER_S * nominal_rate) ** 2 * _DRIFT_MEMORY_S
        self._mean = None
        self._count = 0

    def predict(self, time_s):
        """Phase and rate (deviation from nominal, rad/s) expected at ``time_s``."""
        dt = time_s - self.time_s
        return self.phase + (self._nominal + self.rate) * dt, self.rate

    def absorb(self, time_s, q):
        """Averages a group of the acquisition block into the curvature; no state change."""
        phase, _ = self.predict(time_s)
        self._average(q * np.exp(1j * np.arange(len(q)) * phase))

    def update(self, time_s, q):
        """Advances to ``time_s`` and corrects by the group's likelihood.

        Returns
        -------
        present : bool
            False when the group's tones do not hold the tag; the clock then coasts.
        """
        self._advance(time_s)
        turned = q * np.exp(1j * np.arange(len(q)) * self.phase)
        if not self._present(turned):
            return False
        self._average(turned)
        _, slope, _ = evaluate(turned, 0.0)
        kappa = max(-evaluate(self._mean, 0.0)[2], 1e-9)
        variance = (kappa + self._subcarriers * self._likelihood.noise_variance) / kappa**2
        error = np.clip(slope / kappa, -0.2, 0.2)
        gain = self.covariance[:, 0] / (self.covariance[0, 0] + variance)
        self.phase += gain[0] * error
        self.rate += gain[1] * error
        self.covariance -= np.outer(gain, self.covariance[0])
        return True

    def _advance(self, time_s):
        dt = time_s - self.time_s
        self.phase = (self.phase + (self._nominal + self.rate) * dt) % (2 * np.pi)
        step = np.array([[1.0, dt], [0.0, 1.0]])
        noise = self._drift_power * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        self.covariance = step @ self.covariance @ step.T + noise
        self.time_s = time_s

    def _excess(self, turned):
        """Energy above that of noise, 2 per subcarrier."""
        return evaluate(turned, 0.0)[0] - 2 * self._subcarriers

    def _present(self, turned):
        usual = self._excess(self._mean)
        spread = 3 * np.sqrt(2 * self._subcarriers + 2 * max(usual, 0.0))
        return self._excess(turned) > min(_PRESENCE * usual, usual - spread)

    def _average(self, turned):
        self._count = min(self._count + 1, _CURVATURE_MEMORY)
        if self._mean is None:
            self._mean = turned.copy()
        else:
            self._mean += (turned - self._mean) / self._count
