# SPDX-License-Identifier: GPL-3.0-or-later
"""Captures with any sounding symbol, made by somebody else from the signal model alone.

Like :mod:`second_simulator`, of which it takes the pressed line, it shares no line with the
product: own symbols, own clock, and its own account of the noise, from which the bound of the
readings follows.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from second_simulator import CARRIER_HZ, Tag, phases, pressed, switched, write_capture


def chirp(count):
    """Frequency rises over the whole band, sample by sample; phase by summation."""
    cycles = np.cumsum((np.arange(count) + 0.5) / count - 0.5)
    return np.exp(2j * np.pi * cycles)


def zadoff_chu(count, root=1):
    """The sequence of Chu (1972), even lengths."""
    return np.exp(-1j * np.pi * root * np.arange(count) ** 2 / count)


@dataclass(frozen=True)
class Air:
    """A room with a reader that repeats a symbol, and one tag."""

    symbol: np.ndarray
    rate_hz: float = 2.5e6
    sent: int = 5
    averaged: int = 4
    frame: int = 320
    group: int = 150  # frames
    clock_hz: float = 800.0
    snr_db: float = 5.0  # line 1 of the tag against the noise, per subcarrier of a flat spectrum
    static_db: float = 40.0  # the still paths against that line
    duration_s: float = 2.4
    presses: tuple = ((0.6, 0.03, 1.7, 5.0, 5.0, 42.0),)

    @property
    def tag(self):
        return Tag(clock_hz=self.clock_hz, offset_ppm=-40.0, presses=self.presses)

    @property
    def preamble(self):
        unit = self.symbol / np.sqrt(np.mean(np.abs(self.symbol) ** 2))
        return np.tile(unit, self.sent)

    @property
    def averaging_s(self):
        return self.averaged * len(self.symbol) / self.rate_hz

    @property
    def line(self):
        """Amplitude of the tag's first line in the mean of the averaged symbols."""
        return 0.25 * np.sinc(0.25) * np.sinc(self.clock_hz * self.averaging_s)

    @property
    def noise(self):
        """Standard deviation of a sample's noise."""
        return self.line / 10 ** (self.snr_db / 20) * np.sqrt(self.averaged)

    @property
    def noise_of_all(self):
        """Variance of the noise in a channel that is the same on all subcarriers.

        The transform of a symbol of unit power has the energy N^2, its noise N sigma^2 / R on each
        subcarrier.
        """
        return self.noise**2 / (self.averaged * len(self.symbol))

    def samples(self, rng):
        """All samples, a group at a time; the peak 3 dB below full scale."""
        frame = np.zeros(self.frame, complex)
        frame[: self.sent * len(self.symbol)] = self.preamble
        f = np.fft.fftfreq(self.frame, 1 / self.rate_hz)

        def late(delay_s):
            return np.fft.ifft(np.fft.fft(frame) * np.exp(-2j * np.pi * f * delay_s))

        still = sum(
            level * np.exp(2j * np.pi * rng.random()) * late(delay / self.rate_hz)
            for delay, level in zip(rng.uniform(0.5, 4, 4), (1, 0.3, 0.2, 0.1), strict=True)
        )
        still /= np.sqrt(np.mean(np.abs(still[: self.sent * len(self.symbol)]) ** 2))
        still *= self.line * 10 ** (self.static_db / 20)
        own, phase = late(2.0 / self.rate_hz), rng.random()
        scale = 10**-0.15 / ((np.abs(still) + np.abs(own)).max() + 3.5 * self.noise)
        for first in range(0, int(self.duration_s * self.rate_hz / self.frame), self.group):
            start = (first + np.arange(self.group)) * self.frame / self.rate_hz
            t = start[:, None] + np.arange(self.frame) / self.rate_hz
            ends = np.exp(1j * np.deg2rad(phases(self.tag, *pressed(self.tag, start))))
            received = still + own * self.reflection(ends, phase, t)
            normal = rng.standard_normal((*received.shape, 2), dtype=np.float32)
            received += self.noise / np.sqrt(2) * normal.view(np.complex64)[..., 0]
            yield scale * received

    def reflection(self, ends, phase, t):
        """Of the tag at sample times t: clock 1 at fs for a quarter, clock 2 at 2 fs between."""
        cycles = phase + self.clock_hz * t * (1 + 1e-6 * self.tag.offset_ppm)
        first, second = switched(cycles, cycles, self.rate_hz / self.clock_hz)
        return first * ends[:, :1] + second * ends[:, 1:]

    def truth_deg(self, times_s):
        """Phases of both ends at times, (n, 2)."""
        return phases(self.tag, *pressed(self.tag, times_s))

    def write(self, folder, model, seed=3):
        """``symbol.npy``, ``scene.yaml`` and ``capture.sigmf-*`` in a folder."""
        folder = Path(folder)
        np.save(folder / "symbol.npy", self.symbol)
        scene = {
            "radio": {"center_frequency_hz": CARRIER_HZ, "sample_rate_hz": self.rate_hz},
            "sounding": {
                "waveform": "symbol.npy",
                "frame_length": self.frame,
                "repetitions": self.sent,
                "averaged_repetitions": self.averaged,
            },
            "phase_group": {"snapshots": self.group, "smoothing_s": 0},
            "environment": {"moving_clutter_hz": 0, "mains_hz": None},
            "sensors": [{"name": "finger", "model": str(model), "clock_hz": self.clock_hz}],
            "reference_s": 0.5,
        }
        (folder / "scene.yaml").write_text(json.dumps(scene))
        blocks = self.samples(np.random.default_rng(seed))
        write_capture(blocks, folder / "capture", self.rate_hz)
