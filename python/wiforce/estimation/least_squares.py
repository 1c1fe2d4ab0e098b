# SPDX-License-Identifier: GPL-3.0-or-later
"""Least-squares fit of the tags' switching waveforms to the tones of a group.

The weights W of a run are fixed. Their response to each tag's two waveforms at the tracked clock,
M = W [s1, s2], is computed per group and inverted for all tags together, so that aliases, clock
offsets and lines shared by tags cause no error (docs/estimation.md, step 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..signal.weights import ToneTable
from .clock_tracker import ClockTracker
from .group_tones import GroupTones, GroupWeights, power_of
from .groups import Array, Groups
from .tracked_tag import TrackedTag
from .wander import without_wander

# Noise gain of an end, relative to a perfect one, above which it counts as not separable (20 dB).
_WORST_GAIN = 100.0


@dataclass(slots=True)
class GroupFit:
    """Tones = mixing @ ends + residual, for the E ends of the locked tags.

    Attributes
    ----------
    rows : ndarray of int, shape (E,)
        The ends that were fitted, among those of all tags.
    mixing : ndarray of complex, shape (M, E)
        W [s1, s2, ...].
    ends : ndarray of complex, shape (E, K)
        V.
    gain : ndarray, shape (E,)
        Variance of V over that of H.
    residual : ndarray of complex, shape (M, K)
        Whitened; without what the wander of a clock explains where ``solve`` made the fit.
    white : ndarray of complex, shape (M, E)
        The whitened mixing matrix.
    solver : ndarray of complex, shape (E, M)
        Its pseudo-inverse.
    slopes : ndarray of complex, shape (M, E)
        Derivatives of ``white`` by each tag's clock phase; empty when they were not wanted.

    Examples
    --------
    >>> mixing, ends = np.eye(4)[:, :2], np.ones((2, 62))
    >>> fit = GroupFit(
    ...     np.arange(2), mixing, ends, np.ones(2), np.zeros((4, 62)), mixing, mixing.T, mixing)
    >>> fit.ends.shape
    (2, 62)
    """

    rows: Array
    mixing: Array
    ends: Array
    gain: Array
    residual: Array
    white: Array
    solver: Array
    slopes: Array


class ToneModel:
    """The tones of a run's groups as a linear function of the ends' channels.

    Parameters
    ----------
    table : ToneTable
        Weights of the run.
    tags : sequence of TrackedTag
        In the order in which the table was designed.
    sample_rate_hz : float or None
        Given when the tones are derotated (``ToneTable.derotation``).

    Examples
    --------
    >>> from gnuradio.wiforce.estimation.tracked_tag import TagClock
    >>> from gnuradio.wiforce.signal.weights import design_weights
    >>> table = design_weights([1000.0], 625, 57.6e-6)
    >>> model = ToneModel(table, [TrackedTag(table, 0, TagClock(1000.0), 20.48e-6)], None)
    >>> (item,) = model.prepare(Groups([0], np.ones((1, 16, 62))))
    >>> ends, gain, noise, _ = model.solve(item)  # no clock is known yet
    >>> gain.tolist(), bool(np.allclose(noise, item.power()))
    ([inf, inf], True)
    """

    def __init__(
        self, table: ToneTable, tags: Sequence[TrackedTag], sample_rate_hz: float | None
    ) -> None:
        self.table = table
        self.tags = tags
        self.group_period_s = table.group_length * table.snapshot_period_s
        self._all_ends = np.arange(2 * len(tags))
        self._line_gain = np.ones((len(table.tones), 1))
        if sample_rate_hz is not None:
            self._line_gain = 1 / table.symbol_gain(sample_rate_hz)[:, None]

    @cached_property
    def _complete(self) -> GroupWeights:
        return GroupWeights(self.table, self._line_gain, self.table.times_s)

    @property
    def locked(self) -> list[TrackedTag]:
        """Tags whose clock is tracked."""
        return [tag for tag in self.tags if tag.tracker is not None]

    @property
    def trackers(self) -> list[ClockTracker]:
        """Clock trackers of the locked tags."""
        return [tag.tracker for tag in self.tags if tag.tracker is not None]

    def prepare(self, groups: Groups) -> list[GroupTones]:
        """The groups of a batch one by one, their tones whitened."""
        tones = groups.tones.astype(complex)
        with np.errstate(invalid="ignore", over="ignore"):
            white = self._complete.whitener @ tones
            usable = np.isfinite(tones.sum(axis=(1, 2))) & tones.any(axis=(1, 2))
        items = []
        counts = zip(
            groups.index.tolist(),
            groups.missing.tolist(),
            groups.incomplete.tolist(),
            strict=True,
        )
        for row, (index, missing, incomplete) in enumerate(counts):
            weights, whitened = self._complete, white[row]
            solvable = bool(usable[row])
            if incomplete:
                partial = self._partial(groups, row) if solvable else None
                solvable = partial is not None
                if partial is not None:
                    weights, whitened = partial, partial.whitener @ tones[row]
            center_s = (index + 0.5) * self.group_period_s
            items.append(
                GroupTones(index, center_s, tones[row], whitened, weights, missing, solvable)
            )
        return items

    def _partial(self, groups: Groups, row: int) -> GroupWeights | None:
        if groups.snapshot_weights is None:
            return None
        mask = groups.snapshot_weights[row] > 0
        partial = self.table.for_present(mask) if mask.any() else None
        if partial is None:
            return None
        times_s = self.table.times_s[mask]
        return GroupWeights(partial, self._line_gain, times_s, len(mask) / len(times_s))

    def fit(self, item: GroupTones, slopes: bool = False) -> GroupFit | None:
        """Least squares over the locked tags at their clocks; None without a tag or tones.

        Parameters
        ----------
        item : GroupTones
        slopes : bool
            Whether the derivatives by the clocks' phases are wanted too.
        """
        locked = self.locked
        if not locked or not item.usable:
            return None
        weights, columns = item.weights, 2 * len(locked)
        if slopes:
            both = [tag.waveforms_and_slopes(item.center_s, weights) for tag in locked]
            mixed = weights.mix([w for w, _ in both] + [s for _, s in both])
        else:
            mixed = weights.mix([tag.waveforms(item.center_s, weights) for tag in locked])
        whitened = weights.whitener @ mixed
        white = whitened[:, :columns]
        adjoint = white.conj().T
        inverse = inverse_of(adjoint @ white)
        solver = inverse @ adjoint
        ends = solver @ item.white
        residual: Array = item.white - white @ ends
        rows = self._all_ends
        if len(rows) != columns:
            rows = np.array([row for tag in locked for row in tag.rows])
        return GroupFit(
            rows,
            mixed[:, :columns],
            ends,
            inverse.diagonal().real,
            residual,
            white,
            solver,
            whitened[:, columns:],
        )

    def solve(self, item: GroupTones) -> tuple[Array, Array, Array, GroupFit | None]:
        """Solve a group for all ends.

        Parameters
        ----------
        item : GroupTones

        Returns
        -------
        ends : ndarray of complex, shape (2S, K)
            V; 0 for tags that are not locked.
        gain : ndarray, shape (2S,)
            Variance of V over that of H; infinite for tags that are not locked.
        noise : ndarray, shape (K,)
            Mean square of the whitened residual per degree of freedom.
        fit : GroupFit or None
            What these were computed from.
        """
        count, subcarriers = 2 * len(self.tags), item.tones.shape[1]
        fit = self.fit(item)
        if fit is not None and len(fit.rows) == count:
            ends, gain = fit.ends, fit.gain.copy()
        else:
            ends = np.zeros((count, subcarriers), complex)
            gain = np.full(count, np.inf)
            if fit is None:
                return ends, gain, item.power() if item.usable else np.zeros(subcarriers), None
            ends[fit.rows], gain[fit.rows] = fit.ends, fit.gain
        # In units of the whole group: a perfect end would have 1/N.
        gain[gain * self.table.group_length >= _WORST_GAIN] = np.inf
        freedom = max(len(fit.residual) - len(fit.rows), 1)
        self._remove_wander(fit, item)
        return ends, gain, power_of(fit.residual).sum(axis=0) / freedom, fit

    def _remove_wander(self, fit: GroupFit, item: GroupTones) -> None:
        """Remove from a residual what the wander of clocks without a crystal explains."""
        locked = self.locked
        places = [place for place, tag in enumerate(locked) if tag.clock.wanders]
        if places:
            slopes = [
                locked[place].waveforms_and_slopes(item.center_s, item.weights)[1]
                for place in places
            ]
            rows = [row for place in places for row in (2 * place, 2 * place + 1)]
            fit.residual = without_wander(
                item, slopes, fit.ends[rows], fit.white, fit.solver, fit.residual
            )

    def without_others(self, tag: TrackedTag, item: GroupTones, fit: GroupFit | None) -> Array:
        """The group's tones minus those of the other tags in a fit."""
        if fit is None or len(self.tags) == 1:
            return item.tones
        foreign = ~np.isin(fit.rows, tag.rows)
        return item.tones - fit.mixing[:, foreign] @ fit.ends[foreign]


