# SPDX-License-Identifier: GPL-3.0-or-later
"""A person who walks, stops, and walks again."""

from typing import TYPE_CHECKING

import numpy as np

from ...signal.carrier import SPEED_OF_LIGHT_M_S
from ..random_sources import Seeds
from .paths import BASE_DELAY, LAST_DELAY, delay_taps

if TYPE_CHECKING:
    from ...scene.effects import Walker

# Two steps, in metres of way.
STRIDE_M = 1.4
# Power of trunk, two legs and two arms, and how far each swings about the trunk: a foot stands
# still at one end of its swing and is about three times as fast as the trunk at the other
# (P. van Dorp, F. Groen, "Human walking estimation with radar", IEE Proc. 150 (2003)).
LIMBS = ((0.7, 0.0, 0.0), (0.1, 2.0, 0.0), (0.1, 2.0, 0.5), (0.05, 1.0, 0.5), (0.05, 1.0, 0.0))
_FASTEST_LIMB = 3.0
# Time in which a walk begins and ends, at most; the speed follows a raised cosine.
_START_S = 0.4
# Breathing while standing: 5 mm at 0.25 Hz.
_BREATHING_M, _BREATHING_HZ = 5e-3, 0.25
# Walks that are drawn at once.
_DRAWN = 64


class Person:
    """Trunk, legs and arms of a person, as paths with a common way.

    Parameters
    ----------
    stated : Walker
        The keys of the scene.
    center_frequency_hz : float
        Carrier, which gives the length of a stride in wavelengths.

    Attributes
    ----------
    limbs : list of Limb

    Notes
    -----
    Walks and pauses alternate. The direction of each walk is opposite to that of the one before,
    and its speed is 0.6 to 1 of the highest. Limbs swing by the way that was walked, so that they
    stop with the person; only breathing remains.
    """

    def __init__(self, stated: "Walker", center_frequency_hz: float, seeds: Seeds) -> None:
        rng = seeds.generator()
        self._rng = seeds.generator(0)
        self._walk_s, self._trunk_hz = stated.walk_s, stated.highest_hz / _FASTEST_LIMB
        self._pause_s = stated.walk_s * (1 - stated.walking_share) / stated.walking_share
        self._wavelength_m = SPEED_OF_LIGHT_M_S / center_frequency_hz
        self._breath = rng.random()
        delay = rng.uniform(BASE_DELAY + 0.5, LAST_DELAY - 0.1)
        # Start, end, Doppler frequency of the trunk, and way in cycles before each walk.
        self._walks = np.zeros((1, 4))
        stride = 2 * STRIDE_M / self._wavelength_m  # in cycles of the carrier, two ways
        self.limbs = [
            Limb(
                self, np.sqrt(power), swing, stride, phase, delay + 0.1 * rng.random(), rng.random()
            )
            for power, swing, phase in LIMBS
        ]

    def way(self, time_s: np.ndarray) -> np.ndarray:
        """Way of the trunk towards the antennas.

        Returns ndarray of float, shape of ``time_s``: in cycles of the carrier, counted both ways.

        Parameters
        ----------
        time_s : ndarray of float, any shape
            Not negative.
        """
        self._extend(float(np.max(time_s, initial=0.0)))
        latest = np.searchsorted(self._walks[:, 0], time_s, "right") - 1
        start, end, hertz, before = np.moveaxis(self._walks[latest], -1, 0)
        ramp = np.minimum(_START_S, (end - start) / 2)
        inside = np.clip(time_s - start, 0, end - start)
        rising, falling = (_ramped(x, ramp) for x in (inside, end - start - inside))
        # Rising at the start, full speed, falling at the end: what is left to walk is symmetric.
        full = np.clip(inside - ramp, 0, end - start - 2 * ramp)
        walked = rising + full + ramp / 2 - falling
        return before + hertz * walked

    def breath(self, time_s: np.ndarray) -> np.ndarray:
        """Movement of the chest, in cycles of the carrier, counted both ways."""
        swing = np.sin(2 * np.pi * (_BREATHING_HZ * time_s + self._breath))
        return 2 * _BREATHING_M / self._wavelength_m * swing

    def walking(self, time_s: np.ndarray) -> np.ndarray:
        """Whether the person walks, at given times; shape of ``time_s``."""
        self._extend(float(np.max(time_s, initial=0.0)))
        walk = self._walks[np.searchsorted(self._walks[:, 0], time_s, "right") - 1]
        return time_s < walk[..., 1]

    def _extend(self, until_s: float) -> None:
        """Draw walks until one begins after ``until_s``."""
        while self._walks[-1, 0] <= until_s:
            durations = self._walk_s * self._rng.uniform(0.5, 1.5, _DRAWN)
            pauses = self._pause_s * self._rng.uniform(0.5, 1.5, _DRAWN)
            starts = self._walks[-1, 1] + np.cumsum(pauses + np.r_[0, durations[:-1]])
            hertz = self._trunk_hz * self._rng.uniform(0.6, 1.0, _DRAWN)
            hertz[::2] *= -1
            lengths = hertz * (durations - np.minimum(_START_S, durations / 2))
            start, end, last_hertz, before = self._walks[-1]
            last = last_hertz * (end - start - min(_START_S, (end - start) / 2))
            ways = before + last + np.cumsum(np.r_[0, lengths[:-1]])
            new = np.column_stack([starts, starts + durations, hertz, ways])
            self._walks = np.concatenate([self._walks, new])


class Limb:
    """A part of a person that reflects, and that swings about the trunk.

    Parameters
    ----------
    swing : float
        Highest speed about the trunk relative to that of the trunk.
    stride_cycles : float
        Length of two steps, both ways, in cycles of the carrier.
    phase : float
        Of the swing, in strides.
    delay : float
        Of the path, in samples.
    start : float
        Phase of the path at time 0, in cycles.

    Attributes
    ----------
    amplitude : float
    taps : ndarray of float, shape (n,)
        FIR taps of the path's delay.
    """

    def __init__(
        self,
        person: Person,
        amplitude: float,
        swing: float,
        stride_cycles: float,
        phase: float,
        delay: float,
        start: float,
    ) -> None:
        self._person, self.amplitude = person, float(amplitude)
        self._swing, self._stride, self._phase = swing, stride_cycles, phase
        self._start = start
        self.taps = delay_taps(delay, 4)

    def gain(self, time_s: np.ndarray) -> np.ndarray:
        """The path's gain, of magnitude 1.

        Returns ndarray of complex, shape (n,).

        Parameters
        ----------
        time_s : ndarray of float, shape (n,)
        """
        way = self._person.way(time_s)
        strides = way / self._stride + self._phase
        swing = self._swing * self._stride / (2 * np.pi) * np.sin(2 * np.pi * strides)
        cycles = way + swing + self._person.breath(time_s) + self._start
        return np.exp(2j * np.pi * (cycles % 1))


def _ramped(elapsed: np.ndarray, ramp: np.ndarray) -> np.ndarray:
    """Integral of a raised-cosine rise from 0 to 1 over ``ramp``, up to its end."""
    x = np.clip(elapsed / np.maximum(ramp, 1e-12), 0, 1)
    return ramp / 2 * (x - np.sin(np.pi * x) / np.pi)
