# SPDX-License-Identifier: GPL-3.0-or-later
"""The two switching waveforms of a tag, as a channel snapshot sees them: averaged.

Clock 1 runs at fs with 25 % duty, high for phases within +-pi/4 of 0. Clock 2 runs at 2 fs with
25 % duty: pulses pi/4 wide centred at +-pi/2 of clock 1's phase. A snapshot averages both over
the time Ta of the folded samples. The simulator has a model of its own (:mod:`..simulation.tag`).
"""

import numpy as np
from numpy.typing import ArrayLike

from .waveform import Waveform

# Duty cycles of clocks 1 and 2, as parts of their own periods.
DUTY = (0.25, 0.25)


def harmonics(
    m: ArrayLike, averaging_phase: float | np.ndarray = 0.0, duty: tuple[float, float] = DUTY
) -> np.ndarray:
    """Fourier coefficients c1[m] and c2[m], (..., 2), of both switches, averaged over Ta.

    ``averaging_phase`` is fs Ta, ``duty`` holds d1 and d2:
    c1[m] = d1 sinc(m d1) sinc(m fs Ta); c2[m] = d2 sinc(m d2/2) cos(pi m/2) sinc(m fs Ta), 0 for
    odd m. With duties of 1/4 end 1 is alone at m = +-1, end 2 at m = +-4.
    """
    m = np.asarray(m)
    smear = np.sinc(m * averaging_phase)
    c1 = duty[0] * np.sinc(m * duty[0]) * smear
    pulse = duty[1] * np.sinc(m * (duty[1] / 2))
    c2 = np.where(m % 2 == 0, pulse * np.cos(np.pi * m / 2), 0.0) * smear
    return np.stack([c1, c2], axis=-1)


def line_envelope(m: ArrayLike, clock_hz: float, waveform: Waveform) -> np.ndarray:
    """Upper limit (M,) of the power of a tag's harmonics in the snapshots, over line 1 of end 1.

    One that is faster than a symbol is averaged, but around multiples of the subcarrier spacing.
    """
    m = np.asarray(m)
    spacing_hz = waveform.spacing_hz
    distance_hz = np.abs(m * clock_hz - spacing_hz * np.rint(m * clock_hz / spacing_hz))
    rolled = np.maximum(np.pi * distance_hz * waveform.averaging_s, 1.0)
    # Pulses of 1/8 and 1/4 period: 2 / (pi m) at most, relative to c1[1] = 0.225.
    edges = 2 / (np.pi * np.maximum(m, 1)) / harmonics(1)[0]
    return np.minimum(edges, 1.0) ** 2 / rolled**2


def switch_averages(
    phase: np.ndarray,
    half_window: float | np.ndarray,
    clock2_delay: float = 0.0,
    duty: tuple[float, float] = DUTY,
) -> np.ndarray:
    """Averages (..., n, 2) of s1 and s2, in 0..1, over windows of clock phases (..., n) in rad.

    Half a window, pi fs Ta, is at most pi/8, half the width of the narrower pulse; clock 2 comes
    late by ``clock2_delay`` rad of clock 1.
    """
    return switch_averages_and_slopes(phase, half_window, clock2_delay, duty)[0]


def switch_averages_and_slopes(
    phase: np.ndarray,
    half_window: float | np.ndarray,
    clock2_delay: float = 0.0,
    duty: tuple[float, float] = DUTY,
) -> tuple[np.ndarray, np.ndarray]:
    """:func:`switch_averages` and their derivatives by phase, (..., n, 2); 0 without an edge."""
    # From the nearest pulse's centre, and half a window, in cycles of each clock's own.
    cycles = np.multiply.outer(phase, [0.5 / np.pi, 1 / np.pi]) - (0, 0.5 + clock2_delay / np.pi)
    cycles -= np.rint(cycles)
    half_window = np.asarray(half_window)[..., None, None]
    half = half_window * (0.5 / np.pi, 1 / np.pi)
    # A window that is shorter than pulse and gap sees one edge at most: the average is a ramp.
    averages = np.clip((np.array(duty) / 2 + half - np.abs(cycles)) / (2 * half), 0, 1)
    # Both clocks' ramps are as steep: the second runs twice as fast and so does its window.
    at_edge = (averages > 0) & (averages < 1)
    return averages, np.where(at_edge, np.sign(cycles) * (-0.5 / half_window), 0)


def duty_slopes(slopes: np.ndarray) -> np.ndarray:
    """Derivatives of s1 and s2 by their duty cycles, which move both edges, from the slopes."""
    return np.abs(slopes) * (np.pi, np.pi / 2)
