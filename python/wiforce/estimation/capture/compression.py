# SPDX-License-Identifier: GPL-3.0-or-later
"""Compression of a receiver by its strongest signal, the static path, and its effect on the tags.

A third-order amplifier gives y = x + c |x|^2 x. For a tag v beside a static path s this is
v (1 + 2 c |s|^2) + c s^2 conj(v). The first part rotates touched and untouched sensor alike. The
second is an image that turns the opposite way, with nearly the tag's own profile over the
subcarriers: it cannot be distinguished from the tag in a group, but it can be computed.
"""

from __future__ import annotations

import numpy as np

from ...signal.waveform import Waveform
from ..groups import Array, Groups
from .frame import whole_frames

# Samples behind the preamble in which its echoes fade and filters ring, samples before the next one
# in which they ring, and how many must lie between.
_ECHOES = 160
_RINGING = 64
_QUIET = 96
# Largest mean of a symbol, over its rms, that sends nothing on subcarrier 0: rounding.
_SILENT = 1e-6
# Share of compression at the largest static sample below which it is neither certain nor of
# consequence: 0.1 deg of a reading.
_LEAST = 0.003
# Part of |s|^2 s that must fall on subcarrier 0 for it to tell.
_LEAST_SHARE = 1e-3
# Standard deviations by which the result must exceed that of the offset, which is uncertain where
# others transmit in the guards.
_SIGNIFICANT = 2.5


class Compression:
    """What compression c by a mean folded symbol s adds to the channels of the tags' ends.

    ``std`` is that of what remains of the image, relative to the channel.
    """

    def __init__(self, symbol: Array, coefficient: float, waveform: Waveform, std: float) -> None:
        self._product, self._bins, self.std = coefficient * symbol**2, waveform.bins, std
        self._factors = waveform.equalizer()[waveform.bins]

    def image(self, channel: Array) -> Array:
        """c s^2 conj(v), for the samples v of channels, shape (..., K)."""
        spectrum = np.zeros((*channel.shape[:-1], len(self._product)), complex)
        spectrum[..., self._bins] = channel / self._factors
        samples = self._product * np.fft.ifft(spectrum).conj()
        image: Array = np.fft.fft(samples)[..., self._bins] * self._factors
        return image

    def correct(self, groups: Groups) -> Groups:
        """Remove the image from ``ends``; what may remain raises ``gain``."""
        if not len(groups):
            return groups
        power = groups.ends.real**2 + groups.ends.imag**2
        energy = np.einsum("gek,gk->ge", power, 1 / groups.noise)
        return groups.having(
            ends=groups.ends - self.image(groups.ends),
            gain=groups.gain + 2 * self.std**2 * energy,
        )


def measure_compression(samples: Array, waveform: Waveform) -> Compression | None:
    """Measure compression on the subcarrier that is never sent, in a run's first frames.

    Compression sends c sum_n |s[n]|^2 s[n] there, beside a DC offset, which may be added before or
    behind it.

    None where it is below 0.3 % at the largest sample or not significant, or the guard is too short
    for echoes to fade. Only the middle of preamble and guard is used, since filters ring at the
    edges.
    """
    guard = slice(waveform.preamble_length + _ECHOES, waveform.frame_length - _RINGING)
    size = float(np.sqrt(np.mean(np.abs(waveform.symbol) ** 2)))
    silent = abs(np.mean(waveform.symbol)) <= _SILENT * size
    if not silent or guard.stop - guard.start < _QUIET or len(samples) < waveform.frame_length:
        return None
    frame = whole_frames(samples, waveform.frame_length).mean(axis=0)
    if not np.isfinite(frame).all():
        return None
    quiet = frame[guard]
    offset = complex(np.mean(quiet))
    first, count = waveform.first_averaged, waveform.repetitions
    width = waveform.symbol_length
    repetitions = frame[first : first + count * width].reshape(count, width)
    symbol = repetitions[count // 4 : count - count // 4].mean(axis=0).astype(complex)
    before, behind = _compression(symbol, offset), _compression(symbol - offset, 0j)
    uncertain = float(np.std(quiet)) / np.sqrt(len(quiet))
    found = max(-before, -behind)
    if found * np.abs(symbol).max() ** 2 < _LEAST:
        return None
    if found * abs(_cubed(symbol, offset)) < _SIGNIFICANT * uncertain:
        return None
    std = abs(before - behind) / 2 * float(np.mean(np.abs(symbol) ** 2))
    return Compression(symbol, (before + behind) / 2, waveform, std)


def _compression(symbol: Array, offset: complex) -> float:
    """Coefficient c, at most 0: amplifiers convert amplitude to phase much less."""
    share = _cubed(symbol, offset)
    if abs(share) <= _LEAST_SHARE * np.mean(np.abs(symbol) ** 3):
        return 0.0
    return min(0.0, float((np.mean(symbol - offset) / share).real))


def _cubed(symbol: Array, offset: complex) -> complex:
    """What a coefficient of 1 would add to subcarrier 0."""
    return complex(np.mean(np.abs(symbol) ** 2 * symbol) - abs(offset) ** 2 * offset)
