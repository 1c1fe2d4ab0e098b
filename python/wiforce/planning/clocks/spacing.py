# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines of many possible clocks at once: distances, overlaps, and how many clocks fit.

The strong lines of a tag are 1, 2 and 4 (docs/theory.md), so two tags are separate where these lie
apart; all pairs follow from the ratios 1, 2 and 4 of the clocks. Weaker lines may coincide, since
the ends are solved jointly: what that costs is the overlap of the waveforms.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ...errors import InputError
from ...signal.waveform import Waveform

Pulses = Sequence[tuple[float, float]]


def double_rate_pulses(duty1: float = 0.25, duty2: float = 0.25) -> tuple[Pulses, Pulses]:
    """On-intervals of switch 1 and 2, in cycles of fs: the scheme of the WiForce paper.

    Clock 2 at twice the frequency, its pulses midway between those of clock 1. Refuses duty cycles
    outside (0, 1), and pulses that overlap.
    """
    _check_duties(duty1, duty2)
    if duty1 / 2 + duty2 / 4 > 1 / 4:
        rule = "2 duty1 + duty2 must be at most 1: the two switches are never on together"
        raise InputError("duty2", rule, duty2)
    return (_pulse(0.0, duty1),), (_pulse(0.25, duty2 / 2), _pulse(0.75, duty2 / 2))


def one_rate_pulses(
    duty1: float = 0.25, duty2: float = 0.25, delay: float = 0.5
) -> tuple[Pulses, Pulses]:
    """On-intervals of switch 1 and 2 of clocks at fs, the second later by ``delay`` cycles.

    The ends share all lines; they differ in how a line's phase depends on its number. Refuses
    parameters outside (0, 1), and pulses that overlap.
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
    """Fourier coefficients of one switch at harmonics m of fs, averaged over fs Ta cycles.

    c[m] = sum over pulses of width sinc(m width) exp(-j 2 pi m center), times sinc(m fs Ta).
    """
    m = np.asarray(m)
    total = np.zeros(m.shape, complex)
    for on, off in pulses:
        total += (off - on) * np.sinc(m * (off - on)) * np.exp(-1j * np.pi * m * (on + off))
    return total * np.sinc(m * averaging_cycles)


def switch_waveform(pulses: Pulses, cycles: ArrayLike, window_cycles: float) -> np.ndarray:
    """Part (n,) of each window, centred at these cycles of the clock and fs Ta long, in which a
    switch is on.
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


# Lines of two tags: strong lines at the same number, or at numbers 1:2 and 1:4. Other pairs of
# lines 1, 2 and 4 are multiples of these.
_PAIRS = np.array([(1, 1), (1, 2), (2, 1), (1, 4), (4, 1)], float)
# Lines whose overlaps are added up; line 16 is 24 dB below line 1.
_HARMONICS = 16


def line_distances_hz(
    one_hz: np.ndarray, other_hz: np.ndarray, tolerance_ppm: float = 0.0
) -> np.ndarray:
    """Least distance of strong lines of two tags, at the worst errors of both clocks, in Hz.

    0 where the lines may coincide; the clocks are broadcast against each other.
    """
    a, b = _PAIRS.T
    ours = np.multiply.outer(one_hz, a)
    others = np.multiply.outer(other_hz, b)
    wander = 1e-6 * tolerance_ppm * (ours + others)
    return np.maximum(np.min(np.abs(ours - others) - wander, axis=-1), 0.0)


@dataclass(frozen=True)
class LineTable:
    """Lines of a list of C clocks, which may be off by ``tolerance_ppm``, as snapshots show
    them.
    """

    clocks_hz: np.ndarray
    waveform: Waveform
    group_length: int
    pulses: tuple[Pulses, Pulses]
    tolerance_ppm: float

    @cached_property
    def _amplitudes(self) -> np.ndarray:
        """Of the lines, for waveforms of unit power; shape (C, 2, harmonics)."""
        m = np.arange(1, _HARMONICS + 1)
        averaged = self.clocks_hz[:, None] * self.waveform.averaging_s
        lines = np.stack([np.abs(line_coefficients(p, m)) for p in self.pulses])
        lines = lines * np.abs(np.sinc(averaged * m))[:, None, :]
        return lines / np.sqrt(np.sum(lines**2, axis=-1, keepdims=True))

    def overlaps(self, index: int, chosen: np.ndarray | None = None) -> np.ndarray:
        """Share of an end's power that an end of another tag may explain, at the worst clock
        phases.

        (C', 2, 2), by end of each ``chosen`` tag and end of the tag ``index``, whose overlap with
        itself is that of its lines of different numbers, where one of them is aliased.
        """
        rows = np.arange(len(self.clocks_hz)) if chosen is None else chosen
        m = np.arange(1, _HARMONICS + 1)
        ours = self.clocks_hz[rows, None, None] * m[:, None]
        others = self.clocks_hz[index] * m
        total = np.zeros((len(rows), 2, 2))
        for sign in (1, -1):
            near = self._near(ours - sign * others, ours + others)
            if sign == 1:
                near[rows == index] *= 1 - np.eye(_HARMONICS)
            total += self._amplitudes[rows] @ near @ self._amplitudes[index].T
        return np.minimum(total, 1.0) ** 2

    def noise_gain(self, frequencies_hz: np.ndarray) -> float:
        """Noise of the worst tone when tones are separated by least squares, over that of a
        Fourier sum.
        """
        cycles = np.subtract.outer(frequencies_hz, frequencies_hz)
        cycles *= np.pi * self.waveform.snapshot_period_s
        np.fill_diagonal(cycles, np.pi / 2)
        overlap = np.sin(self.group_length * cycles) / (self.group_length * np.sin(cycles))
        np.fill_diagonal(overlap, 1.0)
        try:
            return float(np.max(np.diag(np.linalg.inv(overlap))))
        except np.linalg.LinAlgError:
            return np.inf

    def _near(self, apart_hz: np.ndarray, wander_hz: np.ndarray) -> np.ndarray:
        """1 for lines that coincide, 0 for those a bin or more apart."""
        rate = 1 / self.waveform.snapshot_period_s
        apart = np.abs((apart_hz + rate / 2) % rate - rate / 2)
        apart = np.maximum(apart - 1e-6 * self.tolerance_ppm * wander_hz, 0)
        return np.maximum(1 - apart * self.group_length / rate, 0)


def count_that_fit(conflicts: np.ndarray, free: np.ndarray, start: int = 0) -> int:
    """How many clocks of one octave can be used together, the first free one after ``start`` among
    them.

    ``conflicts`` (C, C) are pairs of clocks, ascending within an octave, that are too near to each
    other. Clocks of an octave conflict with their neighbours only, so that the nearest one which is
    possible is never a wrong choice. The octave is a circle, since the lines of its lowest clock
    lie beside those of its highest.
    """
    open_ = np.roll(free, -start)
    turned = np.roll(conflicts, (-start, -start), axis=(0, 1))
    count = 0
    while open_.any():
        open_ = open_ & ~turned[np.argmax(open_)]
        count += 1
    return count


def most_that_fit(conflicts: np.ndarray, free: np.ndarray) -> int:
    """The largest of :func:`count_that_fit` over all starts."""
    if not free.any():
        return 0
    first = int(np.argmax(free))
    # Whatever the best choice is, it has a clock that conflicts with the first free one or is it.
    starts = np.flatnonzero(free & (conflicts[first] | (np.arange(len(free)) == first)))
    return max(count_that_fit(conflicts, free, int(start)) for start in starts)
