# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands beside the press of a reading."""

from collections.abc import Sequence
from typing import Any

from ..io.readings import Reading


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
