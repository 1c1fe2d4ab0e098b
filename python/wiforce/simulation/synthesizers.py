# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise of the radio that the static path carries: synthesizers and transmitter."""

from typing import TYPE_CHECKING

import numpy as np

from .random_sources import Ramp, Seeds

if TYPE_CHECKING:
    from ..scene.effects import RadioNoise
    from ..signal.waveform import Waveform

# Values that are drawn together: knots of the phase, and samples of the transmitter's noise.
_BLOCK = 8192
# Counters of Seeds: what is drawn.
_PHASE, _TRANSMITTER = 0, 1
# Multiples of the snapshot rate that alias onto a line: averaging over Ta leaves little beyond.
_ALIASES = np.arange(-16, 17)


def phase_noise_density(stated: "RadioNoise", offset_hz: np.ndarray) -> np.ndarray:
    """Two-sided density of the phase in rad^2 per Hz, L(f) in dBc/Hz as a factor; shape as given.

    Flat within the bandwidth of the loops, and falling by 20 dB per decade beyond (D. B. Leeson,
    Proc. IEEE 54 (1966)). 0 where transmitter and receiver have one synthesizer, whose phase both
    apply: of it remains 4 sin^2(pi f t), -60 dB and less up to 10 kHz and a path of 30 ns.
    """
    if stated.synthesizers == "one":
        return np.zeros(np.shape(offset_hz))
    return 10 ** (stated.phase_noise_dbc_hz / 10) / (1 + (offset_hz / stated.loop_hz) ** 2)


def noise_over_static(
    stated: "RadioNoise", waveform: "Waveform", line_hz: float
) -> tuple[float, float]:
    """Noise around a line in the snapshots, as variances over the power of the static path.

    Returns tuple of float: that of the phase, which is alike on all subcarriers, and that of the
    transmitter, which is independent; as white noise per snapshot and subcarrier.
    """
    rate_hz = 1 / waveform.snapshot_period_s
    offset_hz = line_hz + rate_hz * _ALIASES
    passed = phase_noise_density(stated, offset_hz) * np.sinc(offset_hz * waveform.averaging_s) ** 2
    sent = 10 ** (stated.transmitter_dbc_hz / 10) * waveform.sample_rate_hz
    return float(passed.sum() * rate_hz), float(sent * waveform.channel_noise_gain)


class RadioNoiseSource:
    """The noise of a scene's radio, which can start anywhere in the stream.

    ``amplitude`` is the root of the mean preamble power; the phase is drawn at the knots of
    ``ramp``, as the sum of blocks that overlap by half, each windowed by half a period of a sine,
    so that its variance is constant; a block is white noise that is shaped in the frequency domain.
    """

    def __init__(
        self,
        stated: "RadioNoise",
        amplitude: float,
        ramp: Ramp,
        sample_rate_hz: float,
        seeds: Seeds,
    ) -> None:
        self._seeds, self._ramp = seeds, ramp
        density = 10 ** (stated.transmitter_dbc_hz / 10)
        self._sent_std = np.float32(amplitude * np.sqrt(density * sample_rate_hz / 2))
        times = ramp.knots(0, 1)
        self._spacing_s = float(times[1] - times[0])
        frequencies = np.fft.rfftfreq(_BLOCK, self._spacing_s)
        self._shape = np.sqrt(phase_noise_density(stated, frequencies) / self._spacing_s)
        self._window = np.sin(np.pi * (np.arange(_BLOCK) + 0.5) / _BLOCK)
        self._blocks: dict[int, np.ndarray] = {}

    def transmit(self, first_sample: int, samples: np.ndarray) -> np.ndarray:
        """Samples with the noise of the transmitter; ndarray of complex64, shape (n,)."""
        parts, end = [], first_sample + len(samples)
        for block in range(first_sample // _BLOCK, (end - 1) // _BLOCK + 1):
            rng = self._seeds.generator(_TRANSMITTER, block)
            drawn = rng.standard_normal(2 * _BLOCK, np.float32).view(np.complex64)
            start = block * _BLOCK
            parts.append(drawn[max(first_sample - start, 0) : end - start])
        return samples + self._sent_std * np.concatenate(parts)

    def rotate(self, first_sample: int, samples: np.ndarray) -> None:
        """Turn received samples by the phase, in place."""
        times_s = self._ramp.knots(first_sample, len(samples))
        phase = self._phase(np.rint(times_s / self._spacing_s).astype(np.int64))
        samples *= self._ramp.interpolate(np.exp(1j * phase), first_sample, len(samples))

    def _phase(self, knots: np.ndarray) -> np.ndarray:
        phase, half = np.zeros(len(knots)), _BLOCK // 2
        for block in range(int(knots[0]) // half, int(knots[-1]) // half + 2):
            inside = knots - (block - 1) * half
            here = (inside >= 0) & (inside < _BLOCK)
            phase[here] += self._block(block)[inside[here]]
        return phase

    def _block(self, block: int) -> np.ndarray:
        if block not in self._blocks:
            white = self._seeds.generator(_PHASE, block).standard_normal(_BLOCK)
            shaped = np.fft.irfft(np.fft.rfft(white) * self._shape, _BLOCK)
            self._blocks = {b: v for b, v in self._blocks.items() if abs(b - block) <= 2}
            self._blocks[block] = self._window * shaped
        return self._blocks[block]
