# SPDX-License-Identifier: GPL-3.0-or-later
"""Doppler spectrum of a capture, for a picture."""

import numpy as np

_LENGTH = 5000  # snapshots per section
_KAISER_BETA = 14  # side lobes below -100 dB, so that a strong static path hides no line


def doppler_spectrum(channels, snapshot_period_s):
    """Average power spectrum over subcarriers and sections of a capture.

    Parameters
    ----------
    channels : ndarray of complex, shape (N, K)
        See `snapshot_channels`.
    snapshot_period_s : float

    Returns
    -------
    dict
        ``hz``, from minus to plus half the snapshot rate, and ``db``; empty lists for a capture
        shorter than one section.
    """
    sections = len(channels) // _LENGTH
    if not sections:
        return {"hz": [], "db": []}
    window = np.kaiser(_LENGTH, _KAISER_BETA)[:, None]
    power = np.zeros(_LENGTH)
    for number in range(sections):
        section = channels[number * _LENGTH : (number + 1) * _LENGTH]
        lines = np.fft.fft(section * window, axis=0) / window.sum()
        power += np.mean(np.abs(lines) ** 2, axis=1) / sections
    level = 10 * np.log10(np.maximum(power, 1e-30))
    hz = np.fft.fftfreq(_LENGTH, snapshot_period_s)
    return {
        "hz": np.fft.fftshift(hz).round(2).tolist(),
        "db": np.fft.fftshift(level).round(2).tolist(),
    }
