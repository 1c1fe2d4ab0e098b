# SPDX-License-Identifier: GPL-3.0-or-later
"""The least-squares fit of a group's tones by the tags' switching waveforms.

The weights W of a run are fixed. What they make of each tag's two waveforms at the tracked clock,
M = W [s1, s2], is computed per group and inverted for all tags together, so that aliases, clock
offsets and lines that tags share cost almost nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..signal.weights import ToneTable
from .group_tones import GroupTones, GroupWeights, power_of
from .groups import Array, Groups
from .tracked_tag import TrackedTag

# A mixing matrix that amplifies noise above this cannot separate its ends.
_WORST_GAIN = 100.0


@dataclass(slots=True)
class GroupFit:
    """Tones = mixing @ ends + residual, for the rows of ends that were fitted.

    ``white`` is the whitened mixing, ``solver`` its pseudo-inverse; ``residual`` is whitened too.
    """

    rows: Array
    mixing: Array
    ends: Array
    gain: Array
    residual: Array
    white: Array
    solver: Array


class ToneModel:
    """The tones of a run's groups as a linear function of the ends' channels.

    Parameters
    ----------
    table : ToneTable
    tags : sequence of TrackedTag
        In the order in which the table was designed.
    sample_rate_hz : float or None
        Given when the tones come derotated (``ToneTable.derotation``).
    """

    def __init__(
        self, table: ToneTable, tags: Sequence[TrackedTag], sample_rate_hz: float | None
    ) -> None:
        self.table = table
        self.tags = tags
        self.group_period_s = table.group_length * table.snapshot_period_s
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

    def prepare(self, groups: Groups) -> list[GroupTones]:
        """The groups of a batch one by one, their tones whitened."""
        tones = groups.tones.astype(complex)
        with np.errstate(invalid="ignore", over="ignore"):
            white = self._complete.whitener @ tones
            usable = np.isfinite(tones.sum(axis=(1, 2))) & tones.any(axis=(1, 2))
        items = []
        for row, (index, missing) in enumerate(
            zip(groups.index.tolist(), groups.missing.tolist(), strict=True)
        ):
            weights, whitened = self._complete, white[row]
            there = bool(usable[row])
            if missing:
                partial = self._partial(groups, row) if there else None
                there = partial is not None
                if partial is not None:
                    weights, whitened = partial, partial.whitener @ tones[row]
            center_s = (index + 0.5) * self.group_period_s
            items.append(GroupTones(index, center_s, tones[row], whitened, weights, missing, there))
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

    def fit(self, item: GroupTones) -> GroupFit | None:
        """Least squares over the locked tags at their clocks; None without tag or tones."""
        locked = self.locked
        if not locked or not item.usable:
            return None
        mixing = item.weights.mix([tag.waveforms(item.center_s, item.weights) for tag in locked])
        white = item.weights.whitener @ mixing
        adjoint = white.conj().T
        inverse = inverse_of(adjoint @ white)
        solver = inverse @ adjoint
        ends = solver @ item.white
        residual = item.white - white @ ends
        rows = np.array([row for tag in locked for row in tag.rows])
        return GroupFit(rows, mixing, ends, inverse.diagonal().real, residual, white, solver)

    def solve(self, item: GroupTones) -> tuple[Array, Array, Array]:
        """Ends (2S, K), their gain (2S,), and the noise in the residual (K,).

        Ends of tags that are not locked are zero, with infinite gain.
        """
        count, subcarriers = 2 * len(self.tags), item.tones.shape[1]
        ends = np.zeros((count, subcarriers), complex)
        gain = np.full(count, np.inf)
        if not item.usable:
            return ends, gain, np.zeros(subcarriers)
        fit = self.fit(item)
        if fit is None:
            return ends, gain, item.power()
        if len(fit.rows) == count:
            ends, gain = fit.ends, fit.gain.copy()
        else:
            ends[fit.rows], gain[fit.rows] = fit.ends, fit.gain
        # In units of the whole group: a perfect end would have 1/N.
        gain[gain * self.table.group_length >= _WORST_GAIN] = np.inf
        freedom = max(len(fit.residual) - len(fit.rows), 1)
        return ends, gain, power_of(fit.residual).sum(axis=0) / freedom

    def without_others(self, tag: TrackedTag, item: GroupTones, fit: GroupFit | None) -> Array:
        """The group's tones less what a fit ascribes to the other tags."""
        if fit is None or len(self.tags) == 1:
            return item.tones
        foreign = ~np.isin(fit.rows, tag.rows)
        return item.tones - fit.mixing[:, foreign] @ fit.ends[foreign]


def inverse_of(gram: Array) -> Array:
    """Inverse of a small Hermitian positive definite matrix; the pseudo-inverse of a singular one.

    Examples
    --------
    >>> inverse_of(np.diag([2.0 + 0j, 4.0])).diagonal().real.tolist()
    [0.5, 0.25]
    """
    size = len(gram)
    smallest = 1e-12 * float(gram.diagonal().real.max())
    if size == 2:
        # One tag, the common case: LAPACK's start-up would cost as much as all the rest.
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
