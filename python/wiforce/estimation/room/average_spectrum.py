# SPDX-License-Identifier: GPL-3.0-or-later
"""Doppler spectrum of a whole recording, averaged over its sections."""

from __future__ import annotations

import numpy as np

from ..groups import Array

_LENGTH = 5000  # snapshots per section
_KAISER_BETA = 14  # side lobes below -100 dB, so that a strong static path hides no line


def average_spectrum(channel: Array, snapshot_period_s: float) -> tuple[Array, Array]:
    """Power over Doppler frequency, averaged over subcarriers and sections (Welch's method).

    Returns frequency_hz, level_db (ndarray, shape (5000,)): from minus to plus half the snapshot
    rate; a line of amplitude 1 has 0 dB. Both are empty for fewer than 5000 snapshots.

    Parameters
    ----------
    channel : ndarray of complex, shape (N, K)
        H of consecutive snapshots.
    """
    sections = len(channel) // _LENGTH
    if not sections:
        return np.zeros(0), np.zeros(0)
    window = np.kaiser(_LENGTH, _KAISER_BETA)[:, None]
    power = np.zeros(_LENGTH)
    # Section by section, since the transform of all of them would need several times the memory.
    for section in channel[: sections * _LENGTH].reshape(sections, _LENGTH, -1):
        lines = np.fft.fft(section * window, axis=0) / window.sum()
        power += np.mean(np.abs(lines) ** 2, axis=1) / sections
    frequency_hz = np.fft.fftshift(np.fft.fftfreq(_LENGTH, snapshot_period_s))
    return frequency_hz, np.fft.fftshift(10 * np.log10(np.maximum(power, 1e-30)))
