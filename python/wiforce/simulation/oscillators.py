# SPDX-License-Identifier: GPL-3.0-or-later
"""A reader whose transmitter and receiver have oscillators of their own."""

import numpy as np


class FreeOscillators:
    """What the receiver's oscillator, against the transmitter's, turns every sample by.

    A constant carrier offset, and a phase that walks at random: its variance grows by
    2 pi ``linewidth_hz`` per second, the phase noise of an oscillator with a Lorentzian line.

    Parameters
    ----------
    offset_hz, linewidth_hz : float
    rng : numpy.random.Generator
    ramp : Ramp
        Knots of the walk.
    sample_rate_hz : float
    """

    def __init__(self, offset_hz, linewidth_hz, rng, ramp, sample_rate_hz):
        self._turns_per_sample = offset_hz / sample_rate_hz
        self._step_std = np.sqrt(2 * np.pi * linewidth_hz)
        self._rng, self._ramp = rng, ramp
        self._last = None  # time and phase of the last knot drawn

    def turn(self, first_sample, samples):
        """Turn the samples in place."""
        count = len(samples)
        if self._turns_per_sample:
            turns = first_sample * self._turns_per_sample % 1
            turns = turns + np.arange(count) * self._turns_per_sample
            samples *= np.exp(2j * np.pi * turns).astype(np.complex64)
        if self._step_std:
            walk = self._walk(self._ramp.knots(first_sample, count))
            samples *= self._ramp.draw(np.exp(1j * walk), first_sample, count)

    def _walk(self, times):
        """Phase at knots, going on from where the last call ended; its last two may come again."""
        if self._last is None or times[0] > self._last[0][-1]:
            self._last = times[:1], np.zeros(1)
        known_times, known = self._last
        new = times[times > known_times[-1]]
        steps = np.diff(new, prepend=known_times[-1])
        drawn = self._step_std * np.sqrt(steps) * self._rng.standard_normal(len(new))
        all_times = np.r_[known_times, new]
        walk = np.r_[known, known[-1] + np.cumsum(drawn)]
        self._last = all_times[-2:], walk[-2:]
        return walk[np.searchsorted(all_times, times)]
