# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known of a sensor: the one record of it, which survives a new plan."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from ..estimation.groups import Array, Groups
from ..io.readings import WEAK_PHASE_DEG
from ..wiforce_kernels import press_filter
from .evidence import PressEvidence
from .explanations import MIXED, NOTHING, UNTOUCHED, later

# Probability of an alternative from which on it is named; a reading is wrong at most so often.
DOUBT = 0.01
# Probability that a sensor is untouched where the user says so, and where a tare was forced
# although it seemed to be touched.
CLAIMED, FORCED = 0.999, 0.5
# Why it is not known which phases are those of the untouched sensor.
RETUNED = "the device was opened or tuned again"
UNCLEAR = "it may have been touched while its reference was measured or forced"
# Why nothing is known of it.
CLIPPED = "the receiver is saturated; lower its gain until nothing is clipped"
# Time for which a sensor is not received, or in doubt, before a sentence says so.
PATIENCE_S = 1.0
# Time after which no other receiver reads a group again: surveys and references are shorter.
_REMEMBERED_S = 20.0


class SensorState:
    """The press filter of one sensor, what its presses showed, and how R is counted.

    ``received`` says whether the newest group could be read, ``seen`` whether any could be, and
    ``retuned`` that the oscillators have had new phases since the reference, which says nothing
    any more.
    """

    def __init__(
        self, make_filter: Callable[[], press_filter], evidence: PressEvidence | None = None
    ) -> None:
        self._make, self._filter = make_filter, make_filter()
        self.evidence = evidence
        self.received = self.seen = self.retuned = False
        self._doubt_s = 0.0
        self._doubt = self._lasting = ""
        # Only one end has a reference: a press within it looks like noise around the tag's lines.
        self._one_ended = False
        self._last = -1  # newest group that was taken
        # Indices of the newest groups, and what was observed in them.
        self._taken: deque[tuple[list[int], Array]] = deque()
        # Ratios by the former and by the present reference, of groups that are read again.
        self._again: list[tuple[Array, Array]] | None = None
        self._claim: float | None = None

    def take(
        self,
        groups: Groups,
        sensor: int,
        period_s: float,
        rows: Array,
        readable: Sequence[bool],
    ) -> tuple[Array, list[bool]]:
        """Take the next groups, and ``rows`` (G,) of what they show where they are ``readable``.

        Gives outcomes of the group before each of them, and whether the oscillators have had new
        phases since the reference. Groups that were taken before, with other weights, only show how
        R is counted now.
        """
        indices = groups.index.tolist()
        count, again = len(indices), bisect_right(indices, self._last)
        if again:
            self._read_again(groups[:again], sensor, readable[:again])
        retuned = [self.retuned] * count
        parts: list[Array] = []
        if again == count:
            return NOTHING, retuned
        new_phases = groups.retuned.tolist()
        steps = self._steps(groups, sensor, again)
        for begin, end in pairwise([*sorted({again, *steps}), count]):
            for step in steps.get(begin, ()):
                if np.isfinite(step).all():
                    self._renew(step)
                else:
                    parts.append(later(self._filter.newest(), begin))
                    self._forget()
            found = self._filter.take(rows[begin:end])
            parts.append(later(found, begin) if begin else found)
            for row in range(begin, end):
                self.retuned |= new_phases[row]
                retuned[row] = self.retuned
            self._taken.append((indices[begin:end], rows[begin:end]))
        self._last = indices[-1]
        oldest = self._last - _REMEMBERED_S / period_s
        while self._taken[0][0][-1] <= oldest:
            self._taken.popleft()
        self.received = readable[-1]
        self.seen |= True in readable[again:]
        if self.received:
            self._one_ended = False
        elif not self._one_ended:
            self._one_ended = bool(_one_ended(groups, sensor).any())
        # Joining structured arrays takes longer than the filter does for a group.
        return parts[0] if len(parts) == 1 else np.concatenate(parts), retuned

    def newest_of(self, index: int) -> Array:
        """What may have happened in the newest group, if it is this one."""
        return self._filter.newest() if index == self._last else NOTHING

    @property
    def shows_turns(self) -> bool:
        """Whether amplitudes distinguish a turn of the tag from a press (off_states.h)."""
        return self._filter.off_states_differ

    @property
    def touched(self) -> bool:
        """Whether the sensor is touched now, or was in a part of the newest group."""
        return self.touch_probability >= 0.5

    @property
    def touch_probability(self) -> float:
        """That it is; 0 where the newest group could not be read."""
        return 1 - self._untouched() if self.received else 0.0

    def _untouched(self) -> float:
        newest = self._filter.newest()
        return float(newest["weight"][newest["is"] == UNTOUCHED].sum())

    @property
    def problem(self) -> str:
        """Why it is not known which phases are those of the untouched sensor; empty if they are."""
        if self.retuned:
            return RETUNED
        if self._one_ended:
            return UNCLEAR
        newest, untouched = self._filter.newest(), self._untouched()
        steady = newest[newest["is"] != MIXED]
        doubtful = float(steady["weight"][~steady["known"]].sum())
        either = min(untouched, float(steady["weight"].sum()) - untouched)
        return UNCLEAR if max(doubtful, either) > DOUBT else ""

    def note_doubt(
        self, doubtful: Sequence[bool], clipped: Sequence[bool], period_s: float
    ) -> None:
        """Note of each next reading whether it is not known which phases are those untouched.

        Where samples are clipped, that is the cause.
        """
        if not self._doubt and True not in doubtful and True not in clipped:
            return
        for each, saturated in zip(doubtful, clipped, strict=True):
            if not (each or saturated):
                self._doubt, self._doubt_s = "", 0.0
                continue
            self._doubt_s += period_s
            if saturated or not self._doubt:
                self._doubt = CLIPPED if saturated else UNCLEAR
            if self._doubt_s >= PATIENCE_S:
                self._lasting = self._doubt

    @property
    def lasting_problem(self) -> str:
        """The problem of a second or more of readings since the last tare, also if it is solved."""
        return RETUNED if self.retuned else self._lasting

    @property
    def final_problem(self) -> str:
        """The problem to name where no reading at all was clear: one that lasts, or the newest."""
        return self.lasting_problem or self._doubt or self.problem

    def claim_untouched(self, forced: bool) -> None:
        """The user says that the sensor is untouched in the reference that begins now."""
        self._claim = FORCED if forced else CLAIMED

    def _read_again(self, groups: Groups, sensor: int, readable: Sequence[bool]) -> None:
        """Take groups that were taken before, and that only show how R is counted now."""
        first = 0
        if groups.new_reference.any() or self._again is None:
            first = len(groups) - 1 - int(np.argmax(groups.new_reference[::-1]))
            first *= int(groups.new_reference.any())
            self._again = []
        former = {
            index: _ratios(row)
            for indices, observed in self._taken
            for index, row in zip(indices, observed, strict=True)
        }
        ends = slice(2 * sensor, 2 * sensor + 2)
        pairs = groups.ratios[:, ends]
        # A group in which a press begins is another mixture by other weights.
        usable = groups.in_reference[:, ends].any(axis=1) & readable
        for row in range(first, len(groups)):
            before = former.get(int(groups.index[row]))
            if usable[row] and before is not None and np.isfinite(before).all():
                self._again.append((before, pairs[row].copy()))

    def _steps(self, groups: Groups, sensor: int, first: int) -> dict[int, list[Array]]:
        """By which references change at rows from ``first`` on; NaN where that is not known."""
        steps: dict[int, list[Array]] = {}
        if self._again is not None:
            steps[first] = [np.full(2, np.nan)]
            if self._again:
                former, now = (np.array(each) for each in zip(*self._again, strict=True))
                steps[first] = [(former * now.conj()).sum(axis=0) / (np.abs(now) ** 2).sum(axis=0)]
            self._again = None
        for row, new in enumerate(groups.new_reference.tolist()):
            if new and (row > first or (row == first and self._last >= 0)):
                step = groups.reference_step[row, 2 * sensor : 2 * sensor + 2]
                steps.setdefault(row, []).append(step)
        return steps

    def _renew(self, step: Array) -> None:
        """Begin with a new reference that is ``step`` times the former one."""
        if not np.all(step == 1):
            phase, amplitude = -np.angle(step), -np.log(np.abs(step))
            self._filter.change_reference(phase, amplitude)
            for _, rows in self._taken:
                rows["phase"] += phase
                rows["amplitude"] += amplitude
        if (claim := self._claimed()) is not None:
            self._filter.claim_untouched(claim)

    def _forget(self) -> None:
        """Begin with a reference that has nothing to do with the former one."""
        self._filter, self._taken = self._make(), deque()
        self._claimed()

    def _claimed(self) -> float | None:
        """The claim that begins now, if there is one; what it makes void is forgotten."""
        claim, self._claim = self._claim, None
        if claim is not None:
            self.retuned = False
            self._doubt_s, self._doubt, self._lasting = 0.0, "", ""
            if self.evidence is not None:
                self.evidence.reset()
        return claim


def describe_doubt(sensor: str, problem: str) -> str:
    """What to do where it is not known which phases are those of the untouched sensor."""
    if problem == CLIPPED:
        return f"{sensor}: {problem}"
    other = " (if nobody did, look for another tag with its clock)" if problem == UNCLEAR else ""
    return f"{sensor}: {problem}{other}; begin untouched, or release it and tare"


def describe_silence(sensor: str, since_s: float) -> str:
    """That a sensor is not received since a time in the run."""
    return (
        f"{sensor} is not received since {since_s:.2f} s; its readings are empty until it returns"
    )


def _one_ended(groups: Groups, sensor: int) -> Array:
    """Whether one end is received and the other has no reference; bool, shape (G,)."""
    ends = slice(2 * sensor, 2 * sensor + 2)
    std_deg = groups.phase_std_deg[:, ends]
    without = groups.reshaped[:, ends] & ~np.isfinite(std_deg)
    return np.asarray((std_deg < WEAK_PHASE_DEG).any(axis=1) & without.any(axis=1))


def _ratios(rows: Array) -> Array:
    return np.exp(rows["amplitude"] + 1j * rows["phase"])
