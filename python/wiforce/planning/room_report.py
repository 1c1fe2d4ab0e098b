# SPDX-License-Identifier: GPL-3.0-or-later
"""Findings of a survey as text, shared by the commands that print them."""

import math
import sys
from dataclasses import asdict, dataclass, field

import click
import numpy as np

# Steps that only some rooms need.
UNLISTED_TAGS = "separation of tags that the scene does not list"
NOISE_WEIGHTS = "weights against noise between the lines of the tags"
COMPRESSION = "correction of the receiver's compression"
_COLUMNS = f"{'found':<34}{'level':>10}  "


@dataclass
class Sensor:
    """Measurements of one tag; None where it was not detected, or an end is lost in noise."""

    name: str
    clock_offset_ppm: float | None = None
    snr_db: list = field(default_factory=list)
    phase_error_deg: list = field(default_factory=list)


def measure_tag(name, index, groups):
    """Medians over the groups in which the tag's clock was locked.

    Parameters
    ----------
    name : str
    index : int
        Of the tag among the scene's.
    groups : Groups

    Returns
    -------
    Sensor
    """
    if not len(groups) or not groups.locked[:, index].any():
        return Sensor(name)
    locked = groups[groups.locked[:, index]]
    ends = slice(2 * index, 2 * index + 2)
    return Sensor(
        name,
        float(np.median(locked.clock_offset_ppm[:, index])),
        _finite(np.median(locked.snr_db[:, ends], axis=0).round(2)),
        _finite(np.median(locked.phase_std_deg[:, ends], axis=0).round(3)),
    )


def _finite(values):
    """Values for JSON, which has neither nan nor infinity."""
    return [float(value) if np.isfinite(value) else None for value in values]


def _texts(values, digits):
    return " and ".join("unknown" if v is None else f"{v:.{digits}f}" for v in values)


def sensor_text(sensor):
    """What was measured of a tag, in a line."""
    if sensor.clock_offset_ppm is None:
        return "not detected"
    text = f"clock {sensor.clock_offset_ppm:+.2f} ppm, SNR {_texts(sensor.snr_db, 1)} dB"
    if sensor.phase_error_deg:
        text += f", expected phase error {_texts(sensor.phase_error_deg, 2)} deg per group"
    return text


def finding_rows(found):
    """Findings as dictionaries for JSON.

    Parameters
    ----------
    found : sequence of Finding

    Returns
    -------
    list of dict
    """
    return [{"name": finding.name, **asdict(finding)} for finding in found]


def findings_text(found):
    """Findings as lines of a table.

    Parameters
    ----------
    found : sequence of Finding

    Returns
    -------
    list of str
        Two lines per finding.
    """
    if not found:
        return ["found nothing besides the tags of the scene"]
    lines = [f"{_COLUMNS}meaning, and what the reader does about it"]
    for finding in found:
        level = f"{finding.level_db:+.1f} dB"
        lines.append(f"{finding.name:<34}{level:>10}  {finding.meaning}")
        lines.append(f"{'':<46}{finding.handling}")
    return lines


def finding_line(finding):
    """A finding in one line.

    Parameters
    ----------
    finding : Finding

    Returns
    -------
    str
    """
    return f"{finding.name}, {finding.level_db:+.0f} dB: {finding.handling}"


class RoomNews:
    """What each survey of a run has found that the one before had not.

    Parameters
    ----------
    say : callable, optional
        Takes a line for the user; `report_room` by default.
    """

    def __init__(self, say=None):
        self._say = say or report_room
        self._latest, self._known = None, []

    def report(self, found):
        """Print the findings that matter, where they differ from those printed before.

        Parameters
        ----------
        found : list of Finding or None
            Of the latest survey; the same list until there is another one.
        """
        if found is None or found is self._latest:
            return
        self._latest = found
        mattering = [finding for finding in found if finding.matters]
        # Frequencies and levels differ a little from survey to survey.
        known = [(each.kind, round(each.frequency_hz), each.handling) for each in mattering]
        if known == self._known:
            return
        self._known = known
        for finding in mattering:
            self._say(finding_line(finding))
        if not mattering:
            self._say("nothing found any more that matters")


def report_room(text):
    """Print what a survey has found, in a line of its own."""
    start = "\r\033[K" if sys.stderr.isatty() else ""
    click.echo(f"{start}gr-wiforce: room: {text}", err=True)


def changes_of(plan, adapted):
    """What a room changes in a plan.

    Parameters
    ----------
    plan, adapted : Plan
        Before and after.

    Returns
    -------
    list of str
    """
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


def skipped_of(adapted):
    """What the room does not need.

    Parameters
    ----------
    adapted : Plan

    Returns
    -------
    list of str
    """
    skipped = []
    if not adapted.others:
        skipped.append(UNLISTED_TAGS)
    if adapted.room is None:
        skipped.append(NOISE_WEIGHTS)
    if adapted.compression is None:
        skipped.append(COMPRESSION)
    return skipped
