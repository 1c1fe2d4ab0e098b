# SPDX-License-Identifier: GPL-3.0-or-later
"""A recording of preambles in noise in both sample types, and its tones in double precision."""

import os
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from gnuradio.wiforce.signal.waveform import sounding_waveform

GROUP_LENGTH = 625
WAVEFORM = sounding_waveform()
GROUP_SAMPLES = GROUP_LENGTH * WAVEFORM.frame_length
# Of 32768: frames stand 11 dB above the noise, so that their watch is at rest.
FRAME_PEAK, NOISE_PEAK = 18_000, 4_000
# Bursts of another transmitter raise the noise by 8 dB. A group has three, of 5 to 19 frames (0.3
# to 1.1 ms), as packets of Wi-Fi have.
BURST_PEAK, _BURSTS, _BURST_FRAMES = 9_000, 3, (5, 20)
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
    """The same samples as raw ``cf32_le`` and ``ci16_le``; ``bursts``: in every group."""

    fc32: Path
    sc16: Path
    samples: int
    bursts: bool = False

    @property
    def groups(self):
        return self.samples // GROUP_SAMPLES

    def shortened(self, samples):
        """The recording's first samples, in whole groups."""
        groups = max(1, round(samples / GROUP_SAMPLES))
        return replace(self, samples=groups * GROUP_SAMPLES)


def write_recording(folder, samples, bursts=False):
    """Writes a recording of about so many samples, in whole groups."""
    groups = max(2, samples // GROUP_SAMPLES)
    kinds, _ = _groups(bursts)
    path = Path(folder) / ("bursts" if bursts else "frames")
    with open(path.with_suffix(".ci16"), "wb") as integers:
        for group in range(groups):
            integers.write(kinds[group % len(kinds)])
    return replace(with_floats(path.with_suffix(".ci16")), bursts=bursts)


def with_floats(path):
    """The recording of a file ``ci16_le``, and its samples as ``cf32_le`` beside it."""
    codes = np.memmap(path, "<i2", "r")
    recording = Recording(Path(path).with_suffix(".cf32"), Path(path), len(codes) // 2)
    with open(recording.fc32, "wb") as floats:
        for start in range(0, len(codes), _PART):
            floats.write(codes[start : start + _PART].astype("<f4") / np.float32(32768))
    for written in (recording.fc32, recording.sc16):
        _settle(written)
    return recording


_PART = 10_000_000  # numbers converted at a time


@cache
def _groups(bursts):
    """Codes (_KINDS, 2 GROUP_SAMPLES) of groups, and frames without bursts (_KINDS, 625)."""
    rng = np.random.default_rng(1)
    frame = WAVEFORM.frame()
    codes = (FRAME_PEAK / np.abs(frame).max() * frame).view(float).astype("<i2")
    noise = rng.integers(-NOISE_PEAK, NOISE_PEAK, (_KINDS, 2 * GROUP_SAMPLES), dtype="<i2")
    groups = np.tile(codes, GROUP_LENGTH) + noise
    quiet = np.ones((_KINDS, GROUP_LENGTH), bool)
    for kind in range(_KINDS if bursts else 0):
        frames = groups[kind].reshape(GROUP_LENGTH, -1)
        for _ in range(_BURSTS):
            first = rng.integers(GROUP_LENGTH - _BURST_FRAMES[1])
            hit = slice(first, first + rng.integers(*_BURST_FRAMES))
            if quiet[kind, hit].all():  # two at a time could exceed the codes
                frames[hit] += rng.integers(-BURST_PEAK, BURST_PEAK, frames[hit].shape, "<i2")
                quiet[kind, hit] = False
    return groups, quiet


def _settle(path):
    """Leaves the file in memory as read from disk, whose pages are mapped twice as fast."""
    with open(path, "r+b") as file:
        os.fsync(file.fileno())
        os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        while file.read(1 << 24):
            pass


def reference_tones(recording, weights):
    """Channel (groups, M, 64) of tones, without frames of bursts, in double precision."""
    repetitions = WAVEFORM.repetitions
    first, length = WAVEFORM.first_averaged, 64 * repetitions
    kinds = []
    for codes, quiet in zip(*_groups(recording.bursts), strict=True):
        samples = codes.astype(float).view(complex) / 32768
        frames = samples.reshape(GROUP_LENGTH, -1)[:, first : first + length]
        folded = frames.reshape(GROUP_LENGTH, repetitions, 64).mean(axis=1)
        kinds.append(np.fft.fft(weights * quiet @ folded) * WAVEFORM.equalizer())
    return np.array(kinds)[np.arange(recording.groups) % len(kinds)]
