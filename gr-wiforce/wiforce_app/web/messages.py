# SPDX-License-Identifier: GPL-3.0-or-later
"""Messages of a live reader, reduced to what the page shows.

Whoever publishes at the endpoint that the page was given decides what they hold. The page's process
must neither end nor grow because of them, and the browser must get the types that it expects.
"""

import json
import math
from collections.abc import Mapping
from itertools import islice
from typing import Any

# A scene holds fewer sensors; each has a row in every status that is sent to every viewer.
MOST_SENSORS = 256
# Of names, flags and reasons. Reasons name all sensors that are not received.
LONGEST_TEXT = 2000
_MOST_ENTRIES = 32  # of tares, group counts and the health of a sensor; the reader sends ten


def loaded(data: bytes) -> dict[str, Any]:
    """A JSON object; empty where it is none. Numbers that JSON cannot hold become None."""
    try:
        values = json.loads(data, parse_constant=lambda _: None, parse_float=number)
    except (ValueError, RecursionError):
        return {}
    return values if isinstance(values, dict) else {}


def number(value: Any) -> float | None:
    """A finite number from a number or its text; None for anything else."""
    try:
        result = float(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return result if math.isfinite(result) else None


def text(value: Any) -> str:
    """A text of limited length; empty for anything else."""
    return value[:LONGEST_TEXT] if isinstance(value, str) else ""


def status_of(heartbeat: Mapping[str, Any]) -> dict[str, Any]:
    """What the page shows of a heartbeat."""
    sensors = heartbeat.get("sensors")
    named = islice(sensors.items(), MOST_SENSORS) if isinstance(sensors, dict) else ()
    tare = heartbeat.get("tare")
    return {
        "state": text(heartbeat.get("state")),
        "reason": text(heartbeat.get("reason")),
        "time_s": number(heartbeat.get("time_s")),
        "tare": _plain(tare) if isinstance(tare, dict) else None,
        "sensors": {text(name): _plain(health) for name, health in named},
        "surface": _surface(heartbeat.get("surface")),
        "gaps": number(heartbeat.get("gaps")),
        "groups": _plain(heartbeat.get("groups")),
    }


def _plain(values: Any) -> dict[str, Any]:
    """The entries of a dict that are texts, truth values or numbers."""
    if not isinstance(values, dict):
        return {}
    return {text(key): _scalar(value) for key, value in islice(values.items(), _MOST_ENTRIES)}


def _scalar(value: Any) -> Any:
    if isinstance(value, bool):
        return value
    return text(value) if isinstance(value, str) else number(value)


def _surface(values: Any) -> dict[str, Any] | None:
    """Where the strips of a surface are; None where that cannot be drawn."""
    if not isinstance(values, dict) or not isinstance(values.get("strips"), list):
        return None
    strips = [
        {"x_mm": _numbers(strip.get("x_mm")), "y_mm": number(strip.get("y_mm"))}
        for strip in values["strips"][:MOST_SENSORS]
        if isinstance(strip, dict)
    ]
    span = _numbers(values.get("y_span_mm"))
    if not strips or span is None or any(None in strip.values() for strip in strips):
        return None
    return {"name": text(values.get("name")), "strips": strips, "y_span_mm": span}


def _numbers(values: Any) -> list[float | None] | None:
    """Two numbers, or None."""
    if not isinstance(values, list) or len(values) != 2:
        return None
    found = [number(value) for value in values]
    return None if None in found else found
