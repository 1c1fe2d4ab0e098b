# SPDX-License-Identifier: GPL-3.0-or-later
"""The likelihood of a tag's clock phase, given a group's tones and nothing else.

With the two ends' channels unknown on every subcarrier, the energy that the tones P of a group
have in the span of the tag's harmonics, J(theta) = sum_k P_k^H Pi(theta) P_k / sigma_k^2, is the
log-likelihood of the clock phase theta up to a constant. Pi turns with theta as
exp(j (m - m') theta), so J is a trigonometric polynomial, and a group is summed up in its few
coefficients. Odd and even lines together also tell theta from theta + pi.
"""

from functools import cached_property, lru_cache

import numpy as np

from ..errors import InputError
from ..signal.switching import harmonics

# Lines beyond this carry too little energy to help the clock.
_HIGHEST_LINE = 8
_DELAYS = 64
# Smallest part of a tag's signal by which a clock phase must be told from any other.
PHASE_MARGIN = 0.02


class PhaseLikelihood:
    """Turns the tones of a group into the coefficients of J(theta).

    Parameters
    ----------
    table : ToneTable
    tag : int
        Index of the tag among the table's.
    averaging_phase : float
        fs Ta.
    clock2_delay : float
        Radians of clock 1 by which clock 2's pulses come late.

    Attributes
    ----------
    rows : ndarray of int, shape (L,)
        Tones that this tag alone owns and that serve its clock.
    lines : ndarray of int, shape (L,)
        Harmonic number of each.
    projection : ndarray of complex, shape (L, L)
        Pi(0), for tones scaled to unit noise.

    Raises
    ------
    InputError
        When the tag's own lines are too few to tell its clock's phase, or its ends.
    """

    def __init__(self, table, tag, averaging_phase, clock2_delay=0.0):
        self.rows, self.lines = _own_lines(table.tones, tag)
        self.clock2_delay = clock2_delay
        self._averaging_phase = averaging_phase
        # Rows of unit noise; the lines are then close enough to orthogonal.
        self.scale = 1 / np.linalg.norm(table.weights[self.rows], axis=1)
        if phase_margin(self._spectra(clock2_delay), self.lines) < PHASE_MARGIN:
            rule = "must leave each tag enough lines that no other tag's fall on; its own are "
            shown = ", ".join(map(str, sorted(set(abs(self.lines))))) or "none"
            raise InputError(f"clock_hz of tag {tag + 1}", rule + shown)
        self._set_basis()

    def delayed(self, clock2_delay):
        """The same for another delay of clock 2."""
        other = object.__new__(PhaseLikelihood)
        other.rows, other.lines, other.scale = self.rows, self.lines, self.scale
        other._averaging_phase = self._averaging_phase
        other.clock2_delay = clock2_delay
        other._set_basis()
        return other

    def _spectra(self, clock2_delay):
        """What the tag's own lines hold of each end; shape (L, 2)."""
        coefficients = harmonics(self.lines, self._averaging_phase).astype(complex)
        coefficients[:, 1] *= np.exp(-1j * self.lines * clock2_delay)
        return coefficients * self.scale[:, None]

    def _basis(self, clock2_delay):
        return np.linalg.qr(self._spectra(clock2_delay))[0]

    def _set_basis(self):
        basis = self._basis(self.clock2_delay)
        self.projection = basis @ basis.conj().T
        # u = B^H D^-1 P of the lines P, and its derivatives by theta, D = diag(exp(j m theta)).
        turns = (-1j * self.lines) ** np.arange(3)[:, None]
        self._derivatives = (basis.conj().T * turns[:, None, :]).reshape(6, -1) * self.scale

    def at(self, phase, tones, inverse_noise):
        """J, J' and J'' at one phase, without its coefficients.

        Parameters
        ----------
        phase : float
        tones : ndarray of complex, shape (M, K)
        inverse_noise : ndarray, shape (K,)

        Returns
        -------
        float, float, float
            Of J = sum_k |u_k|^2 / sigma_k^2 with u = B^H D^-1 P, where Pi(0) = B B^H and
            D = diag(exp(j m theta)).
        """
        turned = self._derivatives * np.exp(-1j * phase * self.lines)
        u, slope, curvature = (turned @ tones[self.rows]).reshape(3, 2, -1)
        weighted = u.conj() * inverse_noise
        return (
            float(np.vdot(weighted.conj(), u).real),
            2 * float(np.vdot(weighted.conj(), slope).real),
            2
            * float(
                np.vdot(weighted.conj(), curvature).real
                + np.vdot(slope, slope * inverse_noise).real
            ),
        )

    @property
    def degree(self):
        return int(self._steps.max())

    @cached_property
    def _steps(self):
        return self.lines[:, None] - self.lines[None, :]

    @cached_property
    def noise_variance(self):
        """Variance of dJ/dtheta per subcarrier from unit noise alone: tr (dPi/dtheta)^2."""
        return float(np.sum(self._steps**2 * np.abs(self.projection) ** 2))

    @cached_property
    def _sorted(self):
        """Places of an (L, L) matrix by difference d >= 0 of their lines.

        With where each d begins among them, and whether any pair of lines has it.
        """
        steps = self._steps.ravel()
        places = np.argsort(steps, kind="stable")
        places = places[steps[places] >= 0]
        orders = np.arange(self.degree + 1)
        starts = np.searchsorted(steps[places], orders)
        return places, starts, np.isin(orders, steps).astype(float)

    def covariance(self, tones, noise):
        """sum_k conj(P_i) P_j / sigma_k^2 of the tag's scaled lines.

        Parameters
        ----------
        tones : ndarray of complex, shape (M, K)
        noise : ndarray, shape (K,)
            Noise variance of a tone of unit noise gain on each subcarrier.

        Returns
        -------
        ndarray of complex, shape (L, L)
            Its trace is the energy of the lines, in units of the noise.
        """
        scaled = tones[self.rows] * self.scale[:, None]
        return (scaled.conj() / noise) @ scaled.T

    def turned(self, covariances, phases):
        """Covariances (..., L, L) as they would be with the clock set back by ``phases`` (...)."""
        turns = np.exp(1j * np.multiply.outer(phases, self.lines))
        return covariances * turns[..., :, None] * turns[..., None, :].conj()

    @cached_property
    def delays(self):
        """Delays of clock 2 all over its period, and Pi(0) for each; (n,) and (n, L, L)."""
        delays = np.pi * (np.arange(_DELAYS) / _DELAYS - 0.5)
        return delays, np.array([b @ b.conj().T for b in map(self._basis, delays)])

    def coefficients(self, covariance, projection=None):
        """Coefficients q of J(theta) = q_0 + 2 Re sum_d q_d exp(j d theta).

        Parameters
        ----------
        covariance : ndarray of complex, shape (..., L, L)
        projection : ndarray of complex, shape (..., L, L), optional
            Instead of the likelihood's own.

        Returns
        -------
        ndarray of complex, shape (..., degree + 1)
        """
        places, starts, exists = self._sorted
        terms = covariance * (self.projection if projection is None else projection)
        terms = terms.reshape(*terms.shape[:-2], -1)
        return np.add.reduceat(terms[..., places], starts, axis=-1) * exists


