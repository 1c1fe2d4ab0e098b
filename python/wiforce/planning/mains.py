# SPDX-License-Identifier: GPL-3.0-or-later
"""Switching clocks and the mains: lamps modulate what they reflect at multiples of 100 or 120 Hz.

A lamp's discharge burns twice per period of the mains, so its reflection repeats at twice the
mains frequency and has lines at all multiples of that. A line of a tag is separated from them when
it lies a bin, the inverse of a phase group, away.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..signal.lines import STRONG_LINES, lamp_distances_hz
from ..signal.waveform import Waveform
from .clocks import WORST_LOSS_DB, assess_clocks
from .plan import Plan

# How far from a clock a better one is sought, and on which grid: crystals and dividers are bought
# for round numbers.
_WITHIN, _STEP_HZ = 0.06, 5.0
# A clock is better when it lies half as far again from the lamps' lines.
_BETTER = 1.5
# A clock that costs an end more than this is no substitute, in dB.
_ACCEPTED_LOSS_DB = 0.1
# Clocks are compared in groups of at most this length: longer ones only resolve more.
_LONGEST_ASSESSED = 625


def farthest_from_lamps(
    low_hz: float, high_hz: float, mains_hz: Sequence[float], near_hz: float
) -> list[float]:
    """Clocks of a range, those farthest from the lines of lamps first.

    Parameters
    ----------
    low_hz, high_hz : float
        The range, in Hz; both ends belong to it.
    mains_hz : sequence of float
        Mains frequencies that are possible, in Hz.
    near_hz : float
        Of clocks equally far from lamps, the one nearest to this comes first.

    Returns
    -------
    list of float
        Multiples of 5 Hz, in Hz.

    Examples
    --------
    >>> farthest_from_lamps(950.0, 1050.0, (50.0, 60.0), near_hz=1000.0)[0]
    1035.0
    """
    grid = np.arange(np.ceil(low_hz / _STEP_HZ), np.floor(high_hz / _STEP_HZ) + 1) * _STEP_HZ

    def order(clock_hz: float) -> tuple[float, float]:
        return -lamp_distances_hz(clock_hz, mains_hz).min(), abs(clock_hz - near_hz)

    return sorted(map(float, grid), key=order)


def nearby_clocks_hz(clock_hz: float, mains_hz: Sequence[float]) -> list[float]:
    """Clocks within 6 % of a tag's own: crystal and divider can then stay.

    Parameters
    ----------
    clock_hz : float
        Clock of the tag, in Hz.
    mains_hz : sequence of float
        Mains frequencies that are possible, in Hz.

    Returns
    -------
    list of float
        In Hz, those farthest from the lines of lamps first.

    Examples
    --------
    >>> nearby_clocks_hz(100.0, (50.0, 60.0))
    [95.0, 105.0, 100.0]
    """
    return farthest_from_lamps(
        (1 - _WITHIN) * clock_hz, (1 + _WITHIN) * clock_hz, mains_hz, clock_hz
    )


def better_clock_hz(
    clocks_hz: Sequence[float],
    tag: int,
    mains_hz: Sequence[float],
    waveform: Waveform,
    group_length: int,
    tolerance_ppm: float = 100.0,
    clutter_hz: float = 0.0,
    usable: Callable[[Sequence[float]], bool] = lambda clocks_hz: True,
    loss_db: float | None = None,
) -> float | None:
    """A clock near that of a tag whose strong lines lie farther from the lines of lamps.

    Parameters
    ----------
    clocks_hz : sequence of float, length S
        Clocks of all tags, in Hz.
    tag : int
        Which of them.
    mains_hz : sequence of float
        Mains frequencies that are possible, in Hz.
    waveform, group_length, tolerance_ppm, clutter_hz
        As in :func:`.clocks.assess_clocks`.
    usable : callable
        A further condition: clocks of all tags to whether they can be used.
    loss_db : float, optional
        Worst loss of any end with ``clocks_hz``, where it is known already.

    Returns
    -------
    float or None
        In Hz; None when no clock within 6 % is better by half and as well readable.

    Examples
    --------
    >>> from gnuradio.wiforce.signal.waveform import sounding_waveform
    >>> better_clock_hz([1000.0], 0, (50.0, 60.0), sounding_waveform(), 625)
    1035.0
    """
    own = clocks_hz[tag]
    needed_hz = _BETTER * lamp_distances_hz(own, mains_hz).min()
    settings = waveform, min(group_length, _LONGEST_ASSESSED), None, tolerance_ppm, clutter_hz
    others = [hz for i, hz in enumerate(clocks_hz) if i != tag]
    nyquist_hz = 0.5 / waveform.snapshot_period_s
    resolution_hz = 2 * nyquist_hz / group_length
    for clock_hz in nearby_clocks_hz(own, mains_hz):
        distance_hz = lamp_distances_hz(clock_hz, mains_hz).min()
        if distance_hz < needed_hz or distance_hz == 0:
            return None
        if clock_hz <= clutter_hz or max(STRONG_LINES) * clock_hz >= nyquist_hz:
            continue
        if any(too_near(clock_hz, other, resolution_hz) for other in others):
            continue
        if loss_db is None:
            loss_db = assess_clocks(clocks_hz, *settings).worst_loss_db
        changed = [*clocks_hz[:tag], clock_hz, *clocks_hz[tag + 1 :]]
        report = assess_clocks(changed, *settings)
        worst_db = min(loss_db + _ACCEPTED_LOSS_DB, WORST_LOSS_DB)
        if report.worst_loss_db <= worst_db and usable(changed):
            return clock_hz
    return None


def too_near(one_hz: float, other_hz: float, resolution_hz: float) -> bool:
    """Whether strong lines of two tags fall within four times the resolution of each other.

    Parameters
    ----------
    one_hz, other_hz : float
        Clocks of the tags, in Hz.
    resolution_hz : float
        Inverse of the length of a phase group, in Hz.

    Returns
    -------
    bool

    Examples
    --------
    >>> too_near(1000.0, 2035.0, 27.8), too_near(1000.0, 1365.0, 27.8)
    (True, False)
    """
    pairs = ((1, 1), (1, 2), (2, 1), (1, 4), (4, 1))
    return any(abs(a * one_hz - b * other_hz) < 4 * resolution_hz for a, b in pairs)


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
    better_hz, better_distance_hz : float or None
        A clock near its own whose strong lines lie farther away, and how far; None without one.

    Examples
    --------
    >>> LampLines(0, (1, 2, 4), 0.0, 1035.0, 30.0).better_hz
    1035.0
    """

    tag: int
    lines: tuple[int, ...]
    distance_hz: float
    better_hz: float | None
    better_distance_hz: float | None


