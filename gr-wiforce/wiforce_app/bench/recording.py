# SPDX-License-Identifier: GPL-3.0-or-later
"""A recording of preambles in noise in both sample types, and its tones in double precision."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from gnuradio.wiforce.signal.waveform import sounding_waveform

GROUP_LENGTH = 625
WAVEFORM = sounding_waveform()
GROUP_SAMPLES = GROUP_LENGTH * WAVEFORM.frame_length
# Of 32768: frames stand 10 dB above the noise, so that their watch is at rest.
FRAME_PEAK, NOISE_PEAK = 20_000, 5_000
# Different groups, which a recording repeats.
_KINDS = 7
# Harmonic m of a tag at 1 kHz is bin 36 m of a group.
BINS_PER_HARMONIC = 36


def tone_weights(tones):
    """Fourier weights of a tag's lines; (tones, 625). Four tones: +-1 and +-4, else +-1.."""
    harmonics = [1, 4] if tones == 4 else range(1, tones // 2 + 1)
    bins = BINS_PER_HARMONIC * np.array([m for h in harmonics for m in (h, -h)], int)
    n = np.arange(GROUP_LENGTH)
    return np.exp(-2j * np.pi * np.outer(bins, n) / GROUP_LENGTH) / GROUP_LENGTH


@dataclass(frozen=True)
class Recording:
    """The same samples as raw ``cf32_le`` and ``ci16_le``."""

    fc32: Path
    sc16: Path
    samples: int

    @property
    def groups(self):
        return self.samples // GROUP_SAMPLES

    def shortened(self, samples):
        """The recording's first samples, in whole groups."""
        groups = max(1, round(samples / GROUP_SAMPLES))
        return Recording(self.fc32, self.sc16, groups * GROUP_SAMPLES)


def write_recording(folder, samples):
    """Writes a recording of about so many samples, in whole groups."""
    groups = max(2, samples // GROUP_SAMPLES)
    recording = Recording(
        Path(folder) / "frames.cf32", Path(folder) / "frames.ci16", groups * GROUP_SAMPLES
    )
    kinds = _groups()
    with open(recording.fc32, "wb") as floats, open(recording.sc16, "wb") as integers:
        for group in range(groups):
            codes = kinds[group % len(kinds)]
            integers.write(codes)
            floats.write(codes.astype("<f4") / 32768)
    for path in (recording.fc32, recording.sc16):
        _settle(path)
    return recording


def _groups():
    """The different groups that a recording repeats, as codes; (_KINDS, 2 GROUP_SAMPLES)."""
    rng = np.random.default_rng(1)
    frame = WAVEFORM.frame()
    codes = (FRAME_PEAK / np.abs(frame).max() * frame).view(float).astype("<i2")
    noise = rng.integers(-NOISE_PEAK, NOISE_PEAK, (_KINDS, 2 * GROUP_SAMPLES), dtype="<i2")
    return np.tile(codes, GROUP_LENGTH) + noise


def _settle(path):
    """Leaves the file in memory as it is after being read from disk, not as it was written.

    Written pages lie about in small pieces, and mapping those costs twice the time.
    """
    with open(path, "r+b") as file:
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        while file.read(1 << 24):
            pass


def reference_tones(recording, weights):
    """Channel of every group's tones, from the codes in double precision; (groups, M, 64)."""
    repetitions = WAVEFORM.repetitions
    first, length = WAVEFORM.first_averaged, 64 * repetitions
    kinds = []
    for codes in _groups():
        samples = codes.astype(float).view(complex) / 32768
        frames = samples.reshape(GROUP_LENGTH, -1)[:, first : first + length]
        folded = frames.reshape(GROUP_LENGTH, repetitions, 64).mean(axis=1)
        kinds.append(np.fft.fft(weights @ folded) * WAVEFORM.equalizer())
    return np.array(kinds)[np.arange(recording.groups) % len(kinds)]