def phase_margin(spectra, lines):
    """How well a clock's phase is told from any that is an eighth of a cycle or more away.

    Parameters
    ----------
    spectra : ndarray of complex, shape (L, 2)
        The two ends' spectra, at the right phase.
    lines : ndarray of int, shape (L,)
        Harmonic number of each row.

    Returns
    -------
    float
        Part of the ends' signals, on average over them, that changes at any such phase; 0 when the
        ends could be swapped, or cannot be told apart.
    """
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


def _own_lines(tones, tag):
    rows, lines = [], []
    for row, tone in enumerate(tones):
        if len(tone.owners) == 1 and tone.owners[0][0] == tag:
            m = tone.owners[0][1]
            unaliased = np.sign(m) == np.sign(tone.frequency_hz)
            if abs(m) <= _HIGHEST_LINE and unaliased:
                rows.append(row)
                lines.append(m)
    return np.array(rows, int), np.array(lines, int)


def turned_by(coefficients, phases):
    """Coefficients (..., D+1) of J(theta + phase), phases (...)."""
    return coefficients * np.exp(1j * np.multiply.outer(phases, _orders(coefficients.shape[-1])[0]))


def evaluate(coefficients):
    """J, J' and J'' at theta = 0 of coefficients (..., D+1); each of shape (...)."""
    _, value, slope, curvature = _orders(coefficients.shape[-1])
    return coefficients.real @ value, coefficients.imag @ slope, coefficients.real @ curvature


@lru_cache
def _orders(count):
    """d = 0..D, and how each q_d counts in J, J' and J''."""
    d = np.arange(count, dtype=float)
    return d, np.where(d > 0, 2.0, 1.0), -2 * d, -2 * d**2
