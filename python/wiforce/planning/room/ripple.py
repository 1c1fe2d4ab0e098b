# SPDX-License-Identifier: GPL-3.0-or-later
"""Ripple of a gain, which a survey shows as the same pair of lines around every other line."""

from __future__ import annotations

from collections.abc import Sequence

from ...estimation.clocks.tracked_tag import TagClock
from ...estimation.room.sources import RoomLine, Source
from ...estimation.room.survey import Survey
from ...signal.lines import aliased_hz
from ...signal.waveform import Waveform

# Supplies pass the mains frequency or, behind a rectifier, twice that.
RIPPLE_HZ = (50.0, 60.0, 100.0, 120.0)
# Lines are where they are expected within this distance, and the ratios around zero and around the
# tag's line are equal within this factor (3 dB).
_APART_HZ = 1.5
_SAME_RATIO = 2.0
_HARMONICS = 24


def ripple_of(survey: Survey, clocks: Sequence[TagClock], waveform: Waveform) -> Source | None:
    """Ripple of the gain of transmitter or receiver.

    A gain that varies at f multiplies everything that is received. The static channel then has
    lines at +-f, and line 1 of a tag has lines f above and below it, all in the same ratio to what
    they belong to. Lamps modulate what they reflect only.

    Returns Source or None: of kind ``ripple``, with all lines that belong to it; None where there
    is none, or where it is too weak to show around the tags' lines.

    Parameters
    ----------
    clocks : sequence of TagClock, length S
        Of the scene's tags.
    """
    lines = [line for source in survey.sources for line in source.lines]
    rate_hz = 1 / waveform.snapshot_period_s

    def near(hertz: float, reach_hz: float) -> list[RoomLine]:
        seen = abs(aliased_hz(hertz, rate_hz))
        return [line for line in lines if abs(line.frequency_hz - seen) <= reach_hz]

    for ripple_hz in RIPPLE_HZ:
        around_zero = near(ripple_hz, _APART_HZ)
        if not around_zero or not survey.static_power > 0:
            continue
        ratio = max(line.power for line in around_zero) / survey.static_power
        found = list(around_zero)
        for clock, power in zip(clocks, survey.line_power, strict=True):
            if not power > 0:
                continue
            drift_hz = clock.clock_hz * clock.tolerance_ppm * 1e-6
            reach_hz = _APART_HZ + drift_hz
            pair = [near(clock.clock_hz + sign * ripple_hz, reach_hz) for sign in (-1, 1)]
            if not all(pair):
                continue
            ratios = [max(line.power for line in each) / power for each in pair]
            if max(*ratios, ratio) > _SAME_RATIO * min(*ratios, ratio):
                continue
            for m in range(1, _HARMONICS + 1):
                for sign in (-1, 1):
                    found += near(m * clock.clock_hz + sign * ripple_hz, _APART_HZ + m * drift_hz)
        if len(found) > len(around_zero):
            return Source("ripple", ripple_hz, tuple(dict.fromkeys(found)), ())
    return None
