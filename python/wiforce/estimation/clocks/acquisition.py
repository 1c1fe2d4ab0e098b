# SPDX-License-Identifier: GPL-3.0-or-later
"""Acquisition of a tag's clock in a block of groups: phase, offset and the delay of clock 2.

Only the nominal frequency is known; phase, offset, channels and levels are not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..groups import Array
from .likelihood import PhaseLikelihood, evaluate, turned_by

# Phases at which J is evaluated: 32 per period of its highest term, 2 x 8 cycles per turn.
_PHASES = 512
# Gain of log-likelihood from which on a delay of clock 2 is accepted (docs/theory.md, Clock).
DELAY_EVIDENCE = 12.0
# A delay of clock 2 beyond which the pulses, pi/2 and pi/4 wide and pi/2 apart, overlap: Ts/16.
OVERLAP = np.pi / 8
# A tag is present when its waveforms explain this much more energy per dimension than the residual
# has, and when the groups agree on the clock by this many standard deviations. Both are measured
# in docs/data/thresholds.csv.
_ENERGY_RATIO = 1.25
_AGREEMENT = 5.0
# Standard deviations by which the rate found may exceed the rates searched.
_RATE_SLACK = 4.0
_NEWTON_STEPS = 6
# Parabolas through the likelihood of clock 2's delay, each an eighth as wide as the one before: the
# last one, 8e-4 rad wide, errs by less than 1e-5 rad.
_PARABOLAS = 3
# A fine search follows a coarse one, of the orders of J that lines up to 16 have, and covers four
# of its steps to both sides.
_COARSE, _AROUND = 32, 4 * 0.5


@dataclass(frozen=True, eq=False, repr=False)
class ClockFit:
    """The clock found over a block of L groups."""

    time_s: float  # at which the phase in rad and its rate above nominal in rad/s hold
    phase: float
    rate: float
    variance: float  # of the phase that a single group gives
    likelihood: PhaseLikelihood  # with the delay of clock 2 found
    coefficients: Array  # (L, D + 1), of J of each group
    energy: float  # J of the block
    found: bool  # a tag was received

    @property
    def clock2_delay(self) -> float:
        """Delay of clock 2's pulses in radians of clock 1; 0 unless the evidence is clear."""
        return self.likelihood.clock2_delay

    @property
    def overlapping(self) -> bool:
        """Whether both switches are on at the same time."""
        return abs(self.clock2_delay) > OVERLAP


def acquire(
    times_s: Array,
    covariances: Array,
    likelihood: PhaseLikelihood,
    nominal_rate: float,
    tolerance_ppm: float,
    subcarriers: int,
) -> ClockFit:
    """Fit phase, offset and the delay of clock 2 to a block of L groups at ``times_s`` (L,).

    Maximises the sum of J(theta_0 + 2 pi f t) (docs/theory.md, Clock) over offsets up to 1.5 times
    the tolerance: a grid, with a Fourier transform over the phase, then Newton steps.
    ``covariances`` (L, lines, lines) are ``likelihood.covariance`` of each; ``nominal_rate`` is 2
    pi fs.
    """
    center = times_s.mean()
    elapsed = times_s - center
    limit = 1.5e-6 * tolerance_ppm * nominal_rate
    coefficients = likelihood.coefficients(covariances)
    rate, phase = _search(coefficients, elapsed, nominal_rate, limit)
    path = (nominal_rate + rate) * elapsed
    block = likelihood.turned(covariances, path).sum(axis=0)
    likelihood, phase = _fit_clock2_delay(likelihood, block)
    coefficients = likelihood.coefficients(covariances)
    phase, rate = _refine(coefficients, elapsed, nominal_rate, phase, rate)
    phases = phase + (nominal_rate + rate) * elapsed
    values, _, curvatures = evaluate(turned_by(coefficients, phases))
    kappa = max(-curvatures.mean(), 1e-9)
    variance = (kappa + subcarriers * likelihood.noise_variance) / kappa**2
    total = np.trace(covariances, axis1=1, axis2=2).real.sum()
    found = _is_tag(values.sum(), total, coefficients, len(likelihood.lines), subcarriers)
    # A clock that jumps within the block appears to run at a rate beyond its tolerance.
    rate_std = np.sqrt(variance / np.sum(elapsed**2))
    found = bool(found and abs(rate) <= limit + _RATE_SLACK * rate_std)
    energy = float(values.sum())
    return ClockFit(center, phase, rate, variance, likelihood, coefficients, energy, found)


def _profile(coefficients: Array) -> Array:
    """J on a circle of phases, by a Fourier transform of its coefficients (..., D+1)."""
    phases = max(_PHASES, 2 * coefficients.shape[-1])
    spectrum = np.zeros((*coefficients.shape[:-1], phases), complex)
    spectrum[..., : coefficients.shape[-1]] = 2 * coefficients
    spectrum[..., 0] /= 2
    return (np.fft.ifft(spectrum) * phases).real


