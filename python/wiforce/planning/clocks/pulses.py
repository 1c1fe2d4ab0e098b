# SPDX-License-Identifier: GPL-3.0-or-later
"""Pulse schemes of a tag's two switches, their spectra and waveforms as snapshots see them.

A switch is given by its *pulses*: on-intervals in cycles of the tag's clock fs.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ...errors import InputError

Pulses = Sequence[tuple[float, float]]


def double_rate_pulses(duty1: float = 0.25, duty2: float = 0.25) -> tuple[Pulses, Pulses]:
    """Clock 2 at twice the frequency, its pulses midway between those of clock 1.

    The scheme of the WiForce paper.

    Returns tuple of (tuple of (on, off)): on-intervals of switch 1 and 2, in cycles of fs.

    Parameters
    ----------
    duty1, duty2 : float
        Duty cycles of clock 1 at fs and clock 2 at 2 fs, in (0, 1).

    Raises
    ------
    InputError
        For a duty cycle out of range, or pulses that overlap: both switches on together.
    """
    _check_duties(duty1, duty2)
    if duty1 / 2 + duty2 / 4 > 1 / 4:
        rule = "2 duty1 + duty2 must be at most 1: the two switches are never on together"
        raise InputError("duty2", rule, duty2)
    return (_pulse(0.0, duty1),), (_pulse(0.25, duty2 / 2), _pulse(0.75, duty2 / 2))


def one_rate_pulses(
    duty1: float = 0.25, duty2: float = 0.25, delay: float = 0.5
) -> tuple[Pulses, Pulses]:
    """Both clocks at fs, clock 2 later by ``delay`` cycles.

    The ends share all lines; they differ in how a line's phase depends on its number.

    Returns tuple of (tuple of (on, off)): on-intervals of switch 1 and 2, in cycles of fs.

    Parameters
    ----------
    duty1, duty2 : float
        Duty cycles, in (0, 1).
    delay : float
        In cycles, in (0, 1).

    Raises
    ------
    InputError
        For a parameter out of range, or pulses that overlap: both switches on together.
    """
    _check_duties(duty1, duty2)
    if not 0 < delay < 1:
        raise InputError("delay", "must lie between 0 and 1 cycle", delay)
    if min(delay, 1 - delay) < (duty1 + duty2) / 2:
        rule = "must be (duty1 + duty2) / 2 or more: the two switches are never on together"
        raise InputError("delay", rule, delay)
    return (_pulse(0.0, duty1),), (_pulse(delay, duty2),)


def _check_duties(*duties: float) -> None:
    for i, duty in enumerate(duties):
        if not 0 < duty < 1:
            raise InputError(f"duty{i + 1}", "must lie between 0 and 1", duty)


def _pulse(center: float, width: float) -> tuple[float, float]:
    return center - width / 2, center + width / 2


def line_coefficients(pulses: Pulses, m: ArrayLike, averaging_cycles: float = 0.0) -> np.ndarray:
    """Fourier coefficients of one switch at harmonics of fs.

    Returns ndarray of complex, shape of ``m``.

    Parameters
    ----------
    pulses : sequence of (on, off)
        In cycles.
    m : array_like of int, any shape
        Harmonic numbers.
    averaging_cycles : float
        fs Ta: what a snapshot averages over.

    Notes
    -----
    c[m] = sum over pulses of width sinc(m width) exp(-j 2 pi m center), times sinc(m fs Ta).
    """
    m = np.asarray(m)
    total = np.zeros(m.shape, complex)
    for on, off in pulses:
        total += (off - on) * np.sinc(m * (off - on)) * np.exp(-1j * np.pi * m * (on + off))
    return total * np.sinc(m * averaging_cycles)


def switch_waveform(pulses: Pulses, cycles: ArrayLike, window_cycles: float) -> np.ndarray:
    """Part of each window in which a switch is on.

    Returns ndarray of float, shape (n,): in 0..1.

    Parameters
    ----------
    pulses : sequence of (on, off)
        In cycles.
    cycles : array_like of float, shape (n,)
        Clock at the windows' centres, in cycles.
    window_cycles : float
        Length of the windows, fs Ta.
    """
    cycles = np.asarray(cycles, float)
    total = np.zeros(cycles.shape)
    for on, off in pulses:
        start, end = (cycles + side * window_cycles / 2 - on for side in (-1, 1))
        total += _on_time(end, off - on) - _on_time(start, off - on)
    return total / window_cycles


def _on_time(cycles: np.ndarray, width: float) -> np.ndarray:
    """How long a pulse that begins each cycle has been on since cycle 0, in cycles."""
    whole = np.floor(cycles)
    return whole * width + np.minimum(cycles - whole, width)
