# SPDX-License-Identifier: GPL-3.0-or-later
"""Propagation paths: delays between samples, what stands still, what moves."""

import numpy as np

BASE_DELAY = 2  # samples by which the first path is late: room for the interpolator
LAST_DELAY = 5  # and the last
STATIC_ECHOES = 8
MOVING_PATHS = 4
RAMP_S = 10e-6  # gains are exact at knots this far apart, and linear in between


def delay_taps(delay, count):
    """FIR taps that delay a signal by a fraction of a sample.

    Parameters
    ----------
    delay : float
        In samples, ``count / 2 - 1`` or more.
    count : int
        Non-zero taps, even: a Kaiser-windowed sinc about the delay.

    Returns
    -------
    ndarray of float, shape (floor(delay) + count / 2 + 1,)
    """
    n = np.arange(int(delay) - count // 2 + 1, int(delay) + count // 2 + 1)
    u = (n - delay) / (count / 2)
    window = np.i0(5.0 * np.sqrt(np.maximum(1 - u**2, 0))) / np.i0(5.0)
    taps = np.zeros(n[-1] + 1)
    taps[n] = np.sinc(n - delay) * window
    return taps


def response(taps, waveform):
    """Frequency response of FIR taps on the occupied subcarriers; complex, shape (K,)."""
    turns = np.outer(waveform.subcarriers, np.arange(len(taps))) / 64
    return np.exp(-2j * np.pi * turns) @ taps


def mean_power(taps, waveform):
    """Mean of |H|^2 over the occupied subcarriers."""
    return float(np.mean(np.abs(response(taps, waveform)) ** 2))


def static_taps(rng, sample_rate_hz):
    """A direct path and weaker, later echoes (exponential profile of 60 ns), unscaled; complex."""
    late = np.r_[0, 0.1 + rng.exponential(60e-9 * sample_rate_hz, STATIC_ECHOES)]
    delays = np.minimum(BASE_DELAY + 0.2 + late, LAST_DELAY)
    levels = np.r_[1.0, 0.2 * rng.rayleigh(0.7, STATIC_ECHOES)]
    taps = np.zeros(LAST_DELAY + 3, complex)
    for delay, level in zip(delays, levels, strict=True):
        path = delay_taps(delay, 4)
        taps[: len(path)] += level * np.exp(2j * np.pi * rng.random()) * path
    return np.trim_zeros(taps, "b")


def tag_taps(rng, waveform, coherence_hz):
    """The air path by way of a tag, unit mean power over the subcarriers.

    One path (a single real tap), or with ``coherence_hz`` Rayleigh fading over the band: an
    exponential profile of rms delay spread 1 / (2 pi coherence_hz), complex taps.
    """
    if coherence_hz is None:
        taps = np.r_[np.zeros(BASE_DELAY), 1.0]
    else:
        spread = waveform.sample_rate_hz / (2 * np.pi * coherence_hz)
        count = int(np.clip(np.ceil(6 * spread), 1, 32))
        profile = np.exp(-np.arange(count) / max(spread, 1e-3) / 2)
        fading = rng.standard_normal(count) + 1j * rng.standard_normal(count)
        taps = np.r_[np.zeros(BASE_DELAY), profile * fading]
    return taps / np.sqrt(mean_power(taps, waveform))


class MovingPath:
    """A path whose length changes: gain exp(j phi(t)), its Doppler swinging to and fro.

    The rate of phi is f_c + f_d cos(2 pi nu t + alpha) with |f_c| + |f_d| = 0.8 ``doppler_hz`` at
    most and nu slow enough that all but -60 dB of the power lies within +-``doppler_hz``. The
    first path sweeps the whole range like a fan's blade or an arm; the others, like a walking
    person, pass with a steady rate and swing about it.
    """

    def __init__(self, rng, doppler_hz, sweeps):
        share = 0.0 if sweeps else rng.uniform(0.3, 0.9)
        reach = 0.8 * doppler_hz * (1.0 if sweeps else rng.uniform(0.4, 1.0))
        self._steady_hz = reach * share * rng.choice([-1, 1])
        self._swing_hz = reach * (1 - share)
        self._swing_rate_hz = min(1.0, doppler_hz / 60) * rng.uniform(0.4, 0.9)
        self._phases = 2 * np.pi * rng.random(2)
        self.taps = delay_taps(rng.uniform(BASE_DELAY + 0.5, LAST_DELAY), 4)

    def gain(self, time_s):
        """exp(j phi) at the given times; complex, shape as given."""
        swing = 2 * np.pi * self._swing_rate_hz * time_s + self._phases[0]
        index = self._swing_hz / self._swing_rate_hz
        phi = 2 * np.pi * self._steady_hz * time_s + index * np.sin(swing) + self._phases[1]
        return np.exp(1j * phi)


class Fir:
    """Direct-form FIR filter of a history-extended stream of complex64; taps may be real."""

    def __init__(self, taps):
        self._complex = np.iscomplexobj(taps)
        kind = np.complex64 if self._complex else np.float32
        self._taps = [(delay, kind(tap)) for delay, tap in enumerate(taps) if tap != 0]
        self.memory = len(taps) - 1

    def apply(self, extended, count, out, scratch):
        """Filter the last ``count`` samples of ``extended`` into ``out``; ``scratch`` is lost."""
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
    """Values known at knots on the sample grid, drawn linearly in between."""

    def __init__(self, sample_rate_hz):
        self._step = max(16, 2 ** round(np.log2(RAMP_S * sample_rate_hz)))
        self._weights = (np.arange(self._step) / self._step).astype(np.float32)
        self._rate = sample_rate_hz

    def knots(self, first_sample, count):
        """Times (s) of the knots about the samples; the first at or before them."""
        first = first_sample // self._step
        last = -(-(first_sample + count) // self._step)
        return np.arange(first, last + 1) * (self._step / self._rate)

    def draw(self, values, first_sample, count):
        """The samples between the knots' values; complex64, shape (count,)."""
        values = np.asarray(values, np.complex64)
        steps = np.diff(values)
        lines = steps[:, None] * self._weights
        lines += values[:-1, None]
        skip = first_sample % self._step
        return lines.reshape(-1)[skip : skip + count]
