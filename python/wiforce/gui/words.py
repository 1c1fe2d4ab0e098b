# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings as short texts."""

from collections.abc import Sequence
from typing import Any

from ..io.readings import Reading, SurfaceReading


def values(reading: Reading, bounds: bool = True) -> str:
    """Force and location, with two standard deviations if ``bounds``, or why there are none."""
    if reading.touch is None:
        return "no reading"
    if reading.touch == 0:
        return "not touched"
    force_std_n, location_std_mm = reading.force_std_n, reading.location_std_mm
    force = _value(reading.force_n, force_std_n if bounds else None, 2, "N")
    location = _value(reading.location_mm, location_std_mm if bounds else None, 1, "mm")
    if isinstance(reading, SurfaceReading):
        across = _value(reading.y_mm, reading.y_std_mm if bounds else None, 1, "mm")
        return f"{force}   x {location}   y {across}"
    return f"{force}   {location}"


def _value(value: float | None, std: float | None, decimals: int, unit: str) -> str:
    if value is None:
        return f"? {unit}"
    spread = f" \u00b1 {2 * std:.{decimals}f}" if std else ""
    return f"{value:.{decimals}f}{spread} {unit}"


def warning_flags(reading: Reading) -> list[str]:
    """Words of the flags that warn of errors: all but ``reference``."""
    return [flag for flag in reading.flags if flag != "reference"]


def end_labels(sensors: Sequence[str]) -> list[str]:
    """Labels of both ends of every sensor; with its name where there are several."""
    prefixes = [f"{name} " if len(sensors) > 1 else "" for name in sensors]
    return [f"{prefix}end {end}" for prefix in prefixes for end in (1, 2)]


def notes(reading: Reading) -> str:
    """SNR and flags."""
    snr = [] if reading.snr_db is None else [f"SNR {reading.snr_db:.1f} dB"]
    return "  ".join([*snr, *reading.flags])


def tare_outcome(state: dict[str, Any]) -> str:
    """What became of a tare (port ``tare_state``); empty while measured, and without one."""
    outcome, reason = state.get("state", "none"), state.get("reason", "")
    if outcome in ("none", "measuring"):
        return ""
    forced = " (forced)" if state.get("forced") else ""
    return f"tare {outcome}{forced}" + (f": {reason}" if reason else "")
