# SPDX-License-Identifier: GPL-3.0-or-later
"""Switching clocks and the mains: lamps modulate what they reflect at multiples of 100 or 120 Hz.

A lamp's discharge burns twice per period of the mains, so its reflection repeats at twice the
mains frequency and has lines at all multiples of that. A line of a tag is separated from them when
it lies a bin, the inverse of a phase group, away.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ...signal.lines import STRONG_LINES, lamp_distances_hz
from ..plan import Plan


@dataclass(frozen=True)
class LampLines:
    """A tag with strong lines that a phase group cannot separate from those of lamps.

    Attributes
    ----------
    tag : int
        Index of the tag.
    lines : tuple of int
        Those of its lines 1, 2 and 4 within one bin of a lamp's line.
    distance_hz : float
        Least distance of a strong line to a lamp's line.
    """

    tag: int
    lines: tuple[int, ...]
    distance_hz: float


def lines_near_lamps(plan: Plan) -> Iterator[LampLines]:
    """Tags of a scene whose strong lines lie within one bin of those of lamps.

    Parameters
    ----------
    plan : Plan
        Of a scene.
    """
    mains_hz = plan.require_scene().environment.possible_mains_hz
    bin_hz = 1 / plan.group_period_s
    for tag, clock in enumerate(plan.clocks):
        distances_hz = lamp_distances_hz(clock.clock_hz, mains_hz)
        near = tuple(m for m, hz in zip(STRONG_LINES, distances_hz, strict=True) if hz < bin_hz)
        if near:
            yield LampLines(tag, near, float(distances_hz.min()))


def line_numbers(lines: Sequence[int]) -> str:
    """Lines of a tag in words.

    Parameters
    ----------
    lines : sequence of int
        One or more.
    """
    *first, last = map(str, lines)
    return f"lines {', '.join(first)} and {last}" if first else f"line {last}"


def lines_lie(lines: Sequence[int], sensor: str) -> str:
    """Lines of a tag and the verb of a sentence that says where they lie.

    Parameters
    ----------
    lines : sequence of int
        One or more.
    sensor : str
        Name of the tag's sensor.
    """
    verb = "lies" if len(lines) == 1 else "lie"
    return f"{line_numbers(lines)} of '{sensor}' {verb}"


def lamp_multiples(mains_hz: Sequence[float]) -> str:
    """The lines of lamps in words.

    Parameters
    ----------
    mains_hz : sequence of float
        Mains frequencies that are possible, in Hz.
    """
    return f"multiples of {' and '.join(f'{2 * hz:g}' for hz in mains_hz)} Hz"