def most_likely(
    coefficients: Array, elapsed: Array, nominal_rate: float, tolerance_ppm: float
) -> tuple[float, float]:
    """Rate above nominal and phase of the highest J, within 1.5 times the tolerance."""
    limit = 1.5e-6 * tolerance_ppm * nominal_rate
    rate = 0.0
    if limit:
        rate, _ = _search(coefficients[:, : _COARSE + 1], elapsed, nominal_rate, limit)
    around = _AROUND / (_COARSE * max(np.ptp(elapsed), 1e-3))
    more, phase = _search(coefficients, elapsed, nominal_rate + rate, around)
    return rate + more, phase


def _search(
    coefficients: Array, elapsed: Array, nominal_rate: float, limit: float
) -> tuple[float, float]:
    """Rate and phase of the highest likelihood on a grid."""
    degree = coefficients.shape[1] - 1
    # The highest term rotates by at most half a radian over the block between two rates.
    step = 0.5 / (degree * max(np.ptp(elapsed), 1e-3))
    rates = np.linspace(-limit, limit, 2 * int(np.ceil(limit / step)) + 1)
    turned = turned_by(coefficients, (nominal_rate + rates[0]) * elapsed)
    onward = turned_by(np.ones_like(coefficients), np.diff(rates[:2]).sum() * elapsed)
    sums = np.empty((len(rates), degree + 1), complex)
    for each in sums:
        np.sum(turned, axis=0, out=each)
        turned *= onward
    profiles = _profile(sums)
    best, peak = np.unravel_index(np.argmax(profiles), profiles.shape)
    return float(rates[best]), float(2 * np.pi * peak / profiles.shape[1])


def _fit_clock2_delay(likelihood: PhaseLikelihood, block: Array) -> tuple[PhaseLikelihood, float]:
    """Likelihood with the delay of clock 2 that fits the block best, and the clock's phase."""

    def best(delay: float) -> tuple[float, float]:
        coefficients = likelihood.coefficients(block, likelihood.projections(delay))
        return _climb(coefficients, float(2 * np.pi * np.argmax(_profile(coefficients)) / _PHASES))

    at_nominal, phase = best(0.0)
    delays, projections = likelihood.delays
    values = _profile(likelihood.coefficients(block, projections)).max(axis=1)
    coarse = delays[np.argmax(values)]
    # A finer search can gain no more than the curvature of line 8 allows over half a step.
    if values.max() * 1.05 - at_nominal < DELAY_EVIDENCE:
        return likelihood, phase
    delay, step = coarse, delays[1] - delays[0]
    for _ in range(_PARABOLAS):
        before, at, after = (best(delay + side * step)[0] for side in (-1, 0, 1))
        if before - 2 * at + after < 0:
            delay += step * np.clip((before - after) / (before - 2 * at + after) / 2, -1, 1)
        step /= 8
    if best(delay)[0] - at_nominal < DELAY_EVIDENCE:
        return likelihood, phase
    phase = best(delay)[1]
    # Clock 2 has half the period of clock 1: its delay is known modulo pi.
    return likelihood.delayed((delay + np.pi / 2) % np.pi - np.pi / 2), phase


def _climb(coefficients: Array, phase: float) -> tuple[float, float]:
    """J and phase at the local maximum next to ``phase``."""
    for _ in range(3):
        _, slope, curvature = evaluate(turned_by(coefficients, phase))
        if curvature >= 0:
            break
        phase -= float(np.clip(slope / curvature, -0.01, 0.01))
    return float(evaluate(turned_by(coefficients, phase))[0]), phase


def _refine(
    coefficients: Array,
    elapsed: Array,
    nominal_rate: float,
    phase: float,
    rate: float,
) -> tuple[float, float]:
    """Newton steps on J over phase and rate, limited to the neighbourhood of the grid's best."""
    sums = np.array([[len(elapsed), elapsed.sum()], [elapsed.sum(), (elapsed**2).sum()]])
    for _ in range(_NEWTON_STEPS):
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


def _is_tag(energy: float, total: float, coefficients: Array, lines: int, subcarriers: int) -> bool:
    """Whether a fit is a tag: more energy than noise explains, and groups that agree on it."""
    dimensions = subcarriers * len(coefficients)
    explained = energy / (2 * dimensions)
    residual = (total - energy) / ((lines - 2) * dimensions)
    spread = np.sqrt(2 * np.sum(np.abs(coefficients[:, 1:]) ** 2))
    agreement = (energy - np.sum(coefficients[:, 0].real)) / max(spread, 1e-300)
    return bool(explained > _ENERGY_RATIO * residual and agreement > _AGREEMENT)
