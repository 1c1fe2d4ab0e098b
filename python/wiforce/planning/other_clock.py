# SPDX-License-Identifier: GPL-3.0-or-later
"""Another clock for a tag whose lines coincide with something that a survey has found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..estimation.sources import RoomLine
from ..signal.lines import STRONG_LINES, lamp_distances_hz
from .mains import nearby_clocks_hz
from .plan import Plan


def other_clock_hz(plan: Plan, tag: int, lines: Sequence[RoomLine]) -> float | None:
    """A clock whose strong lines lie at least one bin from everything in the room.

    Parameters
    ----------
    plan : Plan
    tag : int
        Index of the tag.
    lines : sequence of RoomLine
        Of the room; those below the noise of a group do not count.

    Returns
    -------
    float or None
        In Hz, within 6 % of the tag's own; None when there is none. Among those that are possible,
        the one farthest from the lines of lamps.

    Examples
    --------
    >>> from gnuradio.wiforce.planning.plan import plan
    >>> settings = plan({"sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 1000}]})
    >>> other_clock_hz(settings, 0, [RoomLine(1000.0, 1.0)])
    1035.0
    """
    own_hz, bin_hz = plan.clocks[tag].clock_hz, 1 / plan.group_period_s
    mains_hz = plan.require_scene().environment.possible_mains_hz
    room = np.array([line.frequency_hz for line in lines if line.power * plan.group_length > 1])
    for clock_hz in nearby_clocks_hz(own_hz, mains_hz):
        strong = np.array(STRONG_LINES) * clock_hz
        if lamp_distances_hz(clock_hz, mains_hz).min() == 0:
            continue
        if np.abs(strong[:, None] - room).min(initial=np.inf) < bin_hz:
            continue
        clocks = list(plan.clocks)
        clocks[tag] = replace(clocks[tag], clock_hz=clock_hz)
        if replace(plan, clocks=tuple(clocks), room=None).separable:
            return clock_hz
    return None
