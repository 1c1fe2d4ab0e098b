# SPDX-License-Identifier: GPL-3.0-or-later
"""Two receive antennas on one oscillator: their ratio is free of the oscillator's phase."""

from __future__ import annotations

import numpy as np

from ...signal.waveform import Waveform
from ..groups import Array


def channel_ratio(first: Array, second: Array) -> Array:
    """Ratio H_1 / H_2 of the channels of two antennas, (n, K); 0 where the second receives nothing.

    Free-running oscillators rotate every snapshot by a phase that both antennas share: H_a = exp(j
    phi) (S_a + r T_a) with the static path S_a and the tag r T_a. The ratio cancels this phase and
    is linear in r while the tag is weak relative to the static path; terms of higher order change a
    phase by up to 2 |T|/|S| rad. (Ratios of antennas: Y. Zeng et al., FarSense, 2019.) A single
    antenna does not suffice: dividing by its own static path would attribute the tag's component in
    quadrature with that path to the oscillator.
    """
    received = np.abs(second) > 0
    return np.divide(first, second, out=np.zeros_like(first), where=received)


def folded_ratio(first: Array, second: Array, waveform: Waveform) -> Array:
    """Ratio of two antennas' channels as the folded frames of one antenna, (n, symbol_length).

    The sounding symbol cancels in the ratio. It is multiplied back, so that the result is processed
    like the frames of a single antenna.
    """
    bins = waveform.bins
    channels = [np.fft.fft(folded.astype(complex), axis=1)[:, bins] for folded in (first, second)]
    spectrum = np.zeros((len(first), waveform.symbol_length), complex)
    spectrum[:, bins] = channel_ratio(*channels) / waveform.equalizer()[bins]
    return np.fft.ifft(spectrum, axis=1)


def ratio_noise(antennas: tuple[Array, Array], noise: tuple[Array, Array], ratio: Array) -> Array:
    """Noise of the ratio of two antennas, as the kernels give it for one antenna: (n, 2), float32.

    The relative noise of both antennas (smallest and largest difference of the repetitions, as a
    power per sample) together, times the power of the ratio.
    """
    relative = sum(own / _power(folded) for own, folded in zip(noise, antennas, strict=True))
    return np.asarray(relative * _power(ratio), np.float32)


def _power(folded: Array) -> Array:
    """Mean power per sample, shape (n, 1)."""
    power = np.mean(folded.real**2 + folded.imag**2, axis=1, keepdims=True)
    return np.maximum(power, np.finfo(np.float32).tiny)
