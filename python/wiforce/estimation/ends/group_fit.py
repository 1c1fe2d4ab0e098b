# SPDX-License-Identifier: GPL-3.0-or-later
"""The least-squares fit of the tags' ends to the tones of groups."""

from __future__ import annotations

from ...wiforce_kernels import end_fit
from ..groups import Array


class GroupFit(end_fit):
    """Whitened tones = white @ ends + residual, for the E ends of the locked tags in G groups.

    ``rows`` (E,) are these ends among those of all tags, ``mixed`` (G, M, 2E) the tags' waveforms
    as whitened tones, and behind them their derivatives by the phases of the clocks. ``ends`` (G,
    E, K) are V, ``gain`` (G, E) its variance over that of H, ``residual`` (G, M, K) is whitened,
    without what the wander of a clock explains where ``solve`` made the fit; ``white`` (G, M, E) is
    the mixing matrix W [s1, s2, ...], whitened, and ``solver`` (G, E, M) its pseudo-inverse.
    """

    def __init__(self, rows: Array, mixed: Array, tones: Array) -> None:
        super().__init__(mixed, tones)
        self.rows = rows

    def noise(self) -> Array:
        """Mean square of the residual per degree of freedom; shape (G, K)."""
        noise: Array = self.power() / self.freedom
        return noise
