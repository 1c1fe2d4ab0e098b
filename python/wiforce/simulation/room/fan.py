# SPDX-License-Identifier: GPL-3.0-or-later
"""A fan: blades that come and go once per revolution."""

from typing import TYPE_CHECKING

import numpy as np

from ..random_sources import Seeds
from .paths import random_taps

if TYPE_CHECKING:
    from ...scene.effects import Fan

BLADES = 3
# Part of a blade's amplitude that depends on how it faces the antennas.
_FLASH = 0.7
# Points of a revolution in which the mean power is computed.
_POINTS = 4096


class FanBlades:
    """The path by way of a fan's blades.

    Parameters
    ----------
    stated : Fan
        The keys of the scene.

    Attributes
    ----------
    taps : ndarray of float, shape (n,)
        FIR taps of the path's delay.

    Notes
    -----
    Each of three blades at the angle a has the gain (1 + 0.7 cos 2a) exp(j b cos a): it reflects
    best while it faces the antennas, and its distance oscillates. With b = f_d / f_r, for the
    revolutions per second f_r, its Doppler frequency reaches f_d. Blades are alike, so that only
    multiples of 3 f_r remain in their sum, the lines at multiples of the blade frequency.
    """

    def __init__(self, stated: "Fan", seeds: Seeds) -> None:
        rng = seeds.generator()
        self._turns_hz = stated.blade_hz / BLADES
        self._index = stated.highest_hz / self._turns_hz
        self._start = rng.random()
        self.taps = random_taps(rng)
        period = self._sum(np.arange(_POINTS) / _POINTS)
        self._scale = np.exp(2j * np.pi * rng.random()) / np.sqrt(np.mean(np.abs(period) ** 2))

    def gain(self, time_s: np.ndarray) -> np.ndarray:
        """The path's gain, of unit mean power.

        Returns ndarray of complex, shape of ``time_s``.

        Parameters
        ----------
        time_s : ndarray of float, any shape
        """
        return self._scale * self._sum((self._turns_hz * time_s + self._start) % 1)

    def _sum(self, turns: np.ndarray) -> np.ndarray:
        angles = 2 * np.pi * np.add.outer(np.arange(BLADES) / BLADES, turns)
        facing = 1 + _FLASH * np.cos(2 * angles)
        return (facing * np.exp(1j * self._index * np.cos(angles))).sum(axis=0)
