# SPDX-License-Identifier: GPL-3.0-or-later
"""What a survey has found, measured and changed, as rows and text."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from ...estimation.groups import Groups
from ..plan import Plan
from .findings import Finding

_COLUMNS = f"{'found':<34}{'level':>10}  "


@dataclass(frozen=True)
class MeasuredTag:
    """One tag as measured: None or empty where it, or an end of it, was not detected."""

    name: str
    clock_offset_ppm: float | None = None
    snr_db: list[float | None] = field(default_factory=list)
    phase_error_deg: list[float | None] = field(default_factory=list)

    def __str__(self) -> str:
        if self.clock_offset_ppm is None:
            return "not detected"
        text = f"clock {self.clock_offset_ppm:+.2f} ppm, SNR {_texts(self.snr_db, 1)} dB"
        if self.phase_error_deg:
            error = _texts(self.phase_error_deg, 2)
            text += f", expected phase error {error} deg per group"
        return text


def measure_tag(name: str, index: int, groups: Groups) -> MeasuredTag:
    """Medians over the groups in which the clock of tag ``index`` was locked."""
    if not len(groups) or not groups.locked[:, index].any():
        return MeasuredTag(name)
    locked = groups[groups.locked[:, index]]
    ends = slice(2 * index, 2 * index + 2)
    return MeasuredTag(
        name,
        float(np.median(locked.clock_offset_ppm[:, index])),
        _finite(np.median(locked.snr_db[:, ends], axis=0).round(2)),
        _finite(np.median(locked.phase_std_deg[:, ends], axis=0).round(3)),
    )


def _finite(values: np.ndarray) -> list[float | None]:
    """Values for JSON, which has neither nan nor infinity."""
    return [float(value) if np.isfinite(value) else None for value in values]


def _texts(values: Sequence[float | None], digits: int) -> str:
    return " and ".join("unknown" if v is None else f"{v:.{digits}f}" for v in values)


def finding_rows(found: Sequence[Finding]) -> list[dict[str, Any]]:
    """Findings as dictionaries for JSON."""
    return [{"name": finding.name, **asdict(finding)} for finding in found]


def findings_text(found: Sequence[Finding]) -> list[str]:
    """Findings as lines of a table, two each."""
    if not found:
        return ["found nothing besides the tags of the scene"]
    lines = [f"{_COLUMNS}meaning, and what the reader does about it"]
    for finding in found:
        level = f"{finding.level_db:+.1f} dB"
        lines.append(f"{finding.name:<34}{level:>10}  {finding.meaning}")
        lines.append(f"{'':<46}{finding.handling}")
    return lines


def finding_line(finding: Finding) -> str:
    """A finding in one line."""
    return f"{finding.name}, {finding.level_db:+.0f} dB: {finding.handling}"


def changes_of(plan: Plan, adapted: Plan) -> list[str]:
    """What a room changes in a plan."""
    changes = []
    if adapted.clutter_hz != plan.clutter_hz:
        changes.append(
            f"the weights reject clutter up to {adapted.clutter_hz:.0f} Hz instead of "
            f"{plan.clutter_hz:.0f} Hz"
        )
    if adapted.others:
        clocks = " and ".join(f"{clock.clock_hz:.2f} Hz" for clock in adapted.others)
        added = len(adapted.table.tones) - len(plan.table.tones)
        changes.append(f"adds the tag of {clocks} to the separation ({added} more tones)")
    if adapted.room is not None:
        changes.append("adds weights that suppress the noise between the lines of the tags")
    if adapted.compression is not None:
        changes.append("adds a correction of the receiver's compression")
    if adapted.tag_ratios:
        levels = " and ".join(f"{20 * math.log10(ratio):.0f} dB" for ratio in adapted.tag_ratios)
        changes.append(
            "adds to the standard deviations that the ratio of two antennas is not linear "
            f"(tag against static path: {levels})"
        )
    return changes


def skipped_of(adapted: Plan) -> list[str]:
    """What the room does not need."""
    needed = {
        "separation of tags that the scene does not list": bool(adapted.others),
        "weights against noise between the lines of the tags": adapted.room is not None,
        "correction of the receiver's compression": adapted.compression is not None,
    }
    return [step for step, is_needed in needed.items() if not is_needed]
