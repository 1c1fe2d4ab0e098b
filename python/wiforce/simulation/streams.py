# SPDX-License-Identifier: GPL-3.0-or-later
"""Operations on a stream of samples: FIR filters, and slow values interpolated to every sample."""

import numpy as np

# Knots of slow values. Between knots this far apart, a gain with a Doppler shift of 250 Hz
# deviates from linear by 3e-5 of itself.
_KNOT_SPACING_S = 10e-6


class Fir:
    """Direct-form FIR filter for a stream of complex64 that carries its own history.

    Parameters
    ----------
    taps : ndarray of float or complex, shape (n,)
        Real taps take half the operations.

    Attributes
    ----------
    memory : int
        Samples of history that the filter needs, n - 1.
    """

    def __init__(self, taps: np.ndarray) -> None:
        self._complex = np.iscomplexobj(taps)
        kind = np.complex64 if self._complex else np.float32
        self._taps = [(delay, kind(tap)) for delay, tap in enumerate(taps) if tap != 0]
        self.memory = len(taps) - 1

    def apply(self, extended: np.ndarray, count: int, out: np.ndarray, scratch: np.ndarray) -> None:
        """Filter the newest samples.

        Parameters
        ----------
        extended : ndarray of complex64, shape (memory + count,) or more
            History, then the new samples.
        count : int
            Number of new samples.
        out : ndarray of complex64, shape (count,)
            Result.
        scratch : ndarray of complex64, shape (count,)
            Overwritten.
        """
        start, size = len(extended) - count, 1
        if not self._complex:  # both components alike, at half the work
            extended, out, scratch = (x.view(np.float32) for x in (extended, out, scratch))
            size = 2
        if not self._taps:
            out[:] = 0
        for i, (delay, tap) in enumerate(self._taps):
            first = size * (start - delay)
            part = extended[first : first + size * count]
            np.multiply(part, tap, out=scratch if i else out)
            if i:
                np.add(out, scratch, out=out)


class Ramp:
    """Linear interpolation of slow values between knots on the sample grid."""

    def __init__(self, sample_rate_hz: float) -> None:
        self._step = max(16, 2 ** round(np.log2(_KNOT_SPACING_S * sample_rate_hz)))
        self._weights = (np.arange(self._step) / self._step).astype(np.float32)
        self._rate = sample_rate_hz

    def knots(self, first_sample: int, count: int) -> np.ndarray:
        """Times of the knots around some samples.

        Returns ndarray of float, shape (n,): in s since sample 0, from the last knot at or before
        the first sample to the first knot at or after the last.
        """
        first = first_sample // self._step
        last = -(-(first_sample + count) // self._step)
        return np.arange(first, last + 1) * (self._step / self._rate)

    def interpolate(self, values: np.ndarray, first_sample: int, count: int) -> np.ndarray:
        """Interpolate to the samples.

        Returns ndarray of complex64, shape (count,).

        Parameters
        ----------
        values : ndarray of complex, shape (n,)
            At the :meth:`knots` of the same samples.
        """
        values = np.asarray(values, np.complex64)
        steps = np.diff(values)
        lines = steps[:, None] * self._weights
        lines += values[:-1, None]
        skip = first_sample % self._step
        return lines.reshape(-1)[skip : skip + count]
