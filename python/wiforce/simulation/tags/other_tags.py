# SPDX-License-Identifier: GPL-3.0-or-later
"""Tags that the scene does not list among its sensors, such as those of a neighbour."""

from typing import TYPE_CHECKING

import numpy as np

from ..room.paths import BASE_DELAY, delay_taps
from .switching import SWITCHES, SwitchingClock, switch_states

if TYPE_CHECKING:
    from ...scene import Scene
    from ...scene.effects import OtherTag


class UnlistedTag:
    """A tag whose sensor nobody presses: both ends reflect with constant phases.

    Parameters
    ----------
    stated : OtherTag
        The keys of the scene.
    rng : numpy.random.Generator
        For the clock's start and the phases.

    Attributes
    ----------
    taps : ndarray of float, shape (n,)
        FIR taps of the path's delay.
    clock : SwitchingClock
    """

    def __init__(self, stated: "OtherTag", scene: "Scene", rng: np.random.Generator) -> None:
        self._rate = scene.radio.sample_rate_hz
        offset = stated.clock_offset_ppm
        self.clock = SwitchingClock(stated.clock_hz, offset, 0.0, abs(offset), rng.random())
        self._ends = np.exp(2j * np.pi * rng.random(2)).astype(np.complex64)
        delay = BASE_DELAY + stated.delay_s * self._rate
        self.taps = np.r_[np.zeros(BASE_DELAY), 1.0]
        if stated.delay_s:
            self.taps = delay_taps(delay, 4)

    def reflection(self, first: int, count: int) -> np.ndarray:
        """Reflection during some samples.

        Returns ndarray of complex64, shape (count,): r / rho.

        Parameters
        ----------
        first, count : int
            First sample and their number.
        """
        states = switch_states(self.clock, SWITCHES["pulses"], 0.0, first, count, self._rate)
        return self._ends[0] * states[0] + self._ends[1] * states[1]
