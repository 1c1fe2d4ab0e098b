# SPDX-License-Identifier: GPL-3.0-or-later
"""Clock phases from the complete model of a group, for tags whose own lines give biased phases.

``likelihood.py`` assumes that each line of a tag rotates with the clock and is independent of the
others. Lines leak into one another where a group does not hold whole periods of the clock, where
lines alias onto each other, or where another tag has lines nearby. The mixing matrix contains this
leakage. The phases then follow from its residual: a Gauss-Newton step of least squares over the
ends and the clocks of all tags together.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..signal.switching import switch_averages
from ..signal.weights import ToneTable
from .groups import Array
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

    Returns
    -------
    float
        In rad, without noise; the worst over clock phases, offsets within tolerance and channels.

    Examples
    --------
    Groups of 600 snapshots do not hold whole periods of 1 kHz, groups of 625 do:

    >>> from gnuradio.wiforce.estimation.tracked_tag import TagClock
    >>> from gnuradio.wiforce.signal.weights import design_weights
    >>> for length in (625, 600):
    ...     table = design_weights([1000.0], length, 57.6e-6)
    ...     likelihood = PhaseLikelihood(table, 0, 0.02048)
    ...     bias = likelihood_bias(table, likelihood, TagClock(1000.0), 20.48e-6)
    ...     print(f"{np.degrees(bias):.2f} deg")
    0.03 deg
    0.09 deg
    """
    largest = 0.0
    for offset in (-1, 0, 1):
        rate = 2 * np.pi * clock.clock_hz * (1 + offset * 1e-6 * clock.tolerance_ppm)
        for phase in _PHASES:
            waveforms = switch_averages(phase + rate * table.times_s, rate * averaging_s / 2)
            tones = table.weights @ waveforms @ _ENDS
            for column in tones.T:
                covariance = likelihood.covariance(column[:, None], np.ones(1))
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


def phase_information(
    mixing: Array,
    solver: Array,
    slopes: Array,
    ends: Array,
    residual: Array,
    inverse_noise: Array,
) -> tuple[Array, Array, Array]:
    """Gradient and Fisher information of the clock phases in a group, at the phases assumed.

    Parameters
    ----------
    mixing : ndarray of complex, shape (M, 2S)
        The S tags' waveforms as whitened tones.
    solver : ndarray of complex, shape (2S, M)
        Its pseudo-inverse.
    slopes : ndarray of complex, shape (M, 2S)
        Derivatives of ``mixing`` by each tag's phase.
    ends : ndarray of complex, shape (2S, K)
        Solution V of the group.
    residual : ndarray of complex, shape (M, K)
        Whitened tones minus ``mixing @ ends``.
    inverse_noise : ndarray, shape (K,)
        1 / sigma_k^2.

    Returns
    -------
    gradient : ndarray, shape (S,)
        Of the log-likelihood, maximised over the ends.
    information : ndarray, shape (S, S)
        Its expected negative curvature without the contribution of the noise in ``ends``.
    excess : ndarray, shape (S,)
        That contribution: the variance of the gradient from noise alone.

    Notes
    -----
    With t = (1 - M M^+) dM/dtheta V, the derivative of the model that a change of the ends cannot
    compensate, the gradient is 2 Re sum_k t^H r / sigma_k^2 and the information
    2 Re sum_k t^H t / sigma_k^2 (variable projection, G. Golub and V. Pereyra, 1973).

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> mixing, slopes = rng.standard_normal((2, 16, 2)) + 1j * rng.standard_normal((2, 16, 2))
    >>> ends, error_rad = rng.standard_normal((2, 62)), 1e-3
    >>> tones = (mixing + error_rad * slopes) @ ends
    >>> solver = np.linalg.pinv(mixing)
    >>> fitted = solver @ tones
    >>> residual = tones - mixing @ fitted
    >>> found = phase_information(mixing, solver, slopes, fitted, residual, np.full(62, 1e8))
    >>> bool(np.isclose(phase_errors(*found)[0][0], error_rad, rtol=0.02))
    True
    """
    tags = len(ends) // 2
    # The part of a rotation that a change of the ends cannot compensate.
    projected: Array = slopes - mixing @ (solver @ slopes)
    turns = [projected[:, 2 * t : 2 * t + 2] @ ends[2 * t : 2 * t + 2] for t in range(tags)]
    weighted = [turn * inverse_noise for turn in turns]
    gradient = np.array([2 * np.vdot(turn, residual).real for turn in weighted])
    information = np.array([[2 * np.vdot(a, b).real for b in turns] for a in weighted])
    spread = solver @ solver.conj().T
    gram: Array = projected.conj().T @ projected
    excess = np.array(
        [
            2 * ends.shape[1] * np.sum(gram[own, own] * spread[own, own].T).real
            for own in (slice(2 * t, 2 * t + 2) for t in range(tags))
        ]
    )
    return gradient, information - np.diag(excess), excess


def phase_errors(gradient: Array, information: Array, excess: Array) -> tuple[Array, Array]:
    """Gauss-Newton step of each clock phase, and its variance.

    Parameters
    ----------
    gradient, information, excess : ndarray
        See :func:`phase_information`; the three may be sums over groups.

    Returns
    -------
    errors : ndarray, shape (S,)
        In rad, to be added to the phases assumed.
    variances : ndarray, shape (S,)
        Infinite where the group does not determine a phase.

    Examples
    --------
    >>> errors, variances = phase_errors(np.array([2.0]), np.array([[100.0]]), np.array([0.0]))
    >>> errors.tolist(), variances.tolist()
    ([0.02], [0.01])
    """
    if len(gradient) == 1:
        known, excess_of_one = float(information[0, 0]), float(excess[0])
        if not known > 0:
            return np.zeros(1), np.full(1, np.inf)
        return gradient / known, np.array([(known + excess_of_one) / known**2])
    scale = np.sqrt(np.maximum(np.diag(information), 0.0))
    if not np.all(scale > 0):
        return np.zeros(len(scale)), np.full(len(scale), np.inf)
    correlation = information / np.outer(scale, scale)
    inverse = np.linalg.pinv(correlation, rcond=1e-9, hermitian=True) / np.outer(scale, scale)
    covariance = inverse @ (information + np.diag(excess)) @ inverse
    return inverse @ gradient, np.diag(covariance)
