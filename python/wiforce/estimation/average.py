# SPDX-License-Identifier: GPL-3.0-or-later
"""Average over subcarriers."""

from __future__ import annotations

import numpy as np

from .groups import Array, Groups
from .reference import subcarrier_weights


class SubcarrierAverage:
    """R_i = sum_k w_k X_i,k with w_k = 1 / sigma_k^2, and the standard deviation of its phase.

    Notes
    -----
    Half of the noise of the R_i (:func:`ratio_variance`) lies along the phase, so that
    std(arg R) = sqrt(var(R) / 2) / |R|. The noise of the reference is an error of the untouched
    phases, which the press filter knows (docs/press.md).

    Examples
    --------
    One group of a sensor whose ends have turned by 30 and -10 deg, on four subcarriers:

    >>> from gnuradio.wiforce.estimation.groups import Groups
    >>> turn = np.exp(1j * np.radians([30.0, -10.0]))
    >>> group = Groups(
    ...     [13], changes=np.tile(turn[None, :, None], 4), noise=np.full((1, 4), 1e-4),
    ...     gain=np.full((1, 2), 0.01), reference_power=np.ones((1, 2)),
    ...     reference_gain=np.full((1, 2), 0.001), in_reference=np.zeros((1, 2), bool))
    >>> averaged = SubcarrierAverage().process(group)
    >>> np.degrees(np.angle(averaged.ratios)).round(6).tolist()
    [[30.0, -10.0]]
    >>> averaged.phase_std_deg.round(4).tolist()
    [[0.0203, 0.0203]]
    """

    def process(self, groups: Groups) -> Groups:
        """Average a batch.

        Parameters
        ----------
        groups : Groups
            With ``changes`` and the arrays of separation and reference.

        Returns
        -------
        Groups
            With ``ratios`` and ``phase_std_deg``, infinite for an end that was not received or has
            no reference; without ``changes``.
        """
        if not len(groups):
            return groups
        ratios = (groups.changes @ subcarrier_weights(groups.noise)[:, :, None])[:, :, 0]
        std = phase_std_deg(ratios, ratio_variance(groups))
        return groups.having(changes=None, ratios=ratios, phase_std_deg=std)


def phase_std_deg(ratios: Array, variance: Array) -> Array:
    """Standard deviation of the phase of ratios with complex noise.

    Parameters
    ----------
    ratios : ndarray of complex
        R.
    variance : ndarray, of the same shape
        Of R.

    Returns
    -------
    ndarray, of the same shape
        In degrees; infinite where R is 0.

    Examples
    --------
    >>> phase_std_deg(np.array([1j, 0.0]), np.full(2, 2e-4)).round(3).tolist()
    [0.573, inf]
    """
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
