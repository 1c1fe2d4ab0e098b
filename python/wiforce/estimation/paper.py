# SPDX-License-Identifier: GPL-3.0-or-later
"""The published estimator: one line per end, no clock tracking. For comparison."""

import numpy as np

from .state import ClockState, GroupState
from .tag_clock import harmonics


class PaperSeparator:
    """End 1 from line +1 of each tag, end 2 from line +4, as they come (paper, section 3.3).

    Same interface as :class:`separation.EndSeparator`. The tag's clock stays in the result: a
    constant offset turns end 1 by 2 pi fs o and end 2 by four times that. With the groups
    compared one to the next, phases add up over a run.

    Parameters
    ----------
    table : ToneTable
    clocks : sequence of TagClock
    averaging_s : float
    bins : ndarray of int
    sample_rate_hz : float, optional
        Has no effect on phases.
    """

    def __init__(self, table, clocks, averaging_s, bins, sample_rate_hz=None):
        self.table = table
        self.bins = np.asarray(bins)
        self.ends = 2 * len(clocks)
        self._period = table.group_length * table.snapshot_period_s
        self._clocks = clocks
        self._rows = [self._row(tag, m) for tag in range(len(clocks)) for m in (1, 4)]
        self._reference_gain = harmonics(1, clocks[0].clock_hz * averaging_s)[0] ** 2

    def _row(self, tag, harmonic):
        for row, tone in enumerate(self.table.tones):
            if (tag, harmonic) in tone.owners:
                return row
        raise ValueError(f"line {harmonic} of tag {tag} is not in the table")

    def process(self, group, tones, missing=0, partial=None):
        """One group's vectors at once; snapshots that are missing count as zeros."""
        tones = np.asarray(tones)[:, self.bins].astype(complex)
        vectors = np.zeros((self.ends, 64), complex)
        center_s = (group + 0.5) * self._period
        for end, row in enumerate(self._rows):
            turns = self.table.tones[row].frequency_hz * center_s
            vectors[end, self.bins] = tones[row] * np.exp(-2j * np.pi * (turns % 1.0))
        usable = bool(np.all(np.isfinite(tones)) and np.any(tones))
        gain = np.sum(np.abs(self.table.weights[self._rows]) ** 2, axis=1)
        gain = gain if usable else np.full(self.ends, np.inf)
        snr = np.full(self.ends, np.nan)
        clocks = (ClockState(usable),) * len(self._clocks)
        noise = np.ones(len(self.bins))
        return [(GroupState(group, missing, clocks, noise, gain, snr), vectors)]

    def flush(self):
        """Nothing is held back."""
        return []