def inverse_of(gram: Array) -> Array:
    """Inverse of a small Hermitian positive definite matrix; the pseudo-inverse of a singular one.

    Parameters
    ----------
    gram : ndarray of complex, shape (n, n)

    Returns
    -------
    ndarray of complex, shape (n, n)

    Examples
    --------
    >>> inverse_of(np.diag([2.0 + 0j, 4.0])).diagonal().real.tolist()
    [0.5, 0.25]
    """
    size = len(gram)
    smallest = 1e-12 * float(gram.diagonal().real.max())
    if size == 2:
        # One tag, the common case: calling LAPACK would cost as much as all other steps together.
        a, b, d = gram[0, 0].real, gram[0, 1], gram[1, 1].real
        pivot = d - (b.real**2 + b.imag**2) / a if a > smallest else 0.0
        if pivot > smallest:
            scale = 1 / (a * pivot)
            return np.array([[d * scale, -b * scale], [-b.conjugate() * scale, a * scale]])
        return np.linalg.pinv(gram, rcond=1e-9, hermitian=True)
    try:
        factor = np.linalg.cholesky(gram)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(gram, rcond=1e-9, hermitian=True)
    if np.min(factor.diagonal().real) ** 2 <= smallest:
        return np.linalg.pinv(gram, rcond=1e-9, hermitian=True)
    return np.linalg.inv(gram)
