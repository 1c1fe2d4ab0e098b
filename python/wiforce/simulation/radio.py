# SPDX-License-Identifier: GPL-3.0-or-later
"""Radios of a scene: analogue parts, oscillators, noise, converter; and other transmitters."""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..scene.effects import Bursts, FrontEnd, Hopper, RadioNoise, Ripple
from ..scene.simulated import Simulation
from ..signal.waveform import Waveform
from .random_sources import Ramp, RandomSources, Seeds


class FreeOscillators:
    """Phase of the transmitter's oscillator over the receiver's: an offset and a random walk.

    Its variance grows by 2 pi times the linewidth per second (A. Demir, A. Mehrotra, J.
    Roychowdhury, IEEE Trans. Circuits and Systems I 47 (2000)).
    """

    def __init__(
        self,
        stated: Simulation,
        rng: np.random.Generator,
        ramp: Ramp,
        sample_rate_hz: float,
    ) -> None:
        self._cycles_per_sample = stated.carrier_offset_hz / sample_rate_hz
        self._step_std = np.sqrt(2 * np.pi * stated.phase_noise_hz)
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
            samples *= self._ramp.sampled(self._phasor, first_sample, count)

    def _phasor(self, times: np.ndarray) -> np.ndarray:
        """exp(j phase) at knots, continued from the previous call, whose last two may recur."""
        if self._last is None or times[0] > self._last[0][-1]:
            self._last = times[:1], np.zeros(1)
        known_times, known = self._last
        new = times[times > known_times[-1]]
        steps = np.diff(new, prepend=known_times[-1])
        drawn = self._step_std * np.sqrt(steps) * self._rng.standard_normal(len(new))
        all_times = np.r_[known_times, new]
        walk = np.r_[known, known[-1] + np.cumsum(drawn)]
        self._last = all_times[-2:], walk[-2:]
        return np.exp(1j * walk[np.searchsorted(all_times, times)])


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
    """mu and nu of y = mu x + nu conj(x) for a mixer with Q of g (Q cos phi + I sin phi).

    (1 + g exp(j phi)) / 2 and (1 - g exp(-j phi)) / 2 (M. Valkama, M. Renfors, V. Koivunen, IEEE
    Trans. Signal Processing 49 (2001)).
    """
    rotated = 10 ** (gain_db / 20) * np.exp(1j * np.deg2rad(phase_deg))
    return complex(1 + rotated) / 2, complex(1 - np.conj(rotated)) / 2


class AnalogueFrontEnd:
    """The receiver's amplifier, x (1 - c min(|x|^2 / peak^2, 1 / (3 c))), mixers and DC offset."""

    def __init__(self, stated: FrontEnd, peak: float, seeds: Seeds) -> None:
        self._sent = image_gains(stated.transmitter_gain_db, stated.transmitter_phase_deg)
        self._received = image_gains(stated.receiver_gain_db, stated.receiver_phase_deg)
        self._curvature = stated.compression / peak**2
        angle = 2 * np.pi * seeds.generator().random()
        self._dc = np.complex64(stated.dc_offset * peak * np.exp(1j * angle))

    def transmit(self, _: int, samples: np.ndarray) -> np.ndarray:
        """What the transmitter sends instead of some samples."""
        return _with_image(samples, *self._sent)

    def receive(self, _: int, samples: np.ndarray) -> None:
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

    def __init__(self, stated: Ripple, ramp: Ramp, seeds: Seeds) -> None:
        self._amplitude, self._hz, self._ramp = stated.percent / 100, stated.hz, ramp
        self._start = seeds.generator().random()

    def modulate(self, first_sample: int, samples: np.ndarray) -> None:
        """Modulate samples in place."""
        samples *= self._ramp.sampled(self._gain, first_sample, len(samples))

    def _gain(self, time_s: np.ndarray) -> np.ndarray:
        return 1 + self._amplitude * np.cos(2 * np.pi * (self._start + self._hz * time_s))


# Values that are drawn together: knots of the phase, and samples of noise and signals.
_BLOCK = 8192
# Counters of Seeds: what is drawn.
_PHASE, _TRANSMITTER = 0, 1
# Multiples of the snapshot rate that alias onto a line: averaging over Ta leaves little beyond.
_ALIASES = np.arange(-16, 17)


