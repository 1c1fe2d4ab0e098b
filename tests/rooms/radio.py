# SPDX-License-Identifier: GPL-3.0-or-later
"""Other transmitters, and what our own transmitter and receiver add."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from second_simulator import FRAME, RATE, frame

from rooms.effects import FRAME_S, Effect


class Transmissions(Effect):
    """Transmissions of others, at random times, in the guard as well.

    They last for random durations within ``durations_s``, and are on for a ``share`` of the time.
    """

    def begin(self, air, rng):
        """Set ``on``: first sample, last sample and seed of each."""
        self.amplitude = air.noise * 10 ** (self.level_db / 20)
        shortest_s, longest_s = self.durations_s
        mean_gap = (shortest_s + longest_s) / 2 * (1 - self.share) / self.share
        self.on, now = [], -rng.uniform(0, longest_s)
        while now < air.frames * FRAME_S:
            end = now + rng.uniform(shortest_s, longest_s)
            self.on.append((int(now * RATE), int(end * RATE), int(rng.integers(2**62))))
            # Half of the gap is fixed: others wait for each other.
            now = end + mean_gap * (0.5 + 0.5 * rng.exponential())
        self.peak = 3 * self.amplitude

    def add(self, block, first):
        samples = block.reshape(-1)
        zero = first * FRAME
        for begin, end, seed in self.on:
            a, b = max(begin, zero), min(end, zero + len(samples))
            if a < b:
                sent = self.waveform(end - begin, np.random.default_rng(seed))
                samples[a - zero : b - zero] += self.amplitude * sent[a - begin : b - begin]


def normal(rng, count):
    """Complex white noise of unit power."""
    pairs = rng.standard_normal(2 * count, dtype=np.float32)
    return pairs.view(np.complex64) * np.float32(np.sqrt(0.5))


@dataclass
class Bursts(Transmissions):
    """Wi-Fi-like bursts over the whole band; their level is above the receiver's noise."""

    share: float
    level_db: float
    durations_s: tuple = (0.3e-3, 2e-3)

    def waveform(self, count, rng):
        return normal(rng, count)


@dataclass
class OverloadingBursts(Bursts):
    """Bursts that nobody left room for in the receiver's range: the converter clips them."""

    def begin(self, air, rng):
        super().begin(air, rng)
        self.peak = 0.0


@dataclass
class SecondReader(Effect):
    """Another reader that sends the same frames, by its own sample clock and carrier.

    The level is that of the power of its preamble above the receiver's noise.
    """

    level_db: float
    clock_ppm: float = 4.0
    carrier_offset_hz: float = 1800.0

    def begin(self, air, rng):
        self.spectrum = np.fft.fft(frame())
        self.spectrum *= air.noise * 10 ** (self.level_db / 20)
        self.start_s, self.turn = rng.uniform(0, FRAME_S), rng.random()
        self.peak = 3 * air.noise * 10 ** (self.level_db / 20)

    def add(self, block, first):
        t = (first + np.arange(len(block))) * FRAME_S
        later = self.start_s + self.clock_ppm * 1e-6 * t
        turns = np.fft.fftfreq(FRAME, 1 / RATE) * later[:, None]
        frames = np.fft.ifft(self.spectrum * np.exp(-2j * np.pi * turns))
        inside = np.arange(FRAME) / RATE
        carrier = self.carrier_offset_hz * (t[:, None] + inside) + self.turn
        block += frames * np.exp(2j * np.pi * carrier)


@dataclass
class Hopper(Transmissions):
    """A transmitter on 8 of the 64 subcarriers at a time, elsewhere with each transmission.

    The level is that of its power density in its band above that of the receiver's noise.
    """

    share: float
    level_db: float
    durations_s: tuple = (5e-3, 20e-3)
    width: int = 8

    def waveform(self, count, rng):
        count += -count % 960  # a length with small prime factors
        lowest = round((rng.integers(-31, 32 - self.width) - 0.5) / 64 * count)
        bins = (lowest + np.arange(count * self.width // 64)) % count
        spectrum = np.zeros(count, np.complex64)
        spectrum[bins] = normal(rng, len(bins)) * np.sqrt(count)
        return np.fft.ifft(spectrum)


@dataclass
class Ripple(Effect):
    """The gain of the receiver follows its power supply."""

    depth: float = 0.1
    frequency_hz: float = 50.0

    def begin(self, air, rng):
        self.phase = rng.random()

    def receive(self, block, first, peak):
        t = first * FRAME_S + np.arange(block.size).reshape(block.shape) / RATE
        return block * (1 + self.depth * np.cos(2 * np.pi * (self.frequency_hz * t + self.phase)))


@dataclass
class PhaseNoise(Effect):
    """Two synthesizers, whose phase is white up to the bandwidth of their loops; in order only."""

    dbc_hz: float = -101.0
    loop_hz: float = 30e3

    def begin(self, air, rng):
        self.rng, self.state = rng, np.zeros(1)

    def receive(self, block, first, peak):
        decay = np.exp(-2 * np.pi * self.loop_hz / RATE)
        std = np.sqrt(10 ** (self.dbc_hz / 10) * np.pi * self.loop_hz * (1 - decay**2))
        steps = std * self.rng.standard_normal(block.size)
        phase, self.state = lfilter([1.0], [1.0, -decay], steps, zi=self.state)
        return block * np.exp(1j * phase.reshape(block.shape))


@dataclass
class TransmitterImage(Effect):
    """The conjugate of the frame is sent along."""

    level_db: float

    def transmit(self, sent, rng):
        image = 10 ** (self.level_db / 20) * np.exp(2j * np.pi * rng.random())
        return (sent + image * np.conj(sent)) / np.sqrt(1 + np.abs(image) ** 2)


@dataclass
class ReceiverImage(Effect):
    """The receiver adds the conjugate of what it receives, by its level or by its causes."""

    level_db: float | None = None
    gain_db: float = 0.0
    phase_deg: float = 0.0

    def begin(self, air, rng):
        if self.level_db is not None:
            self.mu, self.nu = 1.0, 10 ** (self.level_db / 20) * np.exp(2j * np.pi * rng.random())
        else:
            turn = np.deg2rad(self.phase_deg) * rng.choice([-1, 1])
            gain = 10 ** (self.gain_db * rng.choice([-1, 1]) / 20)
            self.mu = (1 + gain * np.exp(-1j * turn)) / 2
            self.nu = (1 - gain * np.exp(1j * turn)) / 2

    def receive(self, block, first, peak):
        return self.mu * block + self.nu * np.conj(block)


@dataclass
class DcOffset(Effect):
    """A constant, as share of the largest input."""

    share: float

    def begin(self, air, rng):
        self.turn = np.exp(2j * np.pi * rng.random())

    def receive(self, block, first, peak):
        return block + self.share * peak * self.turn


@dataclass
class Compression(Effect):
    """Third-order compression: the gain falls by this share at the largest input."""

    share: float

    def receive(self, block, first, peak):
        return block * (1 - self.share * np.abs(block / peak) ** 2)
