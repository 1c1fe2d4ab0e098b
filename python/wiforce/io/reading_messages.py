# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings from messages, whose content is not known to be complete or valid."""

import dataclasses
import math
from typing import Any

from .readings import NUMBERS, SURFACE_COLUMNS, Flag, Reading, SurfaceReading

_FLAGS = frozenset(flag.word for flag in Flag)


def as_reading(reading: Any) -> Reading | None:
    """A Reading from a message of the port ``readings``, or from part of one.

    Returns Reading or None: None when sensor or time are not given.

    Parameters
    ----------
    reading : Reading or dict
        Keys as the columns of a readings file; flags as one text or a sequence. A value that is
        absent, not finite, or not a number is unknown.
    """
    if isinstance(reading, Reading):
        reading = dataclasses.asdict(reading)
    if not isinstance(reading, dict):
        return None
    numbers = {name: _number(reading.get(name)) for name in NUMBERS}
    time_s, sensor = numbers.pop("time_s"), reading.get("sensor")
    if time_s is None or not isinstance(sensor, str) or not sensor:
        return None
    touch = _number(reading.get("touch"))
    group = _number(reading.get("group"))
    flags = reading.get("flags") or ()
    flags = flags.split() if isinstance(flags, str) else flags
    also = {name: _number(reading.get(name)) for name in SURFACE_COLUMNS}
    kind, known = (Reading, numbers) if also["y_mm"] is None else (SurfaceReading, numbers | also)
    return kind(
        time_s=time_s,
        sensor=sensor,
        touch=None if touch is None else int(touch == 1),
        flags=tuple(flag for flag in flags if flag in _FLAGS),
        group=None if group is None else int(group),
        **known,
    )


def _number(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None
