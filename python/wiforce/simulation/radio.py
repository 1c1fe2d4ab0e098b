# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmitter and receiver of a simulated scene: analogue parts, oscillators, converter."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .random_sources import Ramp, Seeds

if TYPE_CHECKING:
    from ..scene.effects import FrontEnd, Ripple


class FreeOscillators:
    """Phase of the transmitter's oscillator relative to the receiver's.

    A constant carrier offset, and a random walk of the phase. The variance of a Lorentzian
    oscillator's phase grows by 2 pi ``linewidth_hz`` per second (A. Demir, A. Mehrotra, J.
    Roychowdhury, "Phase noise in oscillators", IEEE Trans. Circuits and Systems I 47 (2000)).
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
        """Rotate samples in place."""
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


class Adc:
    """An analogue-to-digital converter: rounds, clips, and left-justifies its codes in 16 bits."""

    def __init__(self, bits: int | None) -> None:
        self.bits = bits or 16
        self._half = 2 ** (self.bits - 1)

    def codes(self, samples: ArrayLike) -> np.ndarray:
        """Convert samples (n,) of full scale 1 per component to int16 (2 n,), I and Q in turn."""
        parts = np.ascontiguousarray(samples, np.complex64).view(np.float32) * self._half
        np.rint(parts, out=parts)
        np.minimum(parts, self._half - 1, out=parts)
        np.maximum(parts, -self._half, out=parts)
        return parts.astype(np.int16) << (16 - self.bits)


def image_gains(gain_db: float, phase_deg: float) -> tuple[complex, complex]:
    """mu and nu of y = mu x + nu conj(x) for a mixer whose I and Q differ.

    I stays as it is, and Q becomes g (Q cos phi + I sin phi), with ``phase_deg`` the deviation of
    their angle from 90 degrees, so that mu = (1 + g exp(j phi)) / 2 and nu = (1 - g exp(-j phi)) /
    2. See M. Valkama, M. Renfors, V. Koivunen, "Advanced methods for I/Q imbalance compensation in
    communication receivers", IEEE Trans. Signal Processing 49 (2001).
    """
    rotated = 10 ** (gain_db / 20) * np.exp(1j * np.deg2rad(phase_deg))
    return complex(1 + rotated) / 2, complex(1 - np.conj(rotated)) / 2


class AnalogueFrontEnd:
    """Mixers of transmitter and receiver, and the receiver's amplifier.

    Compression and DC offset refer to the ``peak`` of the received signal. The amplifier comes
    before the mixer: x (1 - c min(|x|^2 / peak^2, 1 / (3 c))), the third-order polynomial up to
    where its slope would be negative. Then follow the mixer's image and the DC offset.
    """

    def __init__(self, stated: "FrontEnd", peak: float, seeds: Seeds) -> None:
        self._sent = image_gains(stated.transmitter_gain_db, stated.transmitter_phase_deg)
        self._received = image_gains(stated.receiver_gain_db, stated.receiver_phase_deg)
        self._curvature = stated.compression / peak**2
        angle = 2 * np.pi * seeds.generator().random()
        self._dc = np.complex64(stated.dc_offset * peak * np.exp(1j * angle))

    def transmit(self, samples: np.ndarray) -> np.ndarray:
        """What the transmitter sends instead of some samples."""
        return _with_image(samples, *self._sent)

    def receive(self, samples: np.ndarray) -> None:
        """Apply the receiver's amplifier and mixer in place."""
        if self._curvature:
            power = samples.real**2 + samples.imag**2
            lost = np.minimum(np.float32(self._curvature) * power, np.float32(1 / 3))
            samples *= 1 - lost
        samples[:] = _with_image(samples, *self._received)
        if self._dc:
            samples += self._dc


def _with_image(samples: np.ndarray, mu: complex, nu: complex) -> np.ndarray:
    if nu == 0:
        return samples
    return np.complex64(mu) * samples + np.complex64(nu) * samples.conj()


class GainRipple:
    """Amplitude modulation 1 + a cos(2 pi f t + phi) of all that is received."""

    def __init__(self, stated: "Ripple", ramp: Ramp, seeds: Seeds) -> None:
        self._amplitude, self._hz, self._ramp = stated.percent / 100, stated.hz, ramp
        self._start = seeds.generator().random()

    def modulate(self, first_sample: int, samples: np.ndarray) -> None:
        """Modulate samples in place."""
        times = self._ramp.knots(first_sample, len(samples))
        gain = 1 + self._amplitude * np.cos(2 * np.pi * (self._start + self._hz * times))
        samples *= self._ramp.interpolate(gain, first_sample, len(samples))
