# SPDX-License-Identifier: GPL-3.0-or-later
"""Requests for a new untouched reference: accepted or refused, complete or failed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..estimation.phases.reference import ConjugateDifference
from .sensor_readout import SensorReadout
from .sensor_state import DOUBT, RETUNED

# A reference needs at least this part of its groups from every sensor that is received in it.
_LEAST_SHARE = 0.5


@dataclass(frozen=True)
class TareState:
    """What became of the last request for a tare.

    ``state`` is ``none`` before the first request, ``measuring``, ``complete``, ``refused`` or
    ``failed``; after the last two the former reference is still in use. ``reason`` says why, or
    which sensors keep their former reference, and ``time_s`` up to when groups had been read.
    """

    state: str = "none"
    reason: str = ""
    forced: bool = False
    time_s: float | None = None

    def row(self) -> dict[str, Any]:
        """The state as plain values, unknown ones left out."""
        return {key: value for key, value in vars(self).items() if value is not None}


class _Measured:
    """What a sensor showed during a tare."""

    def __init__(self, retuned: bool) -> None:
        self.retuned = retuned  # when it began
        self.groups = 0
        self.problem = ""

    def add(self, event: str) -> None:
        """Take a group that was received; ``event`` is empty when it was untouched."""
        self.groups += 1
        self.problem = self.problem or event


class TareReports:
    """The state of the last request for a tare; ``on_state`` is called with each that follows."""

    def __init__(self) -> None:
        self.state = TareState()
        self.on_state: Callable[[TareState], object] | None = None

    @property
    def measuring(self) -> bool:
        """Whether a tare is being measured."""
        return self.state.state == "measuring"

    def report(self, state: TareState) -> TareState:
        """Take a new state, and pass it on."""
        self.state = state
        if self.on_state is not None:
            self.on_state(state)
        return state


class TareRequests(TareReports):
    """Decides on requests for a tare from what the sensors show before and during it.

    ``reference`` measures the new reference; ``sensors`` are given by name. Group 0 begins at
    ``start_s``.
    """

    def __init__(
        self,
        reference: ConjugateDifference,
        sensors: Mapping[str, SensorReadout],
        group_period_s: float,
        start_s: float = 0.0,
    ) -> None:
        super().__init__()
        self._reference, self._sensors = reference, sensors
        self._period_s, self._start_s = group_period_s, start_s
        self._measured: dict[str, _Measured] = {}
        self._index = 0

    def request(self, force: bool = False) -> TareState:
        """Measure a new reference in the groups that follow, unless a sensor is touched.

        After the oscillators have got new phases, as those of a device that was opened again, it
        cannot be known whether one is: the reference is measured as the first one was. Where it
        is forced, the readings of a sensor that seems to be touched are flagged ``ambiguous``
        until a release is seen.
        """
        if not self._reference.started:
            return self._set("refused", "the first reference is not complete", force)
        if self.measuring:
            return self._set("measuring", "", force or self.state.forced)
        touched = [] if force else [text for name in self._sensors if (text := self._touched(name))]
        if touched:
            advice = "release it" if len(touched) == 1 else "release them"
            reason = f"{'; '.join(touched)}; {advice}, or force the tare if nothing is touched"
            return self._set("refused", reason, force)
        self._measured = {
            name: _Measured(sensor.state.retuned) for name, sensor in self._sensors.items()
        }
        self._reference.tare()
        return self._set("measuring" if self._reference.measuring else "complete", "", force)

    def cancel(self, reason: str) -> TareState:
        """Give up a tare that is being measured; the former reference stays in use."""
        if not self.measuring:
            return self.state
        self._reference.discard()
        return self._set("failed", reason, self.state.forced)

    def before(self, index: int) -> None:
        """Complete the tare if it ends before the group of this index."""
        if self._reference.completes(index):
            self._complete()

    def after(self, index: int) -> None:
        """Take what the sensors showed in the group of this index."""
        self._index = index + 1
        if not self.measuring:
            return
        last = self._reference.completes(index + 1)
        for name, sensor in self._sensors.items():
            state, measured = sensor.state, self._measured[name]
            if not state.received:
                continue
            if state.retuned and not measured.retuned:
                self.cancel(f"{RETUNED}; send another tare")
                return
            touch = 0.0 if state.retuned else state.touch_probability
            measured.add(f"{name} was touched at {self.time_s:.2f} s" if touch > 0.5 else "")
            # What is likely only may be noise, which the next group shows; the last one has none.
            if touch > (0.5 if last else 1 - DOUBT) and not self.state.forced:
                self.cancel(f"{measured.problem}; the former reference is kept")
                return
        self.before(index + 1)

    @property
    def time_s(self) -> float:
        """Time in the run up to which groups have been read."""
        return self._index * self._period_s + self._start_s

    def _touched(self, name: str) -> str:
        """Why a tare would not measure an untouched sensor; empty when it would."""
        sensor = self._sensors[name]
        state = sensor.state
        if state.retuned:
            return ""  # as before the first reference, nobody can tell
        if state.touched:
            force = f"{sensor.force_n:.2f} N" if np.isfinite(sensor.force_n) else ""
            location = f"{sensor.location_mm:.1f} mm" if np.isfinite(sensor.location_mm) else ""
            values = " at ".join(text for text in (force, location) if text)
            return f"{name} is touched ({values})" if values else f"{name} is touched"
        if state.problem:
            return f"{name} may be touched: {state.problem}"
        return ""

    def _complete(self) -> None:
        wanted = self._reference.reference_groups
        missing = [name for name, measured in self._measured.items() if not measured.groups]
        if len(missing) == len(self._measured):
            self.cancel("no sensor was received; the former reference is kept")
            return
        for name, measured in self._measured.items():
            if 0 < measured.groups < _LEAST_SHARE * wanted:
                received = f"received in {measured.groups} of {wanted} groups only"
                self.cancel(f"{name} was {received}; the former reference is kept")
                return
        for name, measured in self._measured.items():
            if measured.groups:
                state = self._sensors[name].state
                doubtful = bool(measured.problem or state.problem) and not measured.retuned
                state.claim_untouched(forced=doubtful)
        reason = ""
        if missing:
            reason = f"{', '.join(missing)} not received; the former reference is kept for it"
        self._set("complete", reason, self.state.forced)

    def _set(self, state: str, reason: str, forced: bool) -> TareState:
        return self.report(TareState(state, reason, forced, round(self.time_s, 6)))


class StreamTares(TareReports):
    """Requests for a tare of the receiver that reads a stream at present."""

    def __init__(self, request: Callable[[bool], TareState], cancel: Callable[[str], None]) -> None:
        super().__init__()
        self._request, self._cancel = request, cancel

    def request(self, force: bool = False) -> TareState:
        """Measure a new reference, and survey the room in it unless it is forced."""
        return self._request(force)

    def cancel(self, reason: str) -> TareState:
        """Give up a tare that is being measured; the former reference stays in use."""
        self._cancel(reason)
        return self.state
