# SPDX-License-Identifier: GPL-3.0-or-later
"""Narrow lines in a spectrum with the Blackman-Harris window.

F. Harris, "On the use of windows for harmonic analysis", Proc. IEEE 66, 1978.
"""

import numpy as np

from ..groups import Array
from .clock_lines import vertex
from .sources import RoomLine

# Terms of the window, and its equivalent noise bandwidth in bins, n sum w^2 / (sum w)^2.
_TERMS = (0.35875, -0.48829, 0.14128, -0.01168)
ENBW = (_TERMS[0] ** 2 + sum(a**2 for a in _TERMS[1:]) / 2) / _TERMS[0] ** 2
# Half width of the window's main lobe, in bins; its side lobes are at -92 dB.
LOBE_BINS = 4.5
# A line whose surroundings hold this many times its power is not a line.
_BROAD = 1.6


def blackman_harris(count: int) -> Array:
    """The window.

    Returns ndarray of float, shape (n,).

    Parameters
    ----------
    count : int
        Number of samples, n.
    """
    phase = 2 * np.pi * (np.arange(count) + 0.5) / count
    window: Array = sum(a * np.cos(i * phase) for i, a in enumerate(_TERMS))
    return window


def take_lines(frequency_hz: Array, spectrum: Array, excess: Array, count: int) -> list[RoomLine]:
    """Take narrow lines out of a spectrum; what is broader than the window stays.

    Returns list of RoomLine: the strongest first.

    Parameters
    ----------
    frequency_hz, spectrum : ndarray, shape (F,)
        As those of a :class:`.survey.Survey`.
    excess : ndarray, shape (F,)
        Likewise; what belongs to lines is set to 0.
    count : int
        Number of samples of the spectrum.
    """
    lines = []
    reach = int(LOBE_BINS)
    for best in np.argsort(excess)[::-1]:
        if excess[best] <= 0 or not 0 < best < len(excess) - 1:
            continue
        if spectrum[best] < max(spectrum[best - 1], spectrum[best + 1]):
            continue  # the slope of a broader one
        lobe = slice(max(best - reach, 0), best + reach + 1)
        offset, top = vertex(spectrum, best)
        power = (top - 1) * ENBW / count
        if excess[lobe].sum() > _BROAD * power:
            continue
        frequency = (best + offset) * float(frequency_hz[1])
        lines.append(RoomLine(float(frequency), float(power)))
        excess[lobe] = 0
    return lines
