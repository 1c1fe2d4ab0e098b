# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines of many possible clocks at once: distances, overlaps, and how many clocks fit.

The strong lines of a tag are 1, 2 and 4 (docs/theory.md), so two tags are separate where these lie
apart; all pairs follow from the ratios 1, 2 and 4 of the clocks. Weaker lines may coincide, since
the ends are solved jointly: what that costs is the overlap of the waveforms.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...signal.waveform import Waveform
from .pulses import Pulses, line_coefficients

# Lines of two tags: strong lines at the same number, or at numbers 1:2 and 1:4. Other pairs of
# lines 1, 2 and 4 are multiples of these.
_PAIRS = np.array([(1, 1), (1, 2), (2, 1), (1, 4), (4, 1)], float)
# Lines whose overlaps are added up; line 16 is 24 dB below line 1.
_HARMONICS = 16


def line_distances_hz(
    one_hz: np.ndarray, other_hz: np.ndarray, tolerance_ppm: float = 0.0
) -> np.ndarray:
    """Least distance of strong lines of two tags, at the worst errors of both clocks.

    Returns ndarray of float: in Hz; 0 where the lines may coincide.

    Parameters
    ----------
    one_hz, other_hz : ndarray of float
        Clocks, in Hz; broadcast against each other.
    tolerance_ppm : float
        How far each clock may be off.
    """
    a, b = _PAIRS.T
    ours = np.multiply.outer(one_hz, a)
    others = np.multiply.outer(other_hz, b)
    wander = 1e-6 * tolerance_ppm * (ours + others)
    return np.maximum(np.min(np.abs(ours - others) - wander, axis=-1), 0.0)


@dataclass(frozen=True)
class LineTable:
    """Lines of a list of clocks as snapshots show them.

    Attributes
    ----------
    clocks_hz : ndarray of float, shape (C,)
    waveform : Waveform
        Gives snapshot period and averaging time.
    group_length : int
        Snapshots per phase group.
    pulses : tuple
        On-intervals of the two switches.
    tolerance_ppm : float
        How far each clock may be off.
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
        """Share of an end's power that an end of another tag may explain.

        Returns ndarray of float, shape (C', 2, 2): at the worst clock phases; by end of each tag
        and end of the other.

        Parameters
        ----------
        index : int
            The other tag.
        chosen : ndarray of int, shape (C',), optional
            Tags to compare with it; all by default. Its overlap with itself is that of its lines
            of different numbers, where one of them is aliased.
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
        """Noise of the worst tone when tones are separated by least squares.

        Returns float: relative to that of a Fourier sum over a phase group.

        Parameters
        ----------
        frequencies_hz : ndarray of float, shape (M,)
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
    """How many clocks of one octave can be used together.

    Returns int: the most that are possible after ``start``: clocks of an octave conflict with their
    neighbours only, so that the nearest one which is possible is never a wrong choice.

    Parameters
    ----------
    conflicts : ndarray of bool, shape (C, C)
        Which pairs of clocks, ascending within an octave, are too near to each other.
    free : ndarray of bool, shape (C,)
        Those that may be used.
    start : int
        A clock is taken at the first free one from here on; the octave is a circle, since the
        lines of its lowest clock lie beside those of its highest.
    """
    open_ = np.roll(free, -start)
    turned = np.roll(conflicts, (-start, -start), axis=(0, 1))
    count = 0
    while open_.any():
        open_ = open_ & ~turned[np.argmax(open_)]
        count += 1
    return count


def most_that_fit(conflicts: np.ndarray, free: np.ndarray) -> int:
    """The largest of :func:`count_that_fit` over all starts.

    Parameters
    ----------
    conflicts, free
        As in :func:`count_that_fit`.
    """
    if not free.any():
        return 0
    first = int(np.argmax(free))
    # Whatever the best choice is, it has a clock that conflicts with the first free one or is it.
    starts = np.flatnonzero(free & (conflicts[first] | (np.arange(len(free)) == first)))
    return max(count_that_fit(conflicts, free, int(start)) for start in starts)
