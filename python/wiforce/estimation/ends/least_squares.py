# SPDX-License-Identifier: GPL-3.0-or-later
"""Least-squares fit of the tags' switching waveforms to the tones of groups.

The weights W of a run are fixed. Their response to each tag's two waveforms at the tracked clock,
M = W [s1, s2], is computed per group and inverted for all tags together, so that aliases, clock
offsets and lines shared by tags cause no error (docs/theory.md, Ends).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.polynomial import legendre

from ...signal.waveform import Waveform
from ...signal.weights import PartialWeights, ToneTable
from ...wiforce_kernels import end_fit, end_separation, noise_estimate, spread_lines
from ..clocks.tracked_tag import ClockPath, ClockTracker, TrackedTag
from ..groups import Array, GroupFit, Groups, GroupTones, GroupWeights

# Polynomials of the phase over a group. The first n terms of a random walk's expansion leave
# 2 / (pi^2 n) of its power (K. Karhunen, 1947): 3 % for six.
_POLYNOMIALS = 6
# Times that the ends are solved. Each leaves of their error the share of the power that is spread:
# -13 dB for symbols of 0.05 of the tag's period. Of symbols of 0.02 at most, more than one change
# neither phases nor SNR (60 dB).
_ROUNDS, _ROUNDS_OF_SHORT = 3, 1


def spread_lines_of(waveform: Waveform, table: ToneTable) -> spread_lines:
    """What removes intercarrier interference of the tags from tones of samples."""
    bins, factors = waveform.bins, waveform.equalizer()[waveform.bins]
    spectrum = np.fft.fft(waveform.symbol)
    spectrum /= np.mean(spectrum[bins] * factors)
    rotation = None
    if waveform.is_derotated:
        of_symbol = waveform.sample_rate_hz, waveform.symbol_length
        upper = slice(len(table.tones) // 2, None)
        # The fit is of tones without derotation, which lose this gain.
        rotation = (table.derotation(*of_symbol) * table.symbol_gain(*of_symbol)[:, None])[upper]
    rounds = _ROUNDS_OF_SHORT if waveform.is_derotated else _ROUNDS
    return spread_lines(bins, spectrum, factors, waveform.repetitions, rotation, rounds)


class ToneModel:
    """The tones of a run's groups as a linear function of the ends' channels, by tag of the table.

    With a sample rate where tones are derotated, and ``spread`` where the symbol is known.
    """

    def __init__(
        self,
        table: ToneTable,
        tags: Sequence[TrackedTag],
        sample_rate_hz: float | None,
        symbol_length: int = 64,
        spread: spread_lines | None = None,
    ) -> None:
        self.table = table
        self._spread = spread
        self.tags = tags
        # First groups behind slips of the frame timing, and by how much later they are, in s.
        self.slips: list[tuple[int, float]] = []
        self.group_period_s = table.group_length * table.snapshot_period_s
        self._line_gain = np.ones((len(table.tones), 1))
        if sample_rate_hz is not None:
            self._line_gain = 1 / table.symbol_gain(sample_rate_hz, symbol_length)[:, None]

    @cached_property
    def _complete(self) -> GroupWeights:
        return GroupWeights(self.table, self._line_gain)

    @property
    def locked(self) -> list[TrackedTag]:
        """Tags whose clock is tracked."""
        return [tag for tag in self.tags if tag.tracker is not None]

    @property
    def trackers(self) -> list[ClockTracker]:
        """Clock trackers of the locked tags."""
        return [tag.tracker for tag in self.tags if tag.tracker is not None]

    def predict(self, groups: GroupTones) -> ClockPath:
        """Clocks of the locked tags expected in some groups."""
        shape = len(groups.center_s), len(self.trackers)
        phase, rate = np.empty(shape), np.empty(shape)
        for tag, tracker in enumerate(self.trackers):
            phase[:, tag] = tracker.predict(groups.center_s)
            rate[:, tag] = tracker.rate
        return ClockPath(phase, rate)

    def prepare(self, groups: Groups) -> tuple[GroupTones, list[bool]]:
        """The tones of a batch; also which groups have tones, all of them finite."""
        weights = np.full(len(groups), self._complete, object)
        parts = groups.tones.real, groups.tones.imag
        peaks = sum(np.abs(part).max(axis=(1, 2), initial=0) for part in parts)
        usable = ((peaks > 0) & (peaks < np.inf)).tolist()
        own = groups.incomplete if groups.timed is None else np.ones(len(groups), bool)
        for row in np.flatnonzero(own).tolist():
            partial = self._partial(groups, row)
            if partial is None:
                usable[row] = False
            else:
                length = self.table.group_length
                weights[row] = GroupWeights(partial, self._line_gain, length / len(partial.times_s))
        center_s = np.array([(i + 0.5) * self.group_period_s for i in groups.index.tolist()])
        for first, late_s in self.slips:
            center_s[groups.index >= first] += late_s
        return GroupTones(groups.index, center_s, groups.tones, groups.missing, weights), usable

    def _partial(self, groups: Groups, row: int) -> PartialWeights | None:
        """Weights of a group that has its own, None where they do not exist."""
        if not np.isfinite(groups.tones[row]).all():
            return None
        if groups.timed is not None:
            timed: PartialWeights | None = groups.timed[row]
            return timed
        if groups.snapshot_weights is None:
            return None
        return self.table.for_present(groups.snapshot_weights[row] > 0)

    def fit(self, groups: GroupTones, clocks: ClockPath) -> GroupFit:
        """Least squares over the locked tags, at their clocks."""
        rows = np.array([row for tag in self.locked for row in tag.rows], int)
        # Whitened parts of the tags' waveforms, and of their slopes behind them.
        mixed = [np.empty((len(groups), len(self.table.tones), 0))]
        if len(rows):
            switching, pulses = self._switching(clocks)
            mixed = [by.switched(switching[own], pulses) for by, own in groups.by_weights()]
        return GroupFit(rows, np.concatenate(mixed), groups.white)

    def _switching(self, clocks: ClockPath) -> tuple[Array, Array]:
        """Phase, rate and half a window (G, S, 3), delay and duties (S, 3) of the locked tags."""
        locked = self.locked
        rates = clocks.rate + [tag.rate for tag in locked]
        # Of all tags, since it is that of the waveform.
        windows = rates * (locked[0].averaging_s / 2)
        switching = np.array([clocks.phase, rates, windows]).transpose(1, 2, 0)
        return switching, np.array([(tag.clock2_delay, *tag.duty) for tag in locked])

    def solve(self, groups: GroupTones, clocks: ClockPath) -> GroupFit:
        """Fit without spread lines, and residual without what the wander of clocks explains."""
        fit = self.fit(groups, clocks)
        if self._spread is not None and self.locked:
            weights, switching = groups.weights.tolist(), self._switching(clocks)
            fit.solve(self._spread.removed(fit, weights, *switching, groups.tones))
        self.remove_wander(fit, groups, clocks)
        return fit

    def separate(
        self,
        kernel: end_separation,
        groups: GroupTones,
        complete: Sequence[bool],
        noise: noise_estimate,
        update: bool,
    ) -> dict[str, Array]:
        """Ends, clocks and noise of the first usable groups; noise of ``complete`` ones (G,)."""
        locked = self.locked

        def remove_wander(row: int, fit: end_fit, phase: Array, rate: Array) -> None:
            clocks = ClockPath(phase[None], rate[None])
            self.remove_wander(fit, groups[row : row + 1], clocks)

        return dict(
            kernel.process(
                [tag.locked() for tag in locked],
                groups.weights.tolist(),
                groups.center_s,
                complete,
                groups.tones,
                noise,
                update,
                self._spread,
                remove_wander if any(tag.clock.wanders for tag in locked) else None,
            )
        )

    def remove_wander(self, fit: end_fit, groups: GroupTones, clocks: ClockPath) -> None:
        """Remove from residuals what slow changes of the clocks' phases inside a group explain.

        Without a crystal, a jitter of 0.3 us per period moves the phase by 0.6 deg in 36 ms,
        coherently over the subcarriers; the ends' phases are not disturbed, since positive and
        negative lines turn in opposite directions.
        """
        wandering = [(i, tag) for i, tag in enumerate(self.locked) if tag.clock.wanders]
        for row, weights in enumerate(groups.weights if wandering else ()):
            times_s, changes = weights.times_s, []
            reach_s = max(float(np.abs(times_s).max()), 1e-12)
            courses = legendre.legvander(times_s / reach_s, _POLYNOMIALS - 1).T
            for i, tag in wandering:
                clock = clocks.of(i, slice(row, row + 1))
                slopes = tag.waveforms_and_slopes(clock, times_s)[1][0]
                moved = weights.mix(slopes * courses[:, :, None])
                changes.append(moved @ fit.ends[row, 2 * i : 2 * i + 2])
            basis = np.concatenate(changes)
            basis -= fit.white[row] @ (fit.solver[row] @ basis)
            rows, residual = basis.reshape(len(basis), -1), fit.residual[row]
            gram = (rows.conj() @ rows.T).real
            along = (rows.conj() @ residual.ravel()).real
            sizes, *_ = np.linalg.lstsq(gram, along, rcond=1e-9)
            fit.residual[row] = residual - np.tensordot(sizes, basis, 1)

    def own_tones(self, tag: TrackedTag, groups: GroupTones, fit: GroupFit | None) -> Array:
        """The lines of a tag, minus what a fit says of the other tags; shape (G, L, K)."""
        lines = tag.likelihood.rows
        tones: Array = groups.tones[:, lines].astype(complex)
        if fit is None or len(self.tags) == 1:
            return tones
        foreign = np.flatnonzero(~np.isin(fit.rows, tag.rows))
        for weights, rows in groups.by_weights():
            mixing = weights.colorer[lines] @ fit.white[rows][:, :, foreign]
            tones[rows] -= mixing @ fit.ends[rows][:, foreign]
        return tones
