# SPDX-License-Identifier: GPL-3.0-or-later
"""The published estimator and the sideband product, for comparison; neither tracks the clock."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import InputError
from ...signal.switching import harmonics
from ...signal.waveform import Waveform
from ...signal.weights import ToneTable
from ..clocks.tracked_tag import TagClock
from ..groups import Array, Groups

# Lines on which the paper reads end 1 and end 2 (section 3.2).
_LINES = (1, 4)
# Groups that the noise is averaged over: 2.3 s of default groups, as in noise_estimate.h.
_NOISE_GROUPS = 64
# Noise is divided by, and may be absent in simulations.
_LEAST_NOISE = 1e-300


class LineSeparator:
    """Reads end 1 on line 1 of each tag, and end 2 on line 4 (paper, section 3.2).

    Has the interface of :class:`.EndSeparator`, and acquires no clock. The noise is learned from
    the difference of lines +m and -m, which have the same channel. ``squared`` gives the product
    P(+m) P(-m), the square of each end's channel, instead of P(+m). Refused when the table lacks a
    line of a tag.

    P(+m) contains the rotation of the tag's clock: a constant offset o rotates end 1 by 2 pi fs o
    per second and end 2 by four times that. The paper compares each group with the previous one;
    the changes accumulate over a run. In the product the clock's phase cancels. Half the angle of
    the resulting ratio is the change of the end's phase, modulo 180 deg.
    """

    acquisition_groups = 0

    def __init__(
        self,
        table: ToneTable,
        clocks: Sequence[TagClock],
        waveform: Waveform,
        derotated: bool = True,
        squared: bool = False,
    ) -> None:
        self._table, self._squared = table, squared
        self._period_s = table.group_length * table.snapshot_period_s
        self._tags = len(clocks)
        pairs = [(tag, end) for tag in range(len(clocks)) for end in range(len(_LINES))]
        self._upper = [self._row(tag, _LINES[end]) for tag, end in pairs]
        self._lower = [self._row(tag, -_LINES[end]) for tag, end in pairs]
        self._hertz = np.array([[table.tones[row].frequency_hz] for row in self._upper])
        coefficients = [
            harmonics(_LINES[end], clocks[tag].clock_hz * waveform.averaging_s)[end]
            for tag, end in pairs
        ]
        self._coefficients = np.array(coefficients)[:, None]
        self._line_power = self._coefficients[0, 0] ** 2
        self._noise_level, self._noise_groups = _LEAST_NOISE, 0

    def _row(self, tag: int, harmonic: int) -> int:
        for row, tone in enumerate(self._table.tones):
            if (tag, harmonic) in tone.owners:
                return row
        raise InputError("harmonics", f"must leave line {harmonic} of tag {tag} in the table")

    def process(self, groups: Groups) -> Groups:
        """Separate a batch; see :meth:`separation.EndSeparator.process`."""
        if not len(groups):
            return groups
        count, _, subcarriers = groups.tones.shape
        ends = np.zeros((count, 2 * self._tags, subcarriers), complex)
        gain = np.full((count, 2 * self._tags), np.inf)
        snr_db = np.full((count, 2 * self._tags), np.nan)
        noise = np.zeros((count, subcarriers))
        usable = np.zeros(count, bool)
        for row in range(count):
            tones = groups.tones[row].astype(complex)
            weights = self._weights(groups, row)
            usable[row] = np.isfinite(tones.sum()) and tones.any() and weights is not None
            if usable[row] and weights is not None:
                ends[row], gain[row], power = self._take(int(groups.index[row]), tones, weights)
                ratio = self._line_power * power / self._noise_level
                snr_db[row] = 10 * np.log10(np.maximum(ratio, 1e-12))
            noise[row] = self._noise_level
        nominal = np.zeros((count, self._tags))
        return groups.having(
            tones=None,
            snapshot_weights=None,
            ends=ends,
            gain=gain,
            noise=noise,
            snr_db=snr_db,
            locked=np.tile(usable[:, None], self._tags),
            clock_phase=nominal,
            clock_offset_ppm=nominal,
            clock2_delay=nominal,
            overlapping=nominal > 0,
        )

    def flush(self) -> Groups:
        """Give an empty batch: no groups are held back."""
        return Groups(np.zeros(0, np.int64))

    def _weights(self, groups: Groups, row: int) -> Array | None:
        """Weights that a group's tones were computed with; None when they cannot be used."""
        if not groups.incomplete[row]:
            return self._table.weights
        if groups.snapshot_weights is None or not groups.snapshot_weights[row].any():
            return None
        partial = self._table.for_present(groups.snapshot_weights[row] > 0)
        return None if partial is None else partial.weights

    def _take(self, index: int, tones: Array, weights: Array) -> tuple[Array, Array, Array]:
        """Values of the ends of one group, their variance over that of H, and their power."""
        cycles = self._hertz * (index + 0.5) * self._period_s % 1.0
        rotation = np.exp(-2j * np.pi * cycles)
        upper = tones[self._upper] * rotation / self._coefficients
        lower = tones[self._lower] * rotation.conj() / self._coefficients
        line_gain = np.sum(np.abs(weights[self._upper]) ** 2, axis=1)
        line_gain = line_gain / self._coefficients[:, 0] ** 2
        self._learn_noise(upper, lower, line_gain)
        read = self._squares if self._squared else self._channels
        return read(upper, lower, line_gain)

    def _learn_noise(self, upper: Array, lower: Array, gain: Array) -> None:
        """Both lines of a pair have the same channel: their difference is noise."""
        product = np.sum(upper * lower.conj(), axis=1)
        half = np.exp(0.5j * np.angle(product))[:, None]
        apart = np.abs(upper * half.conj() - lower * half) ** 2 / 2
        level = np.mean(apart / gain[:, None]) * upper.shape[1] / (upper.shape[1] - 1)
        self._noise_groups = min(self._noise_groups + 1, _NOISE_GROUPS)
        self._noise_level += (level - self._noise_level) / self._noise_groups
        self._noise_level = max(self._noise_level, _LEAST_NOISE)

    def _channels(self, upper: Array, _: Array, gain: Array) -> tuple[Array, Array, Array]:
        power = np.mean(np.abs(upper) ** 2, axis=1) - gain * self._noise_level
        return upper, gain, power

    def _squares(self, upper: Array, lower: Array, gain: Array) -> tuple[Array, Array, Array]:
        noise = gain * self._noise_level
        power = (np.mean(np.abs(upper) ** 2, axis=1) + np.mean(np.abs(lower) ** 2, axis=1)) / 2
        # The noise of a product grows with it: its mean is weighted by the product's own energy.
        squares = upper * lower
        energy = np.abs(squares) ** 2
        level = np.sum(np.abs(squares) * energy, axis=1) / np.sum(energy, axis=1)
        variance = 2 * level * noise + noise**2
        return squares, variance / self._noise_level, power - noise
