# SPDX-License-Identifier: GPL-3.0-or-later
"""Likelihood of a tag's clock phase, given the tones of a group.

With the two ends' channels unknown on every subcarrier, the energy that the tones P of a group
have in the span of the tag's harmonics, J(theta) = sum_k P_k^H Pi(theta) P_k / sigma_k^2, is the
log-likelihood of the clock phase theta up to a constant. The elements of Pi rotate with theta as
exp(j (m - m') theta), so J is a trigonometric polynomial, and its few coefficients contain all
information of a group. Odd and even lines together distinguish theta from theta + pi.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ...errors import InputError
from ...signal.lines import Tone
from ...signal.switching import DUTY, harmonics
from ...signal.weights import ToneTable
from ...wiforce_kernels import clock_likelihood
from ..groups import Array

if TYPE_CHECKING:
    from ..group_tones import GroupFit, GroupTones
    from .tracked_tag import TrackedTag

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

    ``averaging_phase`` is fs Ta in cycles, ``clock2_delay`` in radians of clock 1. ``rows``,
    ``lines`` and ``scale`` (L,) are the tag's own tones, their harmonics and factors to unit noise,
    ``projection`` (L, L) is Pi(0) for the scaled tones; ``kernel`` evaluates J at one phase.
    Refused when the tag's own lines do not determine its clock's phase, or its ends.
    """

    def __init__(
        self, table: ToneTable, tag: int, averaging_phase: float, clock2_delay: float = 0.0
    ) -> None:
        self.rows, self.lines = own_lines(table.tones, tag)
        self.clock2_delay, self.duty = clock2_delay, DUTY
        self._averaging_phase = averaging_phase
        # Rows of unit noise; the lines are then close enough to orthogonal.
        self.scale = 1 / np.linalg.norm(table.weights[self.rows], axis=1)
        if phase_margin(self._spectra(clock2_delay), self.lines) < PHASE_MARGIN:
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
        other = object.__new__(PhaseLikelihood)
        other.rows, other.lines, other.scale = self.rows, self.lines, self.scale
        other._averaging_phase = self._averaging_phase
        other.clock2_delay = clock2_delay
        other.duty = self.duty if duty is None else duty
        other._steps, other._sorted = self._steps, self._sorted
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
    def noise_variance(self) -> float:
        """Variance of dJ/dtheta per subcarrier from unit noise alone: tr (dPi/dtheta)^2."""
        return float(np.sum(self._steps**2 * np.abs(self.projection) ** 2))

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


@lru_cache
def _orders(count: int) -> tuple[Array, Array, Array, Array]:
    """d = 0..D, and the factor of each q_d in J, J' and J''."""
    d = np.arange(count, dtype=float)
    return d, np.where(d > 0, 2.0, 1.0), -2 * d, -2 * d**2


# Phases at which the complete model is evaluated, 0.35 deg apart: edges of switches lie at every
# degree for the 80 packets of a group, and eight groups share a clock.
_EVERY_PHASE = 1024


def complete_likelihood(
    tag: TrackedTag, groups: GroupTones, fit: GroupFit | None, inverse_noise: Array
) -> Array:
    """Coefficients (G, D + 1) of J(theta) of groups with times of their own, beside other tags.

    It changes in steps where switches open or close, so that it is evaluated at all phases.
    """
    clocks = np.empty((_EVERY_PHASE, 1, 3))
    clocks[:, 0, 0] = 2 * np.pi * np.arange(_EVERY_PHASE) / _EVERY_PHASE
    clocks[:, 0, 1:] = tag.rate, tag.rate * tag.averaging_s / 2
    found = np.empty((len(groups), _EVERY_PHASE))
    for row, weights in enumerate(groups.weights):
        switched = weights.switched(clocks, [(tag.clock2_delay, *tag.duty)])
        first, second = np.ascontiguousarray(switched.T[:2])
        tones = groups.white[row] * np.sqrt(inverse_noise)
        if fit is not None and len(fit.rows) > 2:
            others = np.linalg.qr(fit.white[row][:, ~np.isin(fit.rows, tag.rows)])[0]
            tones = tones - others @ (others.T @ tones)
            first, second = (each - others @ (others.T @ each) for each in (first, second))
        parts = np.hstack([tones.real, tones.imag])
        # Energy in the span of two columns, by their Gram matrix and its inverse.
        one, both, two = _gram(first, second)
        of_one, of_both, of_two = _gram(parts.T @ first, parts.T @ second)
        size = np.maximum(one * two - both**2, 1e-9 * one * two)
        found[row] = (two * of_one - 2 * both * of_both + one * of_two) / np.maximum(size, 1e-300)
    return np.asarray(np.fft.rfft(found, axis=1)[:, :-1] / _EVERY_PHASE)


def _gram(first: Array, second: Array) -> tuple[Array, ...]:
    """Inner products of the columns of two matrices: of each of the first, both, and the second."""
    pairs = (first, first), (first, second), (second, second)
    return tuple(np.einsum("ij,ij->j", *pair) for pair in pairs)
