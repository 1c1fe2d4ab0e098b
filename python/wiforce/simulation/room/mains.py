# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps that modulate what they reflect at twice the mains frequency."""

from typing import TYPE_CHECKING

import numpy as np

from ..random_sources import Seeds
from ..walk import RandomWalk
from .paths import random_taps

if TYPE_CHECKING:
    from ...scene.effects import Lamps

# Harmonics up to here; the gain is interpolated between knots about 10 us apart.
_HIGHEST_HZ = 10_000
# Most that the mains frequency deviates, relative to itself. European grids stay within 0.4 %
# but for emergencies (EN 50160: 1 % in 99.5 % of a year).
_MOST_DEVIATION = 0.01
# Points of the waveform over a period.
_POINTS = 16384


class MainsLamps:
    """A path by way of lamps: a waveform with lines at all harmonics of twice the mains frequency.

    Parameters
    ----------
    stated : Lamps
        The keys of the scene.

    Attributes
    ----------
    taps : ndarray of float, shape (n,)
        FIR taps of the path's delay.
    """

    def __init__(self, stated: "Lamps", seeds: Seeds) -> None:
        rng = seeds.generator()
        self._line_hz = 2 * stated.mains_hz
        harmonics = np.arange(1, max(1, int(_HIGHEST_HZ / self._line_hz)) + 1)
        phases = 2 * np.pi * rng.random(len(harmonics))
        cycles = np.outer(np.arange(_POINTS) / _POINTS, harmonics)
        waveform = np.cos(2 * np.pi * cycles + phases) @ (2 / harmonics)
        self._waveform = np.r_[waveform, waveform[0]] * np.exp(2j * np.pi * rng.random())
        self.taps = random_taps(rng)
        most = _MOST_DEVIATION * stated.mains_hz
        self._wander = RandomWalk(stated.wander_hz_per_sqrt_s, rng, most)

    def gain(self, time_s: np.ndarray) -> np.ndarray:
        """The path's gain; the amplitude of each of the lines +-1 is 1.

        Returns ndarray of complex, shape of ``time_s``.

        Parameters
        ----------
        time_s : ndarray of float, any shape
        """
        cycles = self._line_hz * time_s + 2 * self._wander.integral(time_s)
        return self._waveform[np.rint(cycles % 1 * _POINTS).astype(int)]
