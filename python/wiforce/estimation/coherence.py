# SPDX-License-Identifier: GPL-3.0-or-later
"""Interference that has the tag's own profile over the subcarriers, seen in the residual.

The average over K subcarriers reduces independent noise by K. Leakage of movers, another tag, or an
error of the clock is coherent over all of them, and is not reduced at all. What counts for the
phase of an end is the residual's component along that end's channel, c_m = sum_k E_mk conj(V_k) /
sigma_k^2: noise alone leaves sum_k |V_k|^2 / sigma_k^2 of it on every tone.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from .groups import Array
from .least_squares import GroupFit

# Standard deviations above which a group's own ratio, or the median, is more than noise. With
# 22 degrees of freedom, five are exceeded by 1 group in 10 000.
_GROUP_STDS = 5.0
_LASTING_STDS = 4.0
# Groups of the median. Bursts and presses that change disturb fewer than half of them.
_MEDIAN_GROUPS = 48
# Lasting factor above which what is received is not this tag and noise: a second tag on nearly the
# same clock hides most of itself in the ends. Rooms whose disturbances lie beside the lines reach
# 36, such tags 47 and more (SNR 10 dB, tests/rooms).
_DISTURBED = 42.0
# The sandwich estimate has about a third of the degrees of freedom.
_FREEDOM_SHARE = 3.0


class CoherentResidual:
    """Factor by which the variance of each end exceeds that of independent noise.

    Parameters
    ----------
    ends : int
        Ends of all tags, 2S.

    Attributes
    ----------
    disturbed : ndarray of bool, shape (2S,)
        Whether something lasting is received on the lines of each end that is no noise.

    Notes
    -----
    Two estimates of sum_m |S_im|^2 var(c_im), S being the solver: the sandwich estimator HC2 of
    J. MacKinnon and H. White (1985) takes each tone's own power, in the median of the last groups.
    A sudden rise in a single group is judged with equal power on all tones, which fewer groups
    determine.

    Examples
    --------
    >>> tones, rng = np.eye(16)[:, :2].astype(complex), np.random.default_rng(1)
    >>> ends = np.ones((2, 62), complex)
    >>> def fit_of(residual):
    ...     residual[:2] = 0
    ...     return GroupFit(np.arange(2), tones, ends, np.ones(2), residual, tones, tones.T, tones)
    >>> white = rng.standard_normal((16, 62, 2)) @ [0.7071, 0.7071j]
    >>> CoherentResidual(2).update(fit_of(white), np.ones(62))
    array([1., 1.])
    >>> coherent = white + 3 * rng.standard_normal((16, 1))
    >>> bool(np.all(CoherentResidual(2).update(fit_of(coherent), np.ones(62)) > 100))
    True
    """

    def __init__(self, ends: int) -> None:
        self.disturbed = np.zeros(ends, bool)
        self._latest = [deque[float](maxlen=_MEDIAN_GROUPS) for _ in range(ends)]

    def reset(self) -> None:
        """Forget the groups so far, when the clocks were acquired again."""
        self.disturbed[:] = False
        for latest in self._latest:
            latest.clear()

    def update(self, fit: GroupFit, inverse_noise: Array) -> Array:
        """Take the fit of a group.

        Parameters
        ----------
        fit : GroupFit
        inverse_noise : ndarray, shape (K,)
            1 / sigma_k^2.

        Returns
        -------
        ndarray, shape (E,)
            Factor of each end that was fitted, at least 1.
        """
        weighted = fit.ends.conj() * inverse_noise
        energy = (weighted * fit.ends).real.sum(axis=1)
        along = fit.residual @ weighted.T
        along = along / np.sqrt(np.maximum(energy, 1e-300))
        freedom = max(len(along) - len(fit.rows), 1)
        leverage = np.einsum("me,em->m", fit.white, fit.solver).real
        solver = fit.solver.T
        errors = solver * along / np.sqrt(np.maximum(1 - leverage, 0.1))[:, None]
        sandwich = np.sum(np.abs(errors) ** 2, axis=0) / np.sum(np.abs(solver) ** 2, axis=0)
        own = np.sum(along.real**2 + along.imag**2, axis=0) / freedom
        spread = freedom**-0.5
        factors = np.where(own > 1 + _GROUP_STDS * spread, own, 1)
        for i, (row, ratio) in enumerate(zip(fit.rows.tolist(), sandwich.tolist(), strict=True)):
            latest = self._latest[row]
            latest.append(ratio)
            count = len(latest)
            ranked = sorted(latest)
            # The median of a gamma distribution lies below its mean.
            lasting = (ranked[(count - 1) // 2] + ranked[count // 2]) / 2
            lasting /= 1 - _FREEDOM_SHARE / (3 * freedom)
            self.disturbed[row] = lasting > _DISTURBED
            if lasting > 1 + _LASTING_STDS * spread * (_FREEDOM_SHARE / count) ** 0.5:
                factors[i] = max(factors[i], lasting)
        return factors
