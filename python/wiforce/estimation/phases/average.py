# SPDX-License-Identifier: GPL-3.0-or-later
"""Average over subcarriers."""

from __future__ import annotations

import numpy as np

from ..groups import Array, Groups
from .reference import subcarrier_weights


class SubcarrierAverage:
    """R_i = sum_k w_k X_i,k with w_k = 1 / sigma_k^2, and the standard deviation of its phase.

    Notes
    -----
    Half of the noise of the R_i (:func:`ratio_variance`) lies along the phase, so that
    std(arg R) = sqrt(var(R) / 2) / |R|. The noise of the reference is an error of the untouched
    phases, which the press filter knows (docs/press.md).
    """

    def process(self, groups: Groups) -> Groups:
        """Average a batch.

        Returns Groups: with ``ratios`` and ``phase_std_deg``, infinite for an end that was not
        received or has no reference; without ``changes``.

        Parameters
        ----------
        groups : Groups
            With ``changes`` and the arrays of separation and reference.
        """
        if not len(groups):
            return groups
        ratios = (groups.changes @ subcarrier_weights(groups.noise)[:, :, None])[:, :, 0]
        std = phase_std_deg(ratios, ratio_variance(groups))
        return groups.having(changes=None, ratios=ratios, phase_std_deg=std)


def phase_std_deg(ratios: Array, variance: Array) -> Array:
    """Standard deviation of the phase of ratios with complex noise; infinite for R = 0."""
    magnitude = np.abs(ratios)
    std = np.full(magnitude.shape, np.inf)
    np.divide(np.sqrt(variance / 2), magnitude, out=std, where=magnitude > 0)
    return np.degrees(std)


def ratio_variance(groups: Groups) -> Array:
    """Variance of the complex R_i by the noise of the group; shape (G, 2S).

    g (1 + g_ref K / E) / E with E = sum_k |V_ref|^2 / sigma_k^2, where g and g_ref are the
    variances of V and V_ref over that of H; infinite without a reference.
    """
    energy = groups.reference_power * (1 / groups.noise).sum(axis=1)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        rise = 1 + groups.reference_gain * groups.noise.shape[1] / energy
        return np.where(energy > 0, groups.gain * rise / energy, np.inf)
