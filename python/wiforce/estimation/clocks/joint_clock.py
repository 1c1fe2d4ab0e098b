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

from ...signal.switching import switch_averages
from ...signal.weights import ToneTable
from ..groups import Array
from .likelihood import PhaseLikelihood, evaluate

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
    """Largest bias in rad, without noise, of the clock phase that maximises a tag's likelihood.

    The worst over clock phases, offsets within tolerance and channels.
    """
    largest = 0.0
    for offset in (-1, 0, 1):
        rate = 2 * np.pi * clock.clock_hz * (1 + offset * 1e-6 * clock.tolerance_ppm)
        courses = _PHASES[:, None] + rate * table.times_s
        waveforms = switch_averages(courses, rate * averaging_s / 2)
        tones = table.weights[likelihood.rows] @ waveforms @ _ENDS
        own = tones.swapaxes(1, 2)[..., None]
        coefficients = likelihood.coefficients(likelihood.covariance(own, np.ones(1)))
        found = _tops(coefficients, np.repeat(_PHASES[:, None], _ENDS.shape[1], axis=1))
        largest = max(largest, float(np.abs(found - _PHASES[:, None]).max()))
    return largest


def _tops(coefficients: Array, phases: Array) -> Array:
    """Phases (...) of the local maxima next to ``phases``, of coefficients (..., D + 1)."""
    for _ in range(4):
        turns = np.exp(1j * phases[..., None] * np.arange(coefficients.shape[-1]))
        _, slope, curvature = evaluate(coefficients * turns)
        step = np.divide(slope, curvature, out=np.zeros(phases.shape), where=curvature < 0)
        phases = phases - np.clip(step, -0.05, 0.05)
    return phases
