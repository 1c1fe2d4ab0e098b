# SPDX-License-Identifier: GPL-3.0-or-later
"""Another clock for a tag whose lines coincide with something that a survey has found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ...errors import InputError
from ...estimation.room.sources import RoomLine
from ...signal.lines import STRONG_LINES
from ..plan import Plan
from .proposals import propose_clocks

# Clocks that are tried: the first one is separable unless tags are in the room that no scene lists.
_ATTEMPTS = 4


def other_clock_hz(plan: Plan, tag: int, lines: Sequence[RoomLine]) -> float | None:
    """A clock (Hz) whose strong lines lie at least one bin from everything in the room.

    The best one for a tag of the plan, as `propose_clocks` has it; None when there is none.
    ``lines`` of the room below the noise of a group do not count.

    >>> from gnuradio.wiforce.planning.plan import plan
    >>> settings = plan({"sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 1000}]})
    >>> other_clock_hz(settings, 0, [RoomLine(1000.0, 1.0)])
    1035.0
    """
    own = plan.clocks[tag]
    avoid_hz = [line.frequency_hz for line in lines if line.power * plan.group_length > 1]
    for _ in range(_ATTEMPTS):
        try:
            (clock_hz,) = propose_clocks(
                1,
                plan.waveform,
                plan.group_length,
                [clock.clock_hz for i, clock in enumerate(plan.clocks) if i != tag],
                own.planned_ppm,
                plan.clutter_hz,
                plan.require_scene().environment.possible_mains_hz,
                [own.clock_hz],
                avoid_hz,
            )
        except InputError:
            return None
        clocks = list(plan.clocks)
        clocks[tag] = replace(own, clock_hz=clock_hz)
        if replace(plan, clocks=tuple(clocks), room=None).separable:
            return clock_hz
        avoid_hz += [line * clock_hz for line in STRONG_LINES]
    return None
