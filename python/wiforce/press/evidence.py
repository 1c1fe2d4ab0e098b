# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether presses can be those of the sensor whose model reads them.

Two phases determine force and location, so a single reading of another sensor is only noticed
where no press causes its phases. A whole press says more: while its force changes, its location
stays, and the magnitude of the reflection as well. docs/rooms.md states how often this finds out.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..estimation.groups import Array
from ..estimation.phases.off_state import off_circle
from ..io.readings import Flag

if TYPE_CHECKING:
    from ..sensor.model import SensorModel

# Time between the readings of a press that are compared, and beside its beginning and end. Closer
# readings are averages over the same groups.
_STEP_S = 0.036
# Inner part of a press that is long enough to be compared, and from which on no more readings are
# kept, but spread evenly; presses that are remembered.
_LEAST_S, _LONG_S, _PRESSES = 0.2, 2.3, 12
# A location moves with the force if it moves by this much, and by so many of its own standard
# deviations, while the force changes by at least this.
_MOVE_MM, _MOVE_STDS, _FORCE_CHANGE_N = 0.1, 5.0, 0.5
# Presses that must agree, and their share among those in which the force changes.
_LEAST_PRESSES, _MOST = 2, 0.75
# The ends are swapped if locations then move by less than this share of what they move now.
_STILL = 0.25
# Touched time without a cause, in s, and its share, from which the file is the suspect.
_LEAST_UNEXPLAINED_S, _UNEXPLAINED = 0.25, 0.5
# Off states differ by more than this and so many standard deviations, and readings are flagged
# from the larger one on. Losses of a real line and contact change magnitudes by a few per cent.
_OFF, _CONTRADICTED_OFF, _OFF_STDS = 0.05, 0.1, 5.0
# Change of an end's amplitude by presses that is mentioned: an off state of this size changes a
# phase by up to 3 deg.
_AMPLITUDE = 0.03
# Flags of an inversion that finds no calibrated press.
_NO_PRESS = (Flag.INCONSISTENT | Flag.EXTRAPOLATED).value


# Ratios, phases and standard deviations of a group.
_Group = tuple[Array, ...]


class Suspicion(NamedTuple):
    """A mistake that presses suggest, and a sentence about it without the sensor's name.

    ``kind`` is ``other sensor``, ``swapped ends``, ``moving location``, ``off state`` or
    ``amplitude``.
    """

    kind: str
    text: str


class _Press(NamedTuple):
    """What a press showed: movement of its location with force."""

    moved_mm: float
    moves: bool
    swapped_mm: Callable[[], float]  # the movement if the ends were swapped


class _OffState(NamedTuple):
    """Another off state than that stated: of an end, by how much, and its size."""

    end: int
    apart: float
    size: float


class _OpenPress:
    """Readings of a press that has not ended, thinned evenly where it lasts."""

    def __init__(self, period_s: float) -> None:
        self._kept: list[tuple[int, _Group]] = []  # what each is in the press, and shows
        self._margin = math.ceil(_STEP_S / period_s)
        # Readings, and of how many one is kept.
        self._seen, self._stride = 0, max(1, round(_STEP_S / period_s))
        step_s = self._stride * period_s
        # A line has two parameters, so that less than three readings have none left for the noise.
        self.least = max(3, math.ceil(_LEAST_S / step_s))
        # Enough are left when they are halved, and without the margins.
        self._most = max(2 * self.least + 2, round(_LONG_S / step_s))

    def __bool__(self) -> bool:
        return bool(self._kept)

    def add(self, *group: Array) -> None:
        """Take what is compared of a group, such as ratios and phases, (2,) each."""
        if self._seen % self._stride == 0:
            # Copies, because a row of a batch would keep all of it in memory.
            self._kept.append((self._seen, tuple(values.copy() for values in group)))
        self._seen += 1
        if len(self._kept) > self._most:
            self._kept, self._stride = self._kept[::2], 2 * self._stride

    def inner(self) -> list[_Group]:
        """What is kept but for the margins; nothing of a short press."""
        inner = range(self._margin, self._seen - self._margin)
        kept = [group for at, group in self._kept if at in inner]
        return kept if len(kept) >= self.least else []


