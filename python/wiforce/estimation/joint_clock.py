# SPDX-License-Identifier: GPL-3.0-or-later
"""Clock phases from the whole model of a group, for tags whose own lines alone mislead.

`likelihood.py` takes every line of a tag for a number that turns with the clock. That holds as
far as a group resolves the lines: where it does not hold whole periods of the clock, lines alias
onto each other, or another tag's lie near, they leak into one another. The mixing matrix knows all
that, so there the phases follow from what it leaves of a group: a Gauss-Newton step of least
squares over the ends and the clocks of all tags together.
"""

import numpy as np

from ..signal.switching import switch_averages
from .likelihood import evaluate, turned_by

_PHASES = 0.1 + 2 * np.pi * np.arange(6) / 6
# Channels of the two ends that are tried.
_ENDS = np.array([[1, 0], [0, 1], [1, 1], [1, -1], [1, 1j], [1, -1j]]).T


def likelihood_bias(table, likelihood, clock, averaging_s):
    """By how much the top of a tag's likelihood may lie beside its clock's phase, without noise.

    Parameters
    ----------
    table : ToneTable
    likelihood : PhaseLikelihood
    clock : tracked_tag.TagClock
    averaging_s : float

    Returns
    -------
    float
        Radians; the worst over clock phases, offsets within tolerance and channels.
    """
    worst = 0.0
    for offset in (-1, 0, 1):
        rate = 2 * np.pi * clock.clock_hz * (1 + offset * 1e-6 * clock.tolerance_ppm)
        for phase in _PHASES:
            waveforms = switch_averages(phase + rate * table.times_s, rate * averaging_s / 2)
            tones = table.weights @ waveforms @ _ENDS
            for column in tones.T:
                covariance = likelihood.covariance(column[:, None], np.ones(1))
                found = _top(likelihood.coefficients(covariance), phase)
                worst = max(worst, abs(found - phase))
    return worst


def _top(coefficients, phase):
    """The top of the hill on whose side ``phase`` lies."""
    for _ in range(4):
        _, slope, curvature = evaluate(turned_by(coefficients, phase))
        if curvature >= 0:
            break
        phase = phase - np.clip(slope / curvature, -0.05, 0.05)
    return phase


def phase_information(mixing, solver, slopes, ends, left, inverse_noise):
    """What a group tells of the clocks' phases about those that it was solved with.

    Parameters
    ----------
    mixing : ndarray of complex, shape (M, 2S)
        The tags' waveforms as whitened tones.
    solver : ndarray of complex, shape (2S, M)
        Its pseudo-inverse.
    slopes : ndarray of complex, shape (M, 2S)
        Derivatives of ``mixing`` by each tag's phase.
    ends : ndarray of complex, shape (2S, K)
    left : ndarray of complex, shape (M, K)
        Whitened tones less ``mixing @ ends``.
    inverse_noise : ndarray, shape (K,)

    Returns
    -------
    gradient : ndarray, shape (S,)
        Of the log-likelihood, the ends fitted anew.
    information : ndarray, shape (S, S)
        Its expected negative curvature, free of what noise in ``ends`` adds.
    excess : ndarray, shape (S,)
        That addition: variance of the gradient from noise alone.
    """
    tags = len(ends) // 2
    # What of a turn the ends cannot make up for.
    unexplained = slopes - mixing @ (solver @ slopes)
    turns = [unexplained[:, 2 * t : 2 * t + 2] @ ends[2 * t : 2 * t + 2] for t in range(tags)]
    gradient = np.array([2 * np.sum((t.conj() * left).real @ inverse_noise) for t in turns])
    information = np.array(
        [[2 * np.sum((a.conj() * b).real @ inverse_noise) for b in turns] for a in turns]
    )
    spread = solver @ solver.conj().T
    gram = unexplained.conj().T @ unexplained
    excess = np.array(
        [
            2 * ends.shape[1] * np.sum(gram[own, own] * spread[own, own].T).real
            for own in (slice(2 * t, 2 * t + 2) for t in range(tags))
        ]
    )
    return gradient, information - np.diag(excess), excess


def phase_errors(gradient, information, excess):
    """Gauss-Newton step of each phase and its variance; (S,) each, nothing known where infinite."""
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