def lines_near_lamps(plan: Plan) -> Iterator[LampLines]:
    """Tags of a scene whose strong lines lie within one bin of those of lamps.

    Parameters
    ----------
    plan : Plan
        Of a scene.

    Yields
    ------
    LampLines

    Examples
    --------
    >>> from gnuradio.wiforce.planning.plan import plan
    >>> scene = {"sensors": [{"name": "arm", "model": "line-900mhz"}]}
    >>> [found.lines for found in lines_near_lamps(plan(scene))]
    [(1, 2, 4)]
    """
    mains_hz = plan.require_scene().environment.possible_mains_hz
    bin_hz = 1 / plan.group_period_s
    losses_db: dict[float, float] = {}
    for tag, clock in enumerate(plan.clocks):
        distances_hz = lamp_distances_hz(clock.clock_hz, mains_hz)
        near = tuple(m for m, hz in zip(STRONG_LINES, distances_hz, strict=True) if hz < bin_hz)
        if not near:
            continue
        # All tags have the same loss to compare with, unless their tolerances differ.
        if clock.planned_ppm not in losses_db:
            losses_db[clock.planned_ppm] = _worst_loss_db(plan, clock.planned_ppm)
        better = better_clock_hz(
            plan.clocks_hz,
            tag,
            mains_hz,
            plan.waveform,
            plan.group_length,
            clock.planned_ppm,
            plan.clutter_hz,
            partial(_usable, plan),
            losses_db[clock.planned_ppm],
        )
        farther = None if better is None else float(lamp_distances_hz(better, mains_hz).min())
        yield LampLines(tag, near, float(distances_hz.min()), better, farther)


def _worst_loss_db(plan: Plan, tolerance_ppm: float) -> float:
    length = min(plan.group_length, _LONGEST_ASSESSED)
    settings = plan.waveform, length, None, tolerance_ppm, plan.clutter_hz
    return assess_clocks(plan.clocks_hz, *settings).worst_loss_db


def _usable(plan: Plan, clocks_hz: Sequence[float]) -> bool:
    """Whether the receiver's weights can be designed for other clocks."""
    clocks = tuple(
        replace(clock, clock_hz=hz) for clock, hz in zip(plan.clocks, clocks_hz, strict=True)
    )
    return replace(plan, clocks=clocks).separable


def line_numbers(lines: Sequence[int]) -> str:
    """Lines of a tag in words.

    Parameters
    ----------
    lines : sequence of int
        One or more.

    Returns
    -------
    str

    Examples
    --------
    >>> line_numbers([4]), line_numbers([1, 2, 4])
    ('line 4', 'lines 1, 2 and 4')
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

    Returns
    -------
    str

    Examples
    --------
    >>> lines_lie([4], "arm"), lines_lie([1, 2], "arm")
    ("line 4 of 'arm' lies", "lines 1 and 2 of 'arm' lie")
    """
    verb = "lies" if len(lines) == 1 else "lie"
    return f"{line_numbers(lines)} of '{sensor}' {verb}"


def lamp_multiples(mains_hz: Sequence[float]) -> str:
    """The lines of lamps in words.

    Parameters
    ----------
    mains_hz : sequence of float
        Mains frequencies that are possible, in Hz.

    Returns
    -------
    str

    Examples
    --------
    >>> lamp_multiples((50.0, 60.0))
    'multiples of 100 and 120 Hz'
    """
    return f"multiples of {' and '.join(f'{2 * hz:g}' for hz in mains_hz)} Hz"


def lamp_warnings(plan: Plan) -> Iterator[str]:
    """Warnings of tags whose lines lamps disturb, where another clock would help.

    Parameters
    ----------
    plan : Plan
        Of a scene.

    Yields
    ------
    str
        A sentence each.

    Examples
    --------
    >>> from gnuradio.wiforce.planning.plan import plan
    >>> scene = {"sensors": [{"name": "arm", "model": "line-900mhz"}]}
    >>> next(lamp_warnings(plan(scene)))[:51]
    "lamps: lines 1, 2 and 4 of 'arm' lie within one bin"
    """
    scene = plan.require_scene()
    multiples = lamp_multiples(scene.environment.possible_mains_hz)
    for found in lines_near_lamps(plan):
        if found.better_hz is None:
            continue
        yield (
            f"lamps: {lines_lie(found.lines, scene.sensor_names[found.tag])} within one bin "
            f"({1 / plan.group_period_s:.3g} Hz) of {multiples}; with a clock of "
            f"{found.better_hz:g} Hz they keep {found.better_distance_hz:g} Hz away "
            "(environment.mains_hz: null where there are no lamps)"
        )
