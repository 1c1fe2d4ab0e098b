# SPDX-License-Identifier: GPL-3.0-or-later
"""Likelihood of a tag's clock phase, given the tones of a group, and its highest in a block.

With the two ends' channels unknown on every subcarrier, the energy that the tones P of a group
have in the span of the tag's harmonics, J(theta) = sum_k P_k^H Pi(theta) P_k / sigma_k^2, is the
log-likelihood of the clock phase theta up to a constant. The elements of Pi rotate with theta as
exp(j (m - m') theta), so J is a trigonometric polynomial, and its few coefficients contain all
information of a group. Odd and even lines together distinguish theta from theta + pi.
:func:`acquire` finds phase, offset and the delay of clock 2 where only the frequency is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ...errors import InputError
from ...signal.lines import Tone
from ...signal.switching import DUTY, harmonics
from ...signal.weights import ToneTable
from ...wiforce_kernels import clock_likelihood
from ..groups import Array

# Lines above this are not used for the clock. Lines up to 24 would determine the phase of a single
# group 3.8 dB better, but the tracking loop averages it over many groups; readings lose at most
# half a dB to the bound in total (docs/data/accuracy.csv).
_HIGHEST_LINE = 8
# Grid of the search over clock 2's delay: 16 points per period of line 8.
_DELAYS = 64
# Share of a tag's signal that must change at any wrong clock phase; see :func:`phase_margin`.
PHASE_MARGIN = 0.02


class PhaseLikelihood:
    """Computes the coefficients of J(theta) from the tones of a group.

    ``averaging_phase`` is fs Ta in cycles. ``rows``, ``lines`` and ``scale`` (L,) are the tag's own
    tones, their harmonics and factors to unit noise, ``projection`` (L, L) is Pi(0) for the scaled
    tones; ``kernel`` evaluates J at one phase.
    Refused when the tag's own lines do not determine its clock's phase, or its ends.
    """

    def __init__(self, table: ToneTable, tag: int, averaging_phase: float) -> None:
        self.rows, self.lines = own_lines(table.tones, tag)
        self.clock2_delay, self.duty = 0.0, DUTY
        self._averaging_phase = averaging_phase
        # Rows of unit noise; the lines are then close enough to orthogonal.
        self.scale = 1 / np.linalg.norm(table.weights[self.rows], axis=1)
        if phase_margin(self._spectra(0.0), self.lines) < PHASE_MARGIN:
            alone = all(owner == tag for tone in table.tones for owner, *_ in tone.owners)
            rule = (
                "must leave the tag enough lines on which no other line of it falls, nor an alias; "
                if alone
                else "must leave the tag enough lines on which none of another tag falls; "
            )
            shown = ", ".join(map(str, sorted(set(abs(self.lines))))) or "none"
            raise InputError(f"clocks_hz[{tag}]", f"{rule}its own are {shown}")
        self._set_basis()

    def delayed(
        self, clock2_delay: float, duty: tuple[float, float] | None = None
    ) -> PhaseLikelihood:
        """The same likelihood for another delay of clock 2, in rad of clock 1, or other duties."""
        other = copy(self)
        other.clock2_delay, other.duty = clock2_delay, duty or self.duty
        vars(other).pop("delays", None)
        other._set_basis()
        return other

    def _spectra(self, clock2_delay: ArrayLike) -> Array:
        """Fourier coefficients of both ends at the tag's own lines, scaled; shape (..., L, 2)."""
        late = np.exp(-1j * np.multiply.outer(clock2_delay, self.lines))
        coefficients = np.empty((*late.shape, 2), complex)
        coefficients[:] = harmonics(self.lines, self._averaging_phase, self.duty)
        coefficients[..., 1] *= late
        return coefficients * self.scale[:, None]

    def _basis(self, clock2_delay: ArrayLike) -> Array:
        return np.linalg.qr(self._spectra(clock2_delay))[0]

    def projections(self, clock2_delay: ArrayLike) -> Array:
        """Pi(0) for other delays of clock 2; shape (..., L, L)."""
        basis = self._basis(clock2_delay)
        return np.asarray(basis @ basis.conj().swapaxes(-1, -2))

    def _set_basis(self) -> None:
        basis = self._basis(self.clock2_delay)
        self.projection = basis @ basis.conj().T
        # Of dJ/dtheta per subcarrier, from unit noise alone: tr (dPi/dtheta)^2.
        self.noise_variance = float(np.sum(self._steps**2 * np.abs(self.projection) ** 2))
        turns = (-1j * self.lines) ** np.arange(3)[:, None]
        derivatives = (basis.conj().T * turns[:, None, :]).reshape(6, -1) * self.scale
        self.kernel = clock_likelihood(derivatives, self.lines)

    @property
    def degree(self) -> int:
        """Degree D of the trigonometric polynomial J: the largest difference of two lines."""
        return int(self._steps.max())

    @cached_property
    def _steps(self) -> Array:
        return self.lines[:, None] - self.lines[None, :]

    @cached_property
    def _sorted(self) -> tuple[Array, Array, Array]:
        """Elements of (L, L) by difference d >= 0 of lines: indices, starts, whether d exists."""
        steps = self._steps.ravel()
        places = np.argsort(steps, kind="stable")
        places = places[steps[places] >= 0]
        orders = np.arange(self.degree + 1)
        starts = np.searchsorted(steps[places], orders)
        return places, starts, np.isin(orders, steps).astype(float)

    def covariance(self, tones: Array, noise: Array) -> Array:
        """sum_k conj(P_i) P_j / sigma_k^2, (..., L, L), of lines (..., L, K); trace: energy."""
        scaled = tones * self.scale[:, None]
        return (scaled.conj() / noise[..., None, :]) @ scaled.swapaxes(-1, -2)

    def turned(self, covariances: Array, phases: Array) -> Array:
        """Covariances (..., L, L) with the clock set back by ``phases`` (...), in rad."""
        turns = np.exp(1j * np.multiply.outer(phases, self.lines))
        return covariances * turns[..., :, None] * turns[..., None, :].conj()

    @cached_property
    def delays(self) -> tuple[Array, Array]:
        """Delays of clock 2 over its whole period, and Pi(0) for each; (n,) and (n, L, L)."""
        delays = np.pi * (np.arange(_DELAYS) / _DELAYS - 0.5)
        return delays, self.projections(delays)

    def coefficients(self, covariance: Array, projection: Array | None = None) -> Array:
        """q (..., D + 1) of J(theta) = q_0 + 2 Re sum_d q_d exp(j d theta), of a covariance."""
        places, starts, exists = self._sorted
        terms = covariance * (self.projection if projection is None else projection)
        terms = terms.reshape(*terms.shape[:-2], -1)
        return np.add.reduceat(terms[..., places], starts, axis=-1) * exists


