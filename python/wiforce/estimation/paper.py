# SPDX-License-Identifier: GPL-3.0-or-later
"""The published estimator, and the sideband product: no clock is tracked. For comparison.

Same interface as :class:`separation.EndSeparator`.
"""

import numpy as np

from ..errors import InputError
from ..signal.switching import harmonics
from .state import ClockState, GroupState

# Lines on which the paper reads end 1 and end 2.
_LINES = (1, 4)
_NOISE_GROUPS = 64


class _LineReader:
    """Lines +-1 and +-4 of every tag, and the noise that the pairs betray."""

    def __init__(self, table, clocks, averaging_s, bins, sample_rate_hz=None):
        self.table = table
        self.bins = np.asarray(bins)
        self.ends = 2 * len(clocks)
        self._period = table.group_length * table.snapshot_period_s
        self._tags = len(clocks)
        pairs = [(tag, m) for tag in range(len(clocks)) for m in _LINES]
        self._upper = [self._row(tag, m) for tag, m in pairs]
        self._lower = [self._row(tag, -m) for tag, m in pairs]
        self._hertz = np.array([[table.tones[row].frequency_hz] for row in self._upper])
        coefficients = [
            harmonics(m, clocks[tag].clock_hz * averaging_s)[_LINES.index(m)] for tag, m in pairs
        ]
        self._coefficients = np.array(coefficients)[:, None]
        self._reference_gain = self._coefficients[0, 0] ** 2
        self._noise_level, self._noise_groups = 0.0, 0

    def _row(self, tag, harmonic):
        for row, tone in enumerate(self.table.tones):
            if (tag, harmonic) in tone.owners:
                return row
        raise InputError("harmonics", f"must leave line {harmonic} of tag {tag} in the table")

    def process(self, group, tones, missing=0, partial=None):
        """One group's vectors at once; see :meth:`separation.EndSeparator.process`."""
        weights = (self.table if partial is None else partial).weights
        tones = np.asarray(tones)[:, self.bins].astype(complex)
        usable = bool(np.isfinite(tones.sum()) and tones.any())
        usable = usable and (partial is not None or not missing)
        vectors = np.zeros((self.ends, 64), complex)
        gain, snr = np.full(self.ends, np.inf), np.full(self.ends, np.nan)
        if usable:
            turns = self._hertz * (group + 0.5) * self._period % 1.0
            turn = np.exp(-2j * np.pi * turns)
            upper = tones[self._upper] * turn / self._coefficients
            lower = tones[self._lower] * turn.conj() / self._coefficients
            line_gain = np.sum(np.abs(weights[self._upper]) ** 2, axis=1)
            line_gain = line_gain / self._coefficients[:, 0] ** 2
            self._learn_noise(upper, lower, line_gain)
            values, gain, power = self._read(upper, lower, line_gain)
            vectors[:, self.bins] = values
            ratio = self._reference_gain * power / self._noise_level
            snr = 10 * np.log10(np.maximum(ratio, 1e-12))
        clocks = (ClockState(usable),) * self._tags
        noise = np.full(len(self.bins), max(self._noise_level, 1e-300))
        return [(GroupState(group, missing, clocks, noise, gain, snr), vectors)]

    def flush(self):
        """Nothing is held back."""
        return []

    def _learn_noise(self, upper, lower, gain):
        """Both lines of a pair show the same channel: what differs is noise."""
        product = np.sum(upper * lower.conj(), axis=1)
        half = np.exp(0.5j * np.angle(product))[:, None]
        apart = np.abs(upper * half.conj() - lower * half) ** 2 / 2
        level = np.mean(apart / gain[:, None]) * len(self.bins) / (len(self.bins) - 1)
        self._noise_groups = min(self._noise_groups + 1, _NOISE_GROUPS)
        self._noise_level += (level - self._noise_level) / self._noise_groups
        self._noise_level = max(self._noise_level, 1e-300)

    def _read(self, upper, lower, gain):
        """Values of the ends, their variance over that of H, and the power of the channels."""
        raise NotImplementedError


class PaperSeparator(_LineReader):
    """End 1 from line +1 of each tag, end 2 from line +4, as they come (paper, section 3.3).

    The tag's clock stays in the result: a constant offset o turns end 1 by 2 pi fs o per second
    and end 2 by four times that. The paper compares each group with the one before; the changes
    add up over a run.

    Parameters
    ----------
    table : ToneTable
    clocks : sequence of TagClock
    averaging_s : float
    bins : ndarray of int
    sample_rate_hz : float, optional
        Has no effect on phases.
    """

    def _read(self, upper, lower, gain):
        power = np.mean(np.abs(upper) ** 2, axis=1) - gain * self._noise_level
        return upper, gain, power


class SidebandSeparator(_LineReader):
    """The square of each end's channel, P(+m) P(-m), in which the clock's phase cancels.

    Half the angle of what follows from it is the end's phase, but for half a turn.

    Parameters
    ----------
    table : ToneTable
    clocks : sequence of TagClock
    averaging_s : float
    bins : ndarray of int
    sample_rate_hz : float, optional
        Has no effect on phases.
    """

    def _read(self, upper, lower, gain):
        noise = gain * self._noise_level
        power = (np.mean(np.abs(upper) ** 2, axis=1) + np.mean(np.abs(lower) ** 2, axis=1)) / 2
        # A product's noise grows with it: what counts is the mean over the product's own energy.
        squares = upper * lower
        energy = np.abs(squares) ** 2
        level = np.sum(np.abs(squares) * energy, axis=1) / np.sum(energy, axis=1)
        variance = 2 * level * noise + noise**2
        return squares, variance / self._noise_level, power - noise
