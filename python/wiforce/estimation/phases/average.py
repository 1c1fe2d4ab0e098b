# SPDX-License-Identifier: GPL-3.0-or-later
"""Average over subcarriers."""

from __future__ import annotations

from ...wiforce_kernels import subcarrier_average
from ..groups import Groups


class SubcarrierAverage:
    """R_i = sum_k w_k X_i,k with w_k = 1 / sigma_k^2, and the standard deviation of its phase.

    Half of the noise of the R_i lies along the phase, so that std(arg R) = sqrt(var(R) / 2) / |R|.
    The noise of the reference is an error of the untouched phases, which the press filter knows.
    """

    def process(self, groups: Groups) -> Groups:
        """Average groups with ``changes`` and the arrays of separation and reference.

        Returns Groups: with ``ratios`` and ``phase_std_deg``, infinite for an end that was not
        received or has no reference; without ``changes``.
        """
        if not len(groups):
            return groups
        ratios, std = subcarrier_average(
            groups.changes,
            groups.noise,
            groups.gain,
            groups.reference_gain,
            groups.reference_power,
        )
        return groups.having(changes=None, ratios=ratios, phase_std_deg=std)