def phase_margin(spectra: Array, lines: Array) -> float:
    """Least share of the ends' signals (L, 2) that changes an eighth of a cycle away."""
    norms = np.linalg.norm(spectra, axis=0)
    if len(lines) < 2 or norms.min() <= 1e-9 * norms.max():
        return 0.0
    right, sizes, _ = np.linalg.svd(spectra / norms, full_matrices=False)
    if sizes[1] < 1e-6:
        return 0.0
    shifts = np.arange(1 / 8, 7 / 8 + 1e-9, 1 / 64)
    turns = np.exp(-2j * np.pi * np.outer(shifts, lines))
    overlap = np.einsum("mi,sm,mj->sij", right.conj(), turns, right)
    return max(0.0, float(1 - np.max(np.sum(np.abs(overlap) ** 2, axis=(1, 2))) / 2))


def own_lines(tones: Sequence[Tone], tag: int) -> tuple[Array, Array]:
    """Tones (L,) of a tag alone, not aliased, that track its clock: their rows and harmonics."""
    rows, lines = [], []
    for row, tone in enumerate(tones):
        if len(tone.owners) == 1 and tone.owners[0][0] == tag:
            m = tone.owners[0][1]
            unaliased = np.sign(m) == np.sign(tone.frequency_hz)
            if abs(m) <= _HIGHEST_LINE and unaliased:
                rows.append(row)
                lines.append(m)
    return np.array(rows, int), np.array(lines, int)


def turned_by(coefficients: Array, phases: Array | float) -> Array:
    """Coefficients (..., D + 1) of J(theta + phase) from those of J(theta)."""
    return coefficients * np.exp(1j * np.multiply.outer(phases, _orders(coefficients.shape[-1])[0]))


def evaluate(coefficients: Array) -> tuple[Array, Array, Array]:
    """J, J' and J'' at theta = 0, (...), from coefficients (..., D + 1)."""
    _, value, slope, curvature = _orders(coefficients.shape[-1])
    return coefficients.real @ value, coefficients.imag @ slope, coefficients.real @ curvature


def nearest_maximum(coefficients: Array, phases: Array) -> Array:
    """Phases (...) of the local maxima next to ``phases``, of coefficients (..., D + 1)."""
    for _ in range(4):
        _, slope, curvature = evaluate(turned_by(coefficients, phases))
        step = np.divide(slope, curvature, out=np.zeros(phases.shape), where=curvature < 0)
        phases = phases - np.clip(step, -0.05, 0.05)
    return phases


@lru_cache
def _orders(count: int) -> tuple[Array, Array, Array, Array]:
    """d = 0..D, and the factor of each q_d in J, J' and J''."""
    d = np.arange(count, dtype=float)
    return d, np.where(d > 0, 2.0, 1.0), -2 * d, -2 * d**2


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
        highest = np.array(2 * np.pi * np.argmax(_profile(coefficients)) / _PHASES)
        phase = float(nearest_maximum(coefficients, highest))
        return float(evaluate(turned_by(coefficients, phase))[0]), phase

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
