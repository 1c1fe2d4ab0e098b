# SPDX-License-Identifier: GPL-3.0-or-later
"""The least-squares fit of the tags' ends to the tones of groups."""

from __future__ import annotations

from ...wiforce_kernels import end_fit
from ..groups import Array


class GroupFit(end_fit):
    """Whitened tones = white @ ends + residual, for the E ends of the locked tags in G groups.

    Parameters
    ----------
    rows : ndarray of int, shape (E,)
        The ends that are fitted, among those of all tags.
    mixed : ndarray of complex, shape (G, M, 2E)
        The tags' waveforms as whitened tones, and behind them their derivatives by the phases of
        the tags' clocks.
    tones : ndarray of complex, shape (G, M, K)
        Whitened.

    Attributes
    ----------
    rows
        As given.
    ends : ndarray of complex, shape (G, E, K)
        V.
    gain : ndarray, shape (G, E)
        Variance of V over that of H.
    residual : ndarray of complex, shape (G, M, K)
        Whitened; without what the wander of a clock explains where ``solve`` made the fit.
    white : ndarray of complex, shape (G, M, E)
        The mixing matrix W [s1, s2, ...], whitened.
    solver : ndarray of complex, shape (G, E, M)
        Its pseudo-inverse.
    """

    def __init__(self, rows: Array, mixed: Array, tones: Array) -> None:
        super().__init__(mixed, tones)
        self.rows = rows

    def noise(self) -> Array:
        """Mean square of the residual per degree of freedom; shape (G, K)."""
        noise: Array = self.power() / self.freedom
        return noise
