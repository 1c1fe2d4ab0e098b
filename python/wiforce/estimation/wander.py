# SPDX-License-Identifier: GPL-3.0-or-later
"""What the wander of a tag's clock inside a group leaves of the tones.

The phase of an oscillator without a crystal is a random walk: a jitter of 0.3 us per period moves
it by 0.6 deg in a group of 36 ms. The residual of a model with a constant offset is then coherent
across the subcarriers, but it does not disturb the phases of the ends, because the clock turns
positive and negative lines in opposite directions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre

from .group_tones import GroupWeights
from .groups import Array

# Polynomials of the phase over a group. The first n terms of a random walk's expansion leave
# 2 / (pi^2 n) of its power (K. Karhunen, 1947): 3 % for six.
_POLYNOMIALS = 6


def without_wander(
    weights: GroupWeights,
    slopes: Sequence[Array],
    ends: Array,
    white: Array,
    solver: Array,
    residual: Array,
) -> Array:
    """Remove from a residual what slow changes of the clocks' phases inside a group explain.

    Parameters
    ----------
    weights : GroupWeights
    slopes : sequence of ndarray, shape (n, 2)
        Derivatives of the waveforms of each tag that wanders, by its clock's phase.
    ends : ndarray of complex, shape (2 tags, K)
        V of these tags.
    white : ndarray of complex, shape (M, E)
        The whitened mixing matrix of all tags.
    solver : ndarray of complex, shape (E, M)
        Its pseudo-inverse.
    residual : ndarray of complex, shape (M, K)
        Whitened.

    Returns
    -------
    ndarray of complex, shape (M, K)

    Examples
    --------
    >>> from gnuradio.wiforce.estimation.group_tones import GroupWeights
    >>> from gnuradio.wiforce.signal.switching import switch_averages_and_slopes
    >>> from gnuradio.wiforce.signal.weights import design_weights
    >>> table = design_weights([1000.0], 625, 57.6e-6)
    >>> weights = GroupWeights(table, np.ones((16, 1)), table.times_s)
    >>> phases = 2 * np.pi * 1000 * table.times_s
    >>> waveforms, slopes = switch_averages_and_slopes(phases, 0.064)
    >>> wander = 0.01 * np.sin(2 * np.pi * table.times_s / 0.036)
    >>> ends = np.array([[1, 1j], [1j, 1]])
    >>> moved, white = weights.mix(slopes * wander[:, None]), weights.mix(waveforms)
    >>> solver = np.linalg.pinv(white)
    >>> residual = (moved - white @ (solver @ moved)) @ ends
    >>> smaller = without_wander(weights, [slopes], ends, white, solver, residual)
    >>> bool(np.linalg.norm(smaller) < 0.03 * np.linalg.norm(residual))
    True
    """
    times = weights.times_s
    reach = max(float(np.abs(times).max()), 1e-12)
    courses = legendre.legvander(times / reach, _POLYNOMIALS - 1).T
    changes = []
    for place, each in enumerate(slopes):
        moved = weights.mix(each * courses[:, :, None])
        changes.append(moved @ ends[2 * place : 2 * place + 2])
    basis = np.concatenate(changes)
    basis -= white @ (solver @ basis)
    rows = basis.reshape(len(basis), -1)
    gram = (rows.conj() @ rows.T).real
    sizes, *_ = np.linalg.lstsq(gram, (rows.conj() @ residual.ravel()).real, rcond=1e-9)
    result: Array = residual - np.tensordot(sizes, basis, 1)
    return result
