# SPDX-License-Identifier: GPL-3.0-or-later
"""Two receive antennas on one oscillator: their ratio is free of the oscillator's phase."""

from __future__ import annotations

import numpy as np

from ..signal.waveform import FFT_LENGTH, Waveform
from .groups import Array


def channel_ratio(first: Array, second: Array) -> Array:
    """H_1 / H_2 per snapshot and subcarrier.

    A transmitter and a receiver on clocks of their own turn every snapshot by a phase that both
    antennas share: H_a = exp(j phi) (S_a + r T_a), S_a what stands still and r T_a the tag. In
    the ratio the phase is gone, and it is linear in r while the tag is weak beside the static
    path; what is left of higher order turns a reading by up to 2 |T|/|S|. (Ratios of antennas:
    Y. Zeng et al., FarSense, 2019.)

    One antenna does not allow that: divided by its own static path, the part of the tag in
    quadrature with it is taken for a turn of the oscillator.

    Parameters
    ----------
    first, second : ndarray of complex, shape (n, K)

    Returns
    -------
    ndarray of complex, shape (n, K)
        0 where the second antenna hears nothing.
    """
    heard = np.abs(second) > 0
    return np.divide(first, second, out=np.zeros_like(first), where=heard)


def folded_ratio(first: Array, second: Array, waveform: Waveform) -> Array:
    """The ratio of two antennas' channels, folded as if one antenna had received it.

    The sounding symbol cancels in the ratio and is put back, so that what comes out is read as
    the folded frames of a single antenna are.

    Parameters
    ----------
    first, second : ndarray of complex, shape (n, 64)
        Folded frames.
    waveform : Waveform

    Returns
    -------
    ndarray of complex, shape (n, 64)
    """
    bins = waveform.bins
    channels = [np.fft.fft(folded, axis=1)[:, bins] for folded in (first, second)]
    spectrum = np.zeros((len(first), FFT_LENGTH), complex)
    spectrum[:, bins] = channel_ratio(*channels) / waveform.equalizer()[bins]
    return np.fft.ifft(spectrum, axis=1)