@dataclass
class _Record:
    """What the presses since a reference have shown."""

    presses: deque[_Press] = field(default_factory=lambda: deque(maxlen=_PRESSES))
    ratios: deque[Array] = field(default_factory=lambda: deque(maxlen=_PRESSES))
    # Largest change of |G| by each of these presses, of both ends.
    changes: deque[float] = field(default_factory=lambda: deque(maxlen=_PRESSES))
    change: float = 0.0  # what most of them stay below; 0 where the off state is right
    off_states: list[_OffState] = field(default_factory=list)
    readings: int = 0
    unexplained: int = 0
    swapped: bool = False
    other_off: bool = False
    suspicions: list[Suspicion] = field(default_factory=list)


class PressEvidence:
    """Collects the presses of one sensor, with G_off / rho of both switches as stated."""

    def __init__(
        self,
        model: SensorModel,
        frequency_hz: float,
        off_reflection: Array,
        group_period_s: float,
    ) -> None:
        self._model, self._frequency_hz = model, frequency_hz
        self._off = np.broadcast_to(np.asarray(off_reflection, complex), 2)
        self._untouched = np.array(model.untouched_deg(frequency_hz))
        self._period_s = group_period_s
        self.reset()

    @property
    def suspicions(self) -> list[Suspicion]:
        """By the presses that have ended; empty where all is well. Another list after each."""
        return self._record.suspicions

    @property
    def contradicted(self) -> bool:
        """Whether the ends are swapped or have another off state: no reading is consistent."""
        return self._record.swapped or self._record.other_off

    def take(self, read: Array) -> list[bool]:
        """Take what the groups of a batch say, (G,): R against the untouched sensor, ``level``;
        phases and their standard deviations in degrees; touch; whether no stage before the
        inversion flags the group, ``clear``; and whether nothing does but that it is no press of
        the model, ``unexplained``.

        Gives which of them are touched while the sensor is ``contradicted``.
        """
        contradicting = [False] * len(read)
        for i, touched in enumerate(read["touch"].tolist()):
            if touched != 1:
                if touched == 0 and (self._open or self._odd):
                    self._close()
                continue
            row = read[i]
            if row["unexplained"] or row["clear"]:
                self._record.readings += 1
                self._record.unexplained += bool(row["unexplained"] or row["flags"] & _NO_PRESS)
                if row["unexplained"]:
                    self._odd.add(row["level"])
                else:
                    self._open.add(row["level"], row["phases_deg"], row["psi_std_deg"])
            contradicting[i] = self.contradicted
        return contradicting

    def reset(self) -> None:
        """Forget the presses so far, for a new reference."""
        self._forget_press()
        self._record = _Record()

    def _forget_press(self) -> None:
        self._open = _OpenPress(self._period_s)
        self._odd = _OpenPress(self._period_s)  # no press explains it; amplitudes may show why

    def _suspicions(self) -> list[Suspicion]:
        suspicions, record, name = [], self._record, self._model.name
        least = _LEAST_UNEXPLAINED_S / self._period_s
        if record.unexplained >= max(least, _UNEXPLAINED * record.readings):
            text = (
                f"{record.unexplained} of {record.readings} touched readings have phases that no "
                f"calibrated press causes: is {name!r} the model of this sensor, pressed where it "
                "was calibrated?"
            )
            suspicions.append(Suspicion("other sensor", text))
        if record.swapped:
            text = (
                "the ends are swapped: with the cables of both ports exchanged, the locations "
                "would not move with the force"
            )
            suspicions.append(Suspicion("swapped ends", text))
        elif self._moving():
            moving = [abs(press.moved_mm) for press in record.presses if press.moves]
            text = (
                f"the location moves with the force, by {np.median(moving):.1f} mm in "
                f"{len(moving)} of {len(record.presses)} presses: the contact slides, or {name!r} "
                "is not the model of this sensor"
            )
            suspicions.append(Suspicion("moving location", text))
        for other in record.off_states:
            text = (
                f"the amplitude of end {other.end} changes as with an off state of "
                f"{other.size:.2f} instead of {abs(self._off[other.end - 1]):.2f}, or beside a "
                "second tag on the same clock: see gr-wiforce off-reflection"
            )
            suspicions.append(Suspicion("off state", text))
        if not record.off_states and record.change > _AMPLITUDE:
            text = (
                f"pressing changes the amplitude by {100 * record.change:.0f} %: the contact loses "
                "some of the signal, or the scene states another off state than that of the "
                "switches (gr-wiforce off-reflection)"
            )
            suspicions.append(Suspicion("amplitude", text))
        return suspicions

    def _close(self) -> None:
        """End a press."""
        press, odd = self._open.inner(), self._odd.inner()
        self._forget_press()
        if press:
            self._compare(press)
        elif odd:
            self._keep(np.array([ratios for (ratios,) in odd]))
        self._record.suspicions = self._suspicions()

    def _keep(self, ratios: Array) -> None:
        """Take the ratios (n, 2) of a press, and see which off states they show."""
        record = self._record
        record.ratios.append(ratios)
        start = np.exp(1j * np.radians(self._untouched)) - self._off
        sizes = np.abs(self._off + ratios * start).mean(axis=0)
        record.changes.append(float(np.abs(sizes - 1).max()))
        if len(record.changes) >= _LEAST_PRESSES:
            record.change = float(np.quantile(list(record.changes), _MOST))
        record.off_states = self._off_states()

    def _compare(self, press: list[_Group]) -> None:
        record = self._record
        ratios, phases, std = (np.array(each) for each in zip(*press, strict=True))
        self._keep(ratios)
        now = self._movement(phases, std)
        if now is not None:
            swapped = cache(partial(self._swapped_mm, phases, std))  # seldom needed
            record.presses.append(_Press(*now, swapped))
            record.swapped |= self._fits_swapped()
        record.other_off |= any(other.apart > _CONTRADICTED_OFF for other in record.off_states)

    def _movement(self, phases: Array, std: Array) -> tuple[float, bool] | None:
        """Movement of the location with the force, and whether it is more than noise."""
        found = self._model.invert(phases, std, frequency_hz=self._frequency_hz)
        force, place = found.force_n, found.location_mm
        known = np.isfinite(force) & np.isfinite(place) & (found.codes == 0)
        if known.sum() < self._open.least:
            return None
        force, place, spread = force[known], place[known], found.location_std_mm[known]
        change = np.ptp(force)
        if not change >= _FORCE_CHANGE_N:
            return None
        away = force - force.mean()
        slope = float(away @ place / (away @ away))
        rest = place - place.mean() - slope * away
        noise = math.sqrt(float(rest @ rest) / (len(rest) - 2) / float(away @ away))
        moved = slope * change
        # The model's own error is the same in all readings of a press, or changes with the force.
        limit = _MOVE_STDS * max(noise * change, float(np.median(spread)))
        return float(moved), bool(abs(moved) > max(limit, _MOVE_MM))

    def _swapped_mm(self, phases: Array, std: Array) -> float:
        swapped = self._untouched + (phases - self._untouched)[:, ::-1]
        found = self._movement(swapped, std[:, ::-1])
        return math.inf if found is None else found[0]

    def _moving(self) -> bool:
        presses = self._record.presses
        moving = sum(press.moves for press in presses)
        return moving >= max(_LEAST_PRESSES, _MOST * len(presses))

    def _fits_swapped(self) -> bool:
        """Whether locations move with force, but would not if the ends were swapped."""
        if not self._moving():
            return False
        presses = self._record.presses
        now = sum(abs(press.moved_mm) for press in presses)
        return sum(abs(press.swapped_mm()) for press in presses) < _STILL * now

    def _off_states(self) -> list[_OffState]:
        """Ends with another off state."""
        found: list[_OffState] = []
        # An off state changes the amplitude by about its size; noise only the circle.
        if 2 * self._record.change <= _OFF:
            return found
        ratios = np.concatenate(list(self._record.ratios))
        for end in (0, 1):
            circle = off_circle(ratios[:, end], float(self._untouched[end]))
            if circle is None:
                continue
            apart = abs(circle.off - self._off[end])
            if min(2 * self._record.change, apart) > max(_OFF, _OFF_STDS * circle.std):
                found.append(_OffState(end + 1, apart, abs(circle.off)))
        return found