def phase_noise_density(stated: RadioNoise, offset_hz: np.ndarray) -> np.ndarray:
    """Two-sided density of the phase, in rad^2 per Hz, at offsets from the carrier.

    It is flat within the loops, and falls by 20 dB a decade beyond: D. B. Leeson, Proc. IEEE 54
    (1966). With one synthesizer it is 0: the phase cancels to -60 dB.
    """
    if stated.synthesizers == "one":
        return np.zeros(np.shape(offset_hz))
    return 10 ** (stated.phase_noise_dbc_hz / 10) / (1 + (offset_hz / stated.loop_hz) ** 2)


def noise_over_static(
    stated: RadioNoise, waveform: Waveform, line_hz: float
) -> tuple[float, float]:
    """Variances over the static path's power, around a line, of phase and transmitter noise."""
    rate_hz = 1 / waveform.snapshot_period_s
    offset_hz = line_hz + rate_hz * _ALIASES
    passed = phase_noise_density(stated, offset_hz) * np.sinc(offset_hz * waveform.averaging_s) ** 2
    sent = 10 ** (stated.transmitter_dbc_hz / 10) * waveform.sample_rate_hz
    return float(passed.sum() * rate_hz), float(sent * waveform.channel_noise_gain)


def _blocks(first: int, end: int) -> Iterator[tuple[int, slice]]:
    """The blocks that hold samples from ``first`` up to ``end``, and the part of each that does."""
    for block in range(first // _BLOCK, (end - 1) // _BLOCK + 1):
        start = block * _BLOCK
        yield block, slice(max(first - start, 0), end - start)


def _white(rng: np.random.Generator) -> np.ndarray:
    """A block of complex noise, of unit variance in each component."""
    return rng.standard_normal(2 * _BLOCK, np.float32).view(np.complex64)


class RadioNoiseSource:
    """The noise of a scene's radio: white, shaped in overlapping blocks; can start anywhere."""

    def __init__(
        self,
        stated: RadioNoise,
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
        self._block = lru_cache(5)(self._drawn_block)

    def transmit(self, first_sample: int, samples: np.ndarray) -> np.ndarray:
        """Samples with the noise of the transmitter; ndarray of complex64, shape (n,)."""
        parts = [
            _white(self._seeds.generator(_TRANSMITTER, block))[part]
            for block, part in _blocks(first_sample, first_sample + len(samples))
        ]
        return samples + self._sent_std * np.concatenate(parts)

    def rotate(self, first_sample: int, samples: np.ndarray) -> None:
        """Turn received samples by the phase, in place."""
        samples *= self._ramp.sampled(self._phasor, first_sample, len(samples))

    def _phasor(self, times_s: np.ndarray) -> np.ndarray:
        """exp(j phase) at knots."""
        knots = np.rint(times_s / self._spacing_s).astype(np.int64)
        phase, half = np.zeros(len(knots)), _BLOCK // 2
        for block in range(int(knots[0]) // half, int(knots[-1]) // half + 2):
            inside = knots - (block - 1) * half
            here = (inside >= 0) & (inside < _BLOCK)
            phase[here] += self._block(block)[inside[here]]
        return np.exp(1j * phase)

    def _drawn_block(self, block: int) -> np.ndarray:
        white = self._seeds.generator(_PHASE, block).standard_normal(_BLOCK)
        return self._window * np.fft.irfft(np.fft.rfft(white) * self._shape, _BLOCK)


# Transmissions are drawn for a cell of time on its own, so that a stream can start anywhere.
# A cell holds at least this many of the longest transmission: what its end cuts off is little.
_LONGEST_PER_CELL = 100
_SHORTEST_CELL_S = 1.0
_KEPT_CELLS = 3
_KEPT_BLOCKS = 8
# Channels of a hopper in the sample rate.
_HOPPER_CHANNELS = 64
# Counters of Seeds: what is drawn.
_TIMES, _SIGNAL = 0, 1


class NoiseTransmitter:
    """A transmitter that is on the air for a stated share of the time, as received.

    Gaussian noise over a ``bandwidth``, a share of the sample rate drawn for each transmission;
    ``gain`` is amplitude and phase. Durations are uniform, pauses exponential. Narrow-band noise is
    the sum of blocks with sine windows that overlap by half, of constant power.
    """

    def __init__(
        self,
        seeds: Seeds,
        sample_rate_hz: float,
        stated: Bursts | Hopper,
        gain: complex,
        bandwidth: float,
    ) -> None:
        self._seeds, self._bandwidth, self._share = seeds, bandwidth, stated.share
        self._gain = np.complex64(gain / np.sqrt(2))  # of a component of unit variance
        self._durations = stated.shortest_s * sample_rate_hz, stated.longest_s * sample_rate_hz
        self._mean_pause = sum(self._durations) / 2 * (1 - stated.share) / stated.share
        cell_s = max(_SHORTEST_CELL_S, _LONGEST_PER_CELL * stated.longest_s)
        self._cell = round(cell_s * sample_rate_hz)
        self._transmissions = lru_cache(_KEPT_CELLS)(self._drawn_transmissions)
        self._noise = lru_cache(_KEPT_BLOCKS)(self._drawn_noise)
        self._band = lru_cache(_KEPT_BLOCKS)(self._drawn_band)

    def add(self, first_sample: int, received: np.ndarray) -> None:
        """Add what is received to samples."""
        for start, stop, centre in self._during(first_sample, first_sample + len(received)):
            parts = [self._signal(block, centre)[part] for block, part in _blocks(start, stop)]
            received[start - first_sample : stop - first_sample] += np.concatenate(parts)

    def _during(self, first: int, end: int) -> Iterator[tuple[int, int, int]]:
        """Transmissions between two samples: first sample, end, and centre in bins of a block."""
        for index in range(first // self._cell, (end - 1) // self._cell + 1):
            cell = self._transmissions(index)
            for start, stop, centre in cell[(cell[:, 0] < end) & (cell[:, 1] > first)]:
                yield max(int(start), first), min(int(stop), end), int(centre)

    def _drawn_transmissions(self, index: int) -> np.ndarray:
        """Transmissions of a cell; shape (n, 3)."""
        rng = self._seeds.generator(_TIMES, index)
        low, high = self._durations
        most = int(2 * self._cell / (self._mean_pause + low)) + 64
        durations = rng.uniform(low, high, most)
        pauses = rng.exponential(self._mean_pause, most)
        if rng.random() < self._share:  # it is on the air when the cell begins
            pauses[0] = 0
            durations[0] *= rng.random()
        starts = np.cumsum(pauses + np.r_[0, durations[:-1]])
        reach = (1 - self._bandwidth) / 2
        centres = np.rint(rng.uniform(-reach, reach, most) * 2 * _BLOCK)
        times = np.minimum(np.rint([starts, starts + durations]), self._cell)
        cell = np.column_stack([*(index * self._cell + times), centres]).astype(np.int64)
        return cell[cell[:, 0] < cell[:, 1]]

    def _signal(self, block: int, centre: int) -> np.ndarray:
        """The samples of a block, for a transmission about a centre frequency."""
        if self._bandwidth == 1.0:
            return self._noise(block)
        return self._band(block, centre)[_BLOCK:] + self._band(block + 1, centre)[:_BLOCK]

    def _drawn_noise(self, block: int) -> np.ndarray:
        return _white(self._seeds.generator(_SIGNAL, block)) * self._gain

    def _drawn_band(self, block: int, centre: int) -> np.ndarray:
        """Windowed narrow-band noise over a block and the one before; shape (2 blocks,)."""
        size = 2 * _BLOCK
        bins = max(1, round(self._bandwidth * size))
        rng = self._seeds.generator(_SIGNAL, block, centre % size)
        spectrum = np.zeros(size, complex)
        normal = rng.standard_normal((bins, 2)) @ [1, 1j]
        spectrum[(centre - bins // 2 + np.arange(bins)) % size] = normal
        window = np.sin(np.pi * (np.arange(size) + 0.5) / size)
        signal = np.fft.ifft(spectrum) * np.sqrt(size) * window
        return signal.astype(np.complex64) * self._gain


def transmitters(
    simulation: Simulation, sources: RandomSources, sample_rate_hz: float, noise_std: float
) -> list[NoiseTransmitter]:
    """The other transmitters of a scene, whose receiver has ``noise_std`` in a sample."""
    found = []
    for name, stated, bandwidth in _others(simulation):
        gain = sources.rotated(np.ones(1))[0] * noise_std * 10 ** (stated.level_db / 20)
        seeds = sources.effect(name)
        found.append(NoiseTransmitter(seeds, sample_rate_hz, stated, gain, bandwidth))
    return found


def power_over_noise(simulation: Simulation) -> float:
    """Power in a sample, relative to the receiver's noise, while all other transmitters are on."""
    found = _others(simulation)
    return sum((bandwidth * 10 ** (each.level_db / 10) for _, each, bandwidth in found), start=0.0)


def _others(simulation: Simulation) -> Iterator[tuple[str, Bursts | Hopper, float]]:
    """Names, settings and bandwidths of the transmitters that a scene states."""
    if simulation.bursts:
        yield "bursts", simulation.bursts, 1.0
    if simulation.hopper:
        yield "hopper", simulation.hopper, simulation.hopper.subcarriers / _HOPPER_CHANNELS
