# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmitter and receiver with separate oscillators: carrier offset and phase noise."""

import numpy as np

from ..streams import Ramp


class FreeOscillators:
    """Phase of the transmitter's oscillator relative to the receiver's.

    A constant carrier offset, and a random walk of the phase.

    Parameters
    ----------
    offset_hz, linewidth_hz : float
        Carrier offset, and width of the oscillator's Lorentzian line, in Hz.
    ramp : Ramp
        Knots of the walk.

    Notes
    -----
    The variance of a Lorentzian oscillator's phase grows by 2 pi ``linewidth_hz`` per second
    (A. Demir, A. Mehrotra, J. Roychowdhury, "Phase noise in oscillators", IEEE Trans. Circuits
    and Systems I 47 (2000)).
    """

    def __init__(
        self,
        offset_hz: float,
        linewidth_hz: float,
        rng: np.random.Generator,
        ramp: Ramp,
        sample_rate_hz: float,
    ) -> None:
        self._cycles_per_sample = offset_hz / sample_rate_hz
        self._step_std = np.sqrt(2 * np.pi * linewidth_hz)
        self._rng, self._ramp = rng, ramp
        # Times and phases of the last knots of the walk.
        self._last: tuple[np.ndarray, np.ndarray] | None = None

    def rotate(self, first_sample: int, samples: np.ndarray) -> None:
        """Rotate samples in place.

        Parameters
        ----------
        first_sample : int
            Index of the first sample.
        samples : ndarray of complex64, shape (n,)
        """
        count = len(samples)
        if self._cycles_per_sample:
            start = first_sample * self._cycles_per_sample % 1
            cycles = start + np.arange(count) * self._cycles_per_sample
            samples *= np.exp(2j * np.pi * cycles).astype(np.complex64)
        if self._step_std:
            walk = self._walk(self._ramp.knots(first_sample, count))
            samples *= self._ramp.interpolate(np.exp(1j * walk), first_sample, count)

    def _walk(self, times: np.ndarray) -> np.ndarray:
        """Phase at knots, continued from the previous call, whose last two knots may recur."""
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
