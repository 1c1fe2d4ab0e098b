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

from ..group_tones import GroupWeights
from ..groups import Array

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
    """Residual (M, K) without what slow changes of the clocks' phases inside a group explain.

    ``slopes`` (n, 2) are derivatives of the waveforms of each tag that wanders, by its clock's
    phase, ``ends`` (2 tags, K) V of these tags; ``white`` (M, E) is the whitened mixing matrix of
    all tags and ``solver`` (E, M) its pseudo-inverse.
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
