# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimators that a scene can select: this project's, the published one and the sideband one.

The latter two are for comparison, and do not track the clock.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..signal.switching import harmonics
from ..signal.waveform import PacketWaveform, Waveform
from ..signal.weights import ToneTable
from .clocks.tracked_tag import TagClock
from .ends.separation import EndSeparator
from .groups import Array, Groups
from .phases.reference import ConjugateDifference

# Lines on which the paper reads end 1 and end 2 (section 3.2).
_LINES = (1, 4)
# Groups that the noise is averaged over: 2.3 s of default groups, as in noise_estimate.h.
_NOISE_GROUPS = 64
# Noise is divided by, and may be absent in simulations.
_LEAST_NOISE = 1e-300


class LineSeparator:
    """Reads end 1 on line 1 of each tag, and end 2 on line 4 (paper, section 3.2).

    The noise is learned from the difference of lines +m and -m, which have the same channel. A
    constant offset o of the clock rotates end 1 by 2 pi fs o per second, end 2 by four times that;
    the paper compares each group with the previous one, so that changes accumulate. ``squared``
    gives P(+m) P(-m), in which the clock cancels: half its angle is the change of phase modulo 180
    deg.
    """

    acquisition_groups = 0

    def __init__(
        self,
        table: ToneTable,
        clocks: Sequence[TagClock],
        waveform: Waveform,
        derotated: bool = True,
        others: Sequence[TagClock] = (),
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
        found = [self._separated(groups, row) for row in range(len(groups))]
        ends, gain, snr_db, level = (np.array(each) for each in zip(*found, strict=True))
        nominal = np.zeros((len(groups), self._tags))
        return groups.having(
            tones=None,
            snapshot_weights=None,
            ends=ends,
            gain=gain,
            noise=level[:, None].repeat(ends.shape[2], axis=1),
            snr_db=snr_db,
            locked=np.isfinite(gain[:, ::2]),
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

    def _separated(self, groups: Groups, row: int) -> tuple[Array, Array, Array, float]:
        """Values of the ends of one group, their variance over that of H, their SNR, the noise."""
        tones, weights = groups.tones[row].astype(complex), self._weights(groups, row)
        if weights is None or not (np.isfinite(tones.sum()) and tones.any()):
            nothing = np.zeros((len(self._upper), tones.shape[1]), complex)
            unknown = np.full(len(nothing), np.nan)
            return nothing, np.full(len(nothing), np.inf), unknown, self._noise_level
        cycles = self._hertz * (int(groups.index[row]) + 0.5) * self._period_s % 1.0
        rotation = np.exp(-2j * np.pi * cycles)
        upper = tones[self._upper] * rotation / self._coefficients
        lower = tones[self._lower] * rotation.conj() / self._coefficients
        line_gain = np.sum(np.abs(weights[self._upper]) ** 2, axis=1)
        line_gain = line_gain / self._coefficients[:, 0] ** 2
        self._learn_noise(upper, lower, line_gain)
        ends, gain, power = self._ends(upper, lower, line_gain)
        ratio = self._line_power * power / self._noise_level
        return ends, gain, 10 * np.log10(np.maximum(ratio, 1e-12)), self._noise_level

    def _learn_noise(self, upper: Array, lower: Array, gain: Array) -> None:
        """Both lines of a pair have the same channel: their difference is noise."""
        product = np.sum(upper * lower.conj(), axis=1)
        half = np.exp(0.5j * np.angle(product))[:, None]
        apart = np.abs(upper * half.conj() - lower * half) ** 2 / 2
        level = np.mean(apart / gain[:, None]) * upper.shape[1] / (upper.shape[1] - 1)
        self._noise_groups = min(self._noise_groups + 1, _NOISE_GROUPS)
        self._noise_level += (level - self._noise_level) / self._noise_groups
        self._noise_level = max(self._noise_level, _LEAST_NOISE)

    def _ends(self, upper: Array, lower: Array, gain: Array) -> tuple[Array, Array, Array]:
        """Values of the ends or their squares, their variance over that of H, and their power."""
        noise, power = gain * self._noise_level, np.mean(np.abs(upper) ** 2, axis=1)
        if not self._squared:
            return upper, gain, power - noise
        power = (power + np.mean(np.abs(lower) ** 2, axis=1)) / 2
        # The noise of a product grows with it: its mean is weighted by the product's own energy.
        squares = upper * lower
        energy = np.abs(squares) ** 2
        level = np.sum(np.abs(squares) * energy, axis=1) / np.sum(energy, axis=1)
        variance = 2 * level * noise + noise**2
        return squares, variance / self._noise_level, power - noise


class Estimator(NamedTuple):
    """How the ends' phases are estimated."""

    # Makes the stage from tones to the ends' channels; only the first one knows ``others``.
    separator: Callable[..., EndSeparator | LineSeparator]
    # Tones are plain Fourier sums over the group instead of the scene's weights.
    rectangular: bool = False
    # The ``change`` against the untouched sensor, a ``step`` from the group before, or a ``square``
    # of the change.
    ratios: str = "change"

    def difference(
        self, tags: int, reference_groups: int, waveform: Waveform
    ) -> ConjugateDifference:
        """Make the stage that compares the ends of S tags with their reference."""
        # The channels of packets are ratios of antennas, which no few delays describe.
        linear = self.ratios == "change" and not isinstance(waveform, PacketWaveform)
        return ConjugateDifference(
            2 * tags, reference_groups, self.ratios == "step", waveform if linear else None
        )


ESTIMATORS = {
    "harmonic": Estimator(EndSeparator),
    "sideband": Estimator(partial(LineSeparator, squared=True), ratios="square"),
    "paper": Estimator(LineSeparator, rectangular=True, ratios="step"),
}


def estimator_named(name: str) -> Estimator:
    """Look up one of ``ESTIMATORS``; an InputError names the others."""
    if name not in ESTIMATORS:
        raise InputError("estimator", f"must be one of {', '.join(ESTIMATORS)}", name)
    return ESTIMATORS[name]


class RatioUnfolder:
    """Converts ratios to changes: adds up steps, of magnitude 1; nearest roots of squares."""

    def __init__(self, ratios: str) -> None:
        self._ratios = ratios
        self._last: Array | None = None

    def process(self, groups: Groups) -> Groups:
        """Convert the ratios of a batch, their variances and standard deviations."""
        if self._ratios == "change" or not len(groups):
            return groups
        received = np.isfinite(groups.phase_std_deg) & (np.abs(groups.ratios) > 0)
        unfolded = np.empty_like(groups.ratios)
        for row, restarts in enumerate(groups.new_reference.tolist()):
            if restarts or self._last is None:  # the group counts as untouched
                self._last = np.ones(groups.ratios.shape[1], complex)
            unfold = self._add_step if self._ratios == "step" else self._take_root
            unfolded[row] = unfold(groups.ratios[row], received[row], self._last)
        folds = 2 if self._ratios == "square" else 1
        return groups.having(ratios=unfolded, phase_std_deg=groups.phase_std_deg / folds)

    def _add_step(self, ratios: Array, received: Array, last: Array) -> Array:
        steps = np.where(received, ratios, 1.0)
        self._last = last * steps / np.abs(steps)
        return np.where(received, self._last, 0.0)

    def _take_root(self, ratios: Array, received: Array, last: Array) -> Array:
        roots = np.sqrt(np.asarray(ratios, complex))
        roots = np.where((roots * last.conj()).real < 0, -roots, roots)
        self._last = np.where(received, roots, last)
        return roots
