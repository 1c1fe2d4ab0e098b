# SPDX-License-Identifier: GPL-3.0-or-later
"""A tag's clock found in a block of groups: phase, offset, and how the two clocks lie.

Nothing is known but the nominal frequency: phase, offset, channels and levels are not.
"""

from dataclasses import dataclass

import numpy as np

from .likelihood import PhaseLikelihood, evaluate, turned_by

_PHASES = 512
# By how much (in log-likelihood) clock 2 must fit better elsewhere for its place to be believed.
DELAY_EVIDENCE = 12.0
# A delay of clock 2 beyond which the pulses, pi/2 and pi/4 wide and pi/2 apart, overlap.
OVERLAP = np.pi / 8
# A tag is there when its waveforms explain so much more than noise would, per dimension, ...
_ENERGY_RATIO = 1.25
# ... and the groups agree on the clock by so many standard deviations.
_AGREEMENT = 5.0
# Standard deviations by which its rate may lie beyond what is tried.
_RATE_SLACK = 4.0


@dataclass(frozen=True)
class ClockFit:
    """A clock over a block of groups.

    Attributes
    ----------
    time_s, phase, rate : float
        Phase in radians at ``time_s``, and its rate above nominal in rad/s.
    variance : float
        Of the phase that a single group gives.
    likelihood : PhaseLikelihood
        With the delay of clock 2 found.
    coefficients : ndarray of complex, shape (L, D+1)
        Of each group.
    found : bool
        Whether there is a tag at all.
    """

    time_s: float
    phase: float
    rate: float
    variance: float
    likelihood: PhaseLikelihood
    coefficients: np.ndarray
    found: bool

    @property
    def clock2_delay(self):
        """Radians of clock 1 by which clock 2's pulses come late; 0 when nothing speaks for it."""
        return self.likelihood.clock2_delay

    @property
    def overlapping(self):
        """Whether the two switches are on together."""
        return abs(self.clock2_delay) > OVERLAP


def acquire(times_s, covariances, likelihood, nominal_rate, tolerance_ppm, subcarriers):
    """Fits phase, offset and the delay of clock 2 to a block of groups.

    Parameters
    ----------
    times_s : ndarray, shape (L,)
        Centres of the groups.
    covariances : ndarray of complex, shape (L, lines, lines)
        ``likelihood.covariance`` of each.
    likelihood : PhaseLikelihood
        With no delay.
    nominal_rate : float
        2 pi fs.
    tolerance_ppm : float
        Offsets up to 1.5 times this are tried.
    subcarriers : int

    Returns
    -------
    ClockFit
    """
    center = times_s.mean()
    elapsed = times_s - center
    limit = 1.5e-6 * tolerance_ppm * nominal_rate
    coefficients = likelihood.coefficients(covariances)
    rate, phase = _search(coefficients, elapsed, nominal_rate, limit)
    path = (nominal_rate + rate) * elapsed
    block = likelihood.turned(covariances, path).sum(axis=0)
    likelihood, phase = _place_clock_2(likelihood, block)
    coefficients = likelihood.coefficients(covariances)
    phase, rate = _refine(coefficients, elapsed, nominal_rate, phase, rate)
    phases = phase + (nominal_rate + rate) * elapsed
    values, _, curvatures = evaluate(turned_by(coefficients, phases))
    kappa = max(-curvatures.mean(), 1e-9)
    variance = (kappa + subcarriers * likelihood.noise_variance) / kappa**2
    total = np.trace(covariances, axis1=1, axis2=2).real.sum()
    found = _believable(values.sum(), total, coefficients, len(likelihood.lines), subcarriers)
    # A clock that jumps within the block seems to run at a rate which no such crystal has.
    rate_std = np.sqrt(variance / np.sum(elapsed**2))
    found = found and abs(rate) <= limit + _RATE_SLACK * rate_std
    return ClockFit(center, phase, rate, variance, likelihood, coefficients, found)


def _profile(coefficients):
    """J on a circle of phases, by a Fourier transform of its coefficients (..., D+1)."""
    spectrum = np.zeros((*coefficients.shape[:-1], _PHASES), complex)
    spectrum[..., : coefficients.shape[-1]] = 2 * coefficients
    spectrum[..., 0] /= 2
    return (np.fft.ifft(spectrum) * _PHASES).real


