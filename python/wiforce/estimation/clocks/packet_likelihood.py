# SPDX-License-Identifier: GPL-3.0-or-later
"""Likelihood of a clock in a group of snapshots with times of their own.

They are mixed by other weights in every group, and each of them finds a switch either open or
closed. Their likelihood changes in steps, of which no derivative tells where it is largest: it is
evaluated at all phases.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..groups import Array

if TYPE_CHECKING:
    from ..group_tones import GroupFit, GroupTones
    from .tracked_tag import TrackedTag

# Phases at which the complete model is evaluated, 0.35 deg apart: edges of switches lie at every
# degree for the 80 packets of a group, and eight groups share a clock.
_EVERY_PHASE = 1024


def complete_likelihood(
    tag: TrackedTag, groups: GroupTones, fit: GroupFit | None, inverse_noise: Array
) -> Array:
    """Coefficients (G, D + 1) of J(theta) by all tones of a group and by its own weights, as of
    :meth:`.PhaseLikelihood.coefficients`; ``fit`` has what other tags may add to the tones.
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
