# SPDX-License-Identifier: GPL-3.0-or-later
"""Clock phases from the complete model of a group, for tags whose own lines give biased phases.

``likelihood.py`` assumes that each line of a tag rotates with the clock and is independent of the
others. Lines leak into one another where a group does not hold whole periods of the clock, where
lines alias onto each other, or where another tag has lines nearby. The mixing matrix contains this
leakage. The phases then follow from its residual: a Gauss-Newton step of least squares over the
ends and the clocks of all tags together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...signal.switching import switch_averages
from ...signal.weights import ToneTable
from ..group_tones import power_of
from ..groups import Array
from .likelihood import PhaseLikelihood, evaluate, turned_by

if TYPE_CHECKING:
    from .tracked_tag import TagClock

# Clock phases and channels of the two ends at which the bias is evaluated. A grid of 24 phases
# finds up to twice as much (0.21 instead of 0.09 deg with 600 snapshots, 1 kHz); the threshold in
# clock_search.py holds for this grid.
_PHASES = 0.1 + 2 * np.pi * np.arange(6) / 6
_ENDS = np.array([[1, 0], [0, 1], [1, 1], [1, -1], [1, 1j], [1, -1j]]).T


def likelihood_bias(
    table: ToneTable, likelihood: PhaseLikelihood, clock: TagClock, averaging_s: float
) -> float:
    """Largest bias of the clock phase that maximises a tag's likelihood.

    Returns float: in rad, without noise; the worst over clock phases, offsets within tolerance and
    channels.

    Parameters
    ----------
    table : ToneTable
        Weights of the run.
    likelihood : PhaseLikelihood
        Of the tag.
    clock : TagClock
        Nominal clock of the tag.
    averaging_s : float
        Ta of the waveform, in s.
    """
    largest = 0.0
    for offset in (-1, 0, 1):
        rate = 2 * np.pi * clock.clock_hz * (1 + offset * 1e-6 * clock.tolerance_ppm)
        for phase in _PHASES:
            waveforms = switch_averages(phase + rate * table.times_s, rate * averaging_s / 2)
            tones = table.weights @ waveforms @ _ENDS
            for column in tones.T:
                own = column[likelihood.rows, None]
                covariance = likelihood.covariance(own, np.ones(1))
                found = _top(likelihood.coefficients(covariance), phase)
                largest = max(largest, abs(found - phase))
    return largest


def _top(coefficients: Array, phase: float) -> float:
    """Phase of the local maximum next to ``phase``."""
    for _ in range(4):
        _, slope, curvature = evaluate(turned_by(coefficients, phase))
        if curvature >= 0:
            break
        phase -= float(np.clip(slope / curvature, -0.05, 0.05))
    return phase


@dataclass(slots=True)
class PhaseExpansion:
    """A least-squares fit, expanded to second order in the phases of the clocks.

    Attributes
    ----------
    ends : ndarray of complex, shape (..., 2S, K)
        Solution V of any number of groups.
    power : ndarray, shape (..., K)
        Sum of the squared residual over the tones.
    gradient : ndarray, shape (..., S, K)
        Derivatives of ``-power`` by the phases.
    gram : ndarray of complex, shape (..., 2S, 2S)
        Products of the derivatives of the mixing matrix that a change of the ends cannot
        compensate.
    excess : ndarray, shape (..., S)
        Variance of the log-likelihood's gradient that noise in the ends adds.

    Notes
    -----
    With t = (1 - M M^+) dM/dtheta V, the derivative of the model that a change of the ends cannot
    compensate, the residual of a group is r - t dtheta. The gradient of the log-likelihood is
    2 Re sum_k t^H r / sigma_k^2 and the information 2 Re sum_k t^H t / sigma_k^2 (variable
    projection, G. Golub and V. Pereyra, 1973).
    """

    ends: Array
    power: Array
    gradient: Array
    gram: Array
    excess: Array

    @staticmethod
    def of(
        mixing: Array, solver: Array, slopes: Array, ends: Array, residual: Array
    ) -> PhaseExpansion:
        """Expand a fit.

        Parameters
        ----------
        mixing : ndarray of complex, shape (..., M, 2S)
            The S tags' waveforms as whitened tones.
        solver : ndarray of complex, shape (..., 2S, M)
            Its pseudo-inverse.
        slopes : ndarray of complex, shape (..., M, 2S)
            Derivatives of ``mixing`` by each tag's phase.
        ends : ndarray of complex, shape (..., 2S, K)
        residual : ndarray of complex, shape (..., M, K)
            Whitened tones minus ``mixing @ ends``.
        """
        projected: Array = slopes - mixing @ (solver @ slopes)
        adjoint = projected.conj().swapaxes(-1, -2)
        gram = adjoint @ projected
        spread = solver @ solver.conj().swapaxes(-1, -2)
        subcarriers = ends.shape[-1]
        noise = 2 * subcarriers * (gram * spread.swapaxes(-1, -2)).real
        of_tags = _by_tag(noise).sum(axis=(-3, -1))
        gradient = 2 * (ends.conj() * (adjoint @ residual)).real
        return PhaseExpansion(
            ends,
            power_of(residual).sum(axis=-2),
            gradient[..., ::2, :] + gradient[..., 1::2, :],
            gram,
            of_tags.diagonal(axis1=-2, axis2=-1),
        )

    def __getitem__(self, rows: slice) -> PhaseExpansion:
        """The expansion of some of the groups."""
        return PhaseExpansion(
            self.ends[rows],
            self.power[rows],
            self.gradient[rows],
            self.gram[rows],
            self.excess[rows],
        )

    def information(self, inverse_noise: Array) -> tuple[Array, Array, Array]:
        """Gradient and Fisher information of the clock phases, at the phases assumed.

        Parameters
        ----------
        inverse_noise : ndarray, shape (K,)
            1 / sigma_k^2.

        Returns
        -------
        gradient : ndarray, shape (..., S)
            Of the log-likelihood, maximised over the ends.
        information : ndarray, shape (..., S, S)
            Its expected negative curvature without the contribution of the noise in ``ends``.
        excess : ndarray, shape (..., S)
            That contribution: the variance of the gradient from noise alone.
        """
        powers = (self.ends * inverse_noise) @ self.ends.conj().swapaxes(-1, -2)
        information = _by_tag(2 * (self.gram * powers.swapaxes(-1, -2)).real).sum(axis=(-3, -1))
        own = np.arange(information.shape[-1])
        information[..., own, own] -= self.excess
        return self.gradient @ inverse_noise, information, self.excess

    def power_at(self, shifts: Array) -> Array:
        """Sum of the squared residual at other phases of the clocks.

        Returns ndarray, shape (..., K).

        Parameters
        ----------
        shifts : ndarray, shape (..., S)
            By how much these phases exceed those of the expansion, in rad.
        """
        turned = self.ends * np.repeat(shifts, 2, axis=-1)[..., None]
        curvature = (turned.conj() * (self.gram @ turned)).real.sum(axis=-2)
        slope = (shifts[..., None, :] @ self.gradient)[..., 0, :]
        # The expansion of a large step may be below what noise leaves at the optimum.
        return np.maximum(self.power - slope + curvature, 0.0)


def _by_tag(matrices: Array) -> Array:
    """Split rows and columns of matrices over ends: (..., S, 2, S, 2)."""
    *groups, ends, _ = matrices.shape
    return matrices.reshape(*groups, ends // 2, 2, ends // 2, 2)


def phase_errors(gradient: Array, information: Array, excess: Array) -> tuple[Array, Array]:
    """Gauss-Newton step of each clock phase, and its variance.

    Parameters
    ----------
    gradient, information, excess : ndarray
        See :meth:`PhaseExpansion.information`; the three may be sums over groups.

    Returns
    -------
    errors : ndarray, shape (..., S)
        In rad, to be added to the phases assumed.
    variances : ndarray, shape (..., S)
        Infinite where the group does not determine a phase.
    """
    scale = np.sqrt(np.maximum(information.diagonal(axis1=-2, axis2=-1), 0.0))
    known = (scale > 0).all(axis=-1, keepdims=True)
    scale = np.where(known, scale, 1.0)
    scales = scale[..., :, None] * scale[..., None, :]
    if gradient.shape[-1] == 1:
        inverse = 1 / scales
    else:
        inverse = np.linalg.pinv(information / scales, rcond=1e-9, hermitian=True) / scales
    errors = (inverse @ gradient[..., None])[..., 0]
    # The diagonal of inverse @ (information + diag(excess)) @ inverse.
    spread = (inverse @ information) * inverse + inverse**2 * excess[..., None, :]
    variances = spread.sum(axis=-1)
    return np.where(known, errors, 0.0), np.where(known, variances, np.inf)