def _search(coefficients, elapsed, nominal_rate, limit):
    """Rate and phase of the highest likelihood on a grid."""
    degree = coefficients.shape[1] - 1
    # At the top degree the block must not turn by more than a quarter radian between two trials.
    step = 0.5 / (degree * max(np.ptp(elapsed), 1e-3))
    rates = np.linspace(-limit, limit, 2 * int(np.ceil(limit / step)) + 1)
    paths = np.multiply.outer(nominal_rate + rates, elapsed)
    profiles = _profile(np.array([turned_by(coefficients, path).sum(axis=0) for path in paths]))
    best, peak = np.unravel_index(np.argmax(profiles), profiles.shape)
    return rates[best], 2 * np.pi * peak / _PHASES


def _place_clock_2(likelihood, block):
    """Likelihood with the delay of clock 2 that the block speaks for, and the clock's phase.

    A true 75 % clock 2 about the same centres is one that comes a quarter of Ts late and is
    inverted: the line's sign goes with its unknown channel.
    """
    from scipy.optimize import minimize_scalar

    def best(delay):
        coefficients = likelihood.delayed(delay).coefficients(block)
        return _climb(coefficients, 2 * np.pi * np.argmax(_profile(coefficients)) / _PHASES)

    at_nominal, phase = best(0.0)
    delays, projections = likelihood.delays
    values = _profile(likelihood.coefficients(block, projections)).max(axis=1)
    coarse = delays[np.argmax(values)]
    # What a finer search could still gain is less than the curvature of line 8 over half a step.
    if values.max() * 1.05 - at_nominal < DELAY_EVIDENCE:
        return likelihood, phase
    step = delays[1] - delays[0]
    delay = minimize_scalar(
        lambda x: -best(x)[0],
        bounds=(coarse - step, coarse + step),
        method="bounded",
        options={"xatol": 1e-5},
    ).x
    if best(delay)[0] - at_nominal < DELAY_EVIDENCE:
        return likelihood, phase
    phase = best(delay)[1]
    # A delay of half a period of clock 2 is none.
    return likelihood.delayed((delay + np.pi / 2) % np.pi - np.pi / 2), phase


def _climb(coefficients, phase):
    """J and phase at the top of the hill on whose side ``phase`` lies."""
    for _ in range(3):
        _, slope, curvature = evaluate(turned_by(coefficients, phase))
        if curvature >= 0:
            break
        phase = phase - np.clip(slope / curvature, -0.01, 0.01)
    return evaluate(turned_by(coefficients, phase))[0], phase


def _refine(coefficients, elapsed, nominal_rate, phase, rate, iterations=6):
    """Newton steps on J over phase and rate, held to the neighbourhood of the grid's best."""
    sums = np.array([[len(elapsed), elapsed.sum()], [elapsed.sum(), (elapsed**2).sum()]])
    for _ in range(iterations):
        turned = turned_by(coefficients, phase + (nominal_rate + rate) * elapsed)
        _, slope, curvature = evaluate(turned)
        gradient = np.array([slope.sum(), (slope * elapsed).sum()])
        # Expected rather than observed curvature: single groups are too noisy at low SNR.
        matrix = max(-curvature.mean(), 0.0) * sums
        if matrix[0, 0] == 0.0:
            break
        move = np.linalg.solve(matrix + 1e-12 * np.eye(2) * matrix[0, 0], gradient)
        phase += np.clip(move[0], -0.05, 0.05)
        rate += np.clip(move[1], -0.1, 0.1)
    return phase, rate


def _believable(energy, total, coefficients, lines, subcarriers):
    """Whether a fit is a tag: more energy than noise explains, and groups that agree on it."""
    dimensions = subcarriers * len(coefficients)
    explained = energy / (2 * dimensions)
    rest = (total - energy) / ((lines - 2) * dimensions)
    spread = np.sqrt(2 * np.sum(np.abs(coefficients[:, 1:]) ** 2))
    agreement = (energy - np.sum(coefficients[:, 0].real)) / max(spread, 1e-300)
    return explained > _ENERGY_RATIO * rest and agreement > _AGREEMENT
