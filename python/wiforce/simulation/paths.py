# SPDX-License-Identifier: GPL-3.0-or-later
"""Propagation paths as FIR taps: static paths, the path by way of a tag, moving paths."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..signal.waveform import Waveform

if TYPE_CHECKING:
    from ..scene import Scene


# Delay of the first path in samples, which leaves room for the interpolator, and of the last.
BASE_DELAY = 2
LAST_DELAY = 5
STATIC_ECHOES = 8
MOVING_PATHS = 4


def delay_taps(delay: float, count: int) -> np.ndarray:
    """FIR taps of a Kaiser-windowed sinc (beta = 5) that delay a signal by a fraction of a sample.

    (floor(delay) + count / 2 + 1,) with an even ``count`` of non-zero taps, for a delay in samples
    of ``count / 2 - 1`` or more.
    """
    n = np.arange(int(delay) - count // 2 + 1, int(delay) + count // 2 + 1)
    u = (n - delay) / (count / 2)
    window = np.i0(5.0 * np.sqrt(np.maximum(1 - u**2, 0))) / np.i0(5.0)
    taps = np.zeros(n[-1] + 1)
    taps[n] = np.sinc(n - delay) * window
    return taps


def random_taps(rng: np.random.Generator) -> np.ndarray:
    """FIR taps of a path with a random delay, as that of anything that reflects in a room."""
    return delay_taps(rng.uniform(BASE_DELAY + 0.5, LAST_DELAY), 4)


def response(taps: np.ndarray, waveform: Waveform) -> np.ndarray:
    """Frequency response (K,) of FIR taps on the occupied subcarriers."""
    cycles = np.outer(waveform.subcarriers, np.arange(len(taps))) / waveform.symbol_length
    return np.exp(-2j * np.pi * cycles) @ taps


def mean_power(taps: np.ndarray, waveform: Waveform) -> float:
    """Mean of |H|^2 of FIR taps over the occupied subcarriers."""
    return float(np.mean(np.abs(response(taps, waveform)) ** 2))


def static_taps(rng: np.random.Generator, sample_rate_hz: float) -> np.ndarray:
    """A direct path and weaker, later echoes: complex FIR taps, not normalised.

    The echoes' delays are exponentially distributed with 60 ns, the order of delay spreads in
    rooms.
    """
    late = np.r_[0, 0.1 + rng.exponential(60e-9 * sample_rate_hz, STATIC_ECHOES)]
    delays = np.minimum(BASE_DELAY + 0.2 + late, LAST_DELAY)
    levels = np.r_[1.0, 0.2 * rng.rayleigh(0.7, STATIC_ECHOES)]
    taps = np.zeros(LAST_DELAY + 3, complex)
    for delay, level in zip(delays, levels, strict=True):
        path = delay_taps(delay, 4)
        taps[: len(path)] += level * np.exp(2j * np.pi * rng.random()) * path
    return np.trim_zeros(taps, "b")


def tag_taps(
    rng: np.random.Generator, waveform: Waveform, coherence_hz: float | None
) -> np.ndarray:
    """The air path by way of a tag: FIR taps with unit mean power over the subcarriers.

    A single real tap, or with the coherence bandwidth of Rayleigh fading complex taps with an
    exponential profile of rms delay spread 1 / (2 pi coherence_hz).
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
    """A path whose length changes: gain exp(j phi(t)) with an oscillating Doppler shift.

    The rate of phi is f_c + f_d cos(2 pi nu t + alpha) with |f_c| + |f_d| = 0.8 ``doppler_hz`` at
    most and nu slow enough that all but -60 dB of the power lies within +-``doppler_hz``. It
    ``sweeps`` the whole range, like that of a fan's blade or an arm, or oscillates about a
    constant, like that of a walking person.
    """

    def __init__(self, rng: np.random.Generator, doppler_hz: float, sweeps: bool) -> None:
        share = 0.0 if sweeps else rng.uniform(0.3, 0.9)
        reach = 0.8 * doppler_hz * (1.0 if sweeps else rng.uniform(0.4, 1.0))
        self._steady_hz = reach * share * rng.choice([-1, 1])
        self._swing_hz = reach * (1 - share)
        self._swing_rate_hz = min(1.0, doppler_hz / 60) * rng.uniform(0.4, 0.9)
        self._phases = 2 * np.pi * rng.random(2)
        self.taps = random_taps(rng)

    def gain(self, time_s: np.ndarray) -> np.ndarray:
        """exp(j phi) at the given times."""
        swing = 2 * np.pi * self._swing_rate_hz * time_s + self._phases[0]
        index = self._swing_hz / self._swing_rate_hz
        phi = 2 * np.pi * self._steady_hz * time_s + index * np.sin(swing) + self._phases[1]
        return np.exp(1j * phi)


# Standard deviations of a noise component that count as its peak.
NOISE_PEAK = 4.5


class Levels:
    """Converts the levels that a scene states to amplitudes.

    ``amplitude`` is the root of the mean preamble power of the transmit samples.
    """

    def __init__(self, scene: "Scene", amplitude: float) -> None:
        self._waveform, self._sent = scene.waveform(), amplitude
        averaging_cycles = scene.sensors[0].clock_hz * self._waveform.averaging_s
        self._tag_line = float(0.25 * np.sinc(0.25) * np.sinc(averaging_cycles))

    def amplitude(self, level_db: float | None) -> float:
        """Amplitude that is ``level_db`` above |c1[1] G1|; 0 for None."""
        return 0.0 if level_db is None else self._tag_line * 10 ** (level_db / 20)

    def scaled(self, taps: np.ndarray, amplitude: float) -> np.ndarray:
        """Taps scaled to an rms amplitude over the occupied subcarriers."""
        return taps * (amplitude / np.sqrt(mean_power(taps, self._waveform)))

    def noise(self, snr_db: float) -> float:
        """Standard deviation of the noise in a sample, from |c1[1] G1|^2 against that in H."""
        variance_h = self._tag_line**2 / 10 ** (snr_db / 10)
        return self._sent * float(np.sqrt(variance_h / self._waveform.channel_noise_gain))

    def frame_peak(self) -> float:
        """Largest magnitude of the transmitted frame."""
        return self._sent * float(np.abs(self._waveform.frame()).max())

    def peak(self, paths: Sequence[np.ndarray], noise_std: float) -> float:
        """Largest expected magnitude while the scene's own frame is sent over paths with these FIR
        taps.

        ``noise_std`` is that of a sample, of everything that is like noise.
        """
        frame = self._sent * np.tile(self._waveform.frame(), 2)
        longest = max(len(taps) for taps in paths)
        padded = [np.pad(taps, (0, longest - len(taps))) for taps in paths]
        total = np.sum([np.abs(np.convolve(frame, taps)) for taps in padded], axis=0)
        return float(total.max() + NOISE_PEAK * noise_std / np.sqrt(2))
