# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known of a sensor: the one record of it, which survives a new plan."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from ..estimation.groups import Array, Groups
from ..wiforce_kernels import press_filter
from .evidence import PressEvidence
from .explanations import COLUMNS, MIXED, UNTOUCHED, Explanations
from .stage_flags import has_phases

# Probability that a sensor is untouched where the user says so, and where a tare was forced
# although it seemed to be touched.
CLAIMED, FORCED = 0.999, 0.5
# Probability of an alternative from which on it is named; a reading is wrong at most so often.
DOUBT = 0.01
# Why it is not known which phases are those of the untouched sensor.
RETUNED = "the device was opened or tuned again"
UNCLEAR = "it may have been touched while its reference was measured or forced"
# Groups that another receiver, with other weights, may read again: ratios of 10 s at N_g 125.
_REMEMBERED = 2048


class SensorState:
    """The press filter of one sensor, what its presses showed, and how R is counted.

    Parameters
    ----------
    make_filter : callable
        Makes a press filter that has seen nothing.
    evidence : PressEvidence, optional
        Of the sensor's model.

    Attributes
    ----------
    received : bool
        Whether the newest group could be read.
    seen : bool
        Whether any group could be.
    retuned : bool
        The oscillators have had new phases since the reference, which says nothing any more.
    evidence : PressEvidence or None
        As given.
    """

    def __init__(
        self, make_filter: Callable[[], press_filter], evidence: PressEvidence | None = None
    ) -> None:
        self._make, self._filter = make_filter, make_filter()
        self.evidence = evidence
        self.received = self.seen = self.retuned = False
        self._last = -1  # newest group that was taken
        self._ratios: deque[tuple[int, Array]] = deque(maxlen=_REMEMBERED)
        self._claim: float | None = None

    def take(
        self, groups: Groups, sensor: int, period_s: float, receiver: Array
    ) -> tuple[Explanations, Array]:
        """Take the next groups; say what may have happened in the group before each of them.

        Parameters
        ----------
        groups : Groups
            With ``ratios``, ``phase_std_deg`` and the arrays of separation and reference.
            Those that were taken before, with other weights, only show how R is counted now.
        sensor : int
            Index of the sensor in them.
        period_s : float
            Length of a group, in s.
        receiver : ndarray, shape (G, 3)
            Turn (rad), gain (Np) and their variance by which the static path changed since the
            group before.

        Returns
        -------
        explanations : Explanations
            Row i: of the group before group i of the batch, if it could be read.
        retuned : ndarray of bool, shape (G,)
            Whether the oscillators have had new phases since the reference.
        """
        rows = self._observations(groups, sensor, period_s, receiver)
        again = int(np.searchsorted(groups.index, self._last, side="right"))
        if again:
            self._align(groups[:again], sensor)
        renewed = groups.new_reference.copy()
        renewed[:again] = False
        if again < len(groups) and self._last < 0:
            renewed[again] = False
        parts, retuned = [], np.full(len(groups), self.retuned)
        bounds = [again, *(np.flatnonzero(renewed[again + 1 :]) + again + 1), len(groups)]
        for begin, end in pairwise(bounds):
            if begin < len(groups) and renewed[begin]:
                self._renew(groups.reference_step[begin, 2 * sensor : 2 * sensor + 2])
            if end > begin:
                parts.append(Explanations.of(self._filter.take(rows[begin:end]), begin))
                retuned[begin:end] = self.retuned
                if (new := groups.retuned[begin:end]).any():
                    retuned[begin + int(np.argmax(new)) : end] = self.retuned = True
        if again < len(groups):
            self._last = int(groups.index[-1])
            readable = np.isfinite(rows[again:, 1])
            self.received = bool(readable[-1])
            self.seen |= bool(readable.any())
        if not parts:
            return Explanations.of(np.zeros((0, COLUMNS))), retuned
        return Explanations.concatenate(parts), retuned

    @property
    def newest(self) -> Explanations:
        """What may have happened in the newest group that could be read, as far as is known."""
        return Explanations.of(self._filter.newest())

    @property
    def touched(self) -> bool:
        """Whether the sensor is touched now, or was in a part of the newest group."""
        return self.received and self._untouched() <= 0.5

    def _untouched(self) -> float:
        """Probability that the sensor is untouched now."""
        newest = self.newest
        return float(newest.weight[newest.state == UNTOUCHED].sum())

    @property
    def problem(self) -> str:
        """Why it is not known which phases are those of the untouched sensor; empty if they are."""
        if self.retuned:
            return RETUNED
        newest = self.newest
        steady = newest.state != MIXED
        doubtful = float(newest.weight[steady & ~newest.known].sum())
        untouched = self._untouched()
        either = min(untouched, float(newest.weight[steady].sum()) - untouched)
        return UNCLEAR if max(doubtful, either) > DOUBT else ""

    def claim_untouched(self, forced: bool) -> None:
        """The user says that the sensor is untouched in the reference that begins now."""
        self._claim = FORCED if forced else CLAIMED

    def _observations(self, groups: Groups, sensor: int, period_s: float, receiver: Array) -> Array:
        """Rows for the kernel; NaN where a group cannot be read; shape (G, 13)."""
        ends = slice(2 * sensor, 2 * sensor + 2)
        ratios = groups.ratios[:, ends]
        readable = has_phases(groups, sensor)
        rows = np.empty((len(groups), 13))
        rows[:, 0] = (groups.index + 0.5) * period_s
        with np.errstate(divide="ignore", invalid="ignore"):
            rows[:, 1:3] = np.angle(ratios)
            rows[:, 3:5] = np.log(np.abs(ratios))
            rows[:, 5:7] = np.radians(groups.phase_std_deg[:, ends]) ** 2
        rows[:, 7] = np.radians(groups.common_std_deg) ** 2
        rows[:, 8:11] = receiver
        rows[:, 11] = groups.retuned
        claimed = groups.in_reference[:, ends].any(axis=1)
        claimed &= ~groups.late_reference[:, ends].any(axis=1)
        rows[:, 12] = CLAIMED * claimed
        readable &= np.isfinite(rows[:, 1:8]).all(axis=1)
        rows[~readable, 1] = math.nan
        for index, pair in zip(groups.index[readable].tolist(), ratios[readable], strict=True):
            if index > self._last:
                self._ratios.append((index, pair.copy()))
        return rows

    def _align(self, groups: Groups, sensor: int) -> None:
        """Count R as these groups do, which were taken before with another reference."""
        ends = slice(2 * sensor, 2 * sensor + 2)
        readable = has_phases(groups, sensor)
        again = dict(
            zip(groups.index[readable].tolist(), groups.ratios[readable, ends], strict=True)
        )
        pairs = [(former, again[index]) for index, former in self._ratios if index in again]
        if not pairs:
            self._renew(np.full(2, np.nan))
            return
        former, now = (np.array(each) for each in zip(*pairs, strict=True))
        self._renew((former * now.conj()).sum(axis=0) / (np.abs(now) ** 2).sum(axis=0))

    def _renew(self, step: Array) -> None:
        """Begin with a new reference that is ``step`` times the former one; NaN where unknown."""
        claim, self._claim = self._claim, None
        if np.isfinite(step).all():
            self._recount(step)
            if claim is not None:
                self._filter.claim_untouched(claim)
        else:
            self._filter, self._last = self._make(), -1
            self._ratios.clear()
        if claim is not None:
            self.retuned = False
            if self.evidence is not None:
                self.evidence.reset()

    def _recount(self, step: Array) -> None:
        if np.all(step == 1):
            return
        self._filter.change_reference(-np.angle(step), -np.log(np.abs(step)))
        self._ratios = deque(((i, pair / step) for i, pair in self._ratios), maxlen=_REMEMBERED)
