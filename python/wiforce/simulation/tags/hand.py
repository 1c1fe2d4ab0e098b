# SPDX-License-Identifier: GPL-3.0-or-later
"""The hand that presses, as a second path of the tag."""

from typing import TYPE_CHECKING

import numpy as np

from ...signal.carrier import SPEED_OF_LIGHT_M_S
from ..room.paths import BASE_DELAY, delay_taps

if TYPE_CHECKING:
    from ...scene import Scene
    from ...scene.effects import Hand
    from .tag import SwitchedTag

_SWAY_HZ = 0.7


class NearHand:
    """Gain of the path between tag and reader that goes by way of the hand.

    Parameters
    ----------
    stated : Hand
        The keys of the scene.
    tag : SwitchedTag
        Of the sensor that is pressed.
    rng : numpy.random.Generator
        For the phase of the path.

    Attributes
    ----------
    taps : ndarray of float, shape (n,)
        FIR taps of the path's delay.

    Notes
    -----
    The gain is p exp(-j 4 pi d / lambda). p rises from 0 to 1 while the hand comes, and its
    distance d falls to what it sways by.
    """

    def __init__(
        self, stated: "Hand", tag: "SwitchedTag", scene: "Scene", rng: np.random.Generator
    ) -> None:
        self._stated, self._pressed = stated, tag.pressed
        self._wavelength_mm = 1e3 * SPEED_OF_LIGHT_M_S / scene.radio.center_frequency_hz
        self._start, self._sway = rng.random(2)
        delay = stated.delay_s * scene.radio.sample_rate_hz
        self.taps = delay_taps(BASE_DELAY + delay, 4)

    def gain(self, time_s: np.ndarray) -> np.ndarray:
        """The path's gain relative to that with the hand on the sensor.

        Returns ndarray of complex, shape (n,).

        Parameters
        ----------
        time_s : ndarray of float, shape (n,)
        """
        near = self._pressed.near(time_s, self._stated.reach_s)
        swing = np.sin(2 * np.pi * (_SWAY_HZ * time_s + self._sway))
        distance_mm = self._stated.travel_mm * (1 - near) + self._stated.sway_mm * swing
        cycles = self._start - 2 * distance_mm / self._wavelength_mm
        return near * np.exp(2j * np.pi * cycles)
