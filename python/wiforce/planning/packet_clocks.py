# SPDX-License-Identifier: GPL-3.0-or-later
"""Times of packets in a typical group of a scene, and the clocks that they keep apart."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..estimation.clocks.tracked_tag import TagClock
from ..scene import Scene
from ..signal.lines import STRONG_LINES, lamp_distances_hz
from ..signal.timed_weights import clutter_at, timed_lines
from .clocks.spacing import line_distances_hz
from .loss import end_variances

# Of the typical group's times; any other seed gives the same expected errors within 0.1 dB.
_SEED = 1


def typical_times_s(scene: Scene) -> np.ndarray:
    """Rising times (N,) of the packets of a typical phase group, from its centre."""
    count, period_s = scene.phase_group.snapshots, scene.group_period_s
    if scene.packets is not None and scene.packets.gaps == "regular":
        return (np.arange(count) + 0.5) * (period_s / count) - period_s / 2
    # Given their number, the times of a Poisson process are uniform.
    return np.sort(np.random.default_rng(_SEED).uniform(-period_s / 2, period_s / 2, count))


# Clocks that are tried: slow tags, whose oscillators are watch crystals and dividers. Higher ones
# gain nothing where packets are irregular, and meet their own aliases where they are regular.
_LOWEST_HZ, _HIGHEST_HZ, _STEP_HZ = 50.0, 200.0, 1.0
# Clocks that leave the worst end this much of the best one's information have about the same
# expected error, 2.5 % of a standard deviation; among them lamps decide.
_ABOUT_EQUAL = 0.95
# Bins between strong lines of two tags.
_APART_BINS = 4


def packet_clocks(scene: Scene, count: int) -> tuple[list[float], float] | None:
    """Clocks in Hz for a number of tags, and what the weakest end loses, in dB.

    One after the other, each leaves the worst end nearly the most information at the times of a
    typical group; among such clocks, it is the one farthest from the lines of lamps. None where
    tags cannot be distinguished from each other, from clutter and from themselves.
    """
    tags = [TagClock(sensor.clock_hz, sensor.clock_tolerance_ppm) for sensor in scene.sensors]
    chosen: list[TagClock] = []
    for tag in (tags + count * tags[:1])[:count]:
        best = _best(scene, chosen, tag)
        if best is None:
            return None
        chosen.append(best)
    alone = max(_variances(scene, [clock], 0.0).max() for clock in chosen)
    loss = _variances(scene, chosen, _clutter_hz(scene)).max() / alone
    return [clock.clock_hz for clock in chosen], float(10 * np.log10(loss))


def _best(scene: Scene, chosen: Sequence[TagClock], clock: TagClock) -> TagClock | None:
    """The clock of a further tag beside those chosen."""
    mains_hz = scene.environment.possible_mains_hz
    others_hz = np.array([other.clock_hz for other in chosen])
    apart_hz = _APART_BINS / scene.group_period_s
    found: list[tuple[float, float, TagClock]] = []
    for hertz in np.arange(_LOWEST_HZ, _HIGHEST_HZ + _STEP_HZ / 2, _STEP_HZ).tolist():
        trial = replace(clock, clock_hz=hertz)
        if np.any(line_distances_hz(np.array(hertz), others_hz) < apart_hz):
            continue
        if not _distinct(scene, [*others_hz.tolist(), hertz]):
            continue
        information = float(1 / _variances(scene, [*chosen, trial], _clutter_hz(scene)).max())
        found.append((information, float(lamp_distances_hz(hertz, mains_hz).min()), trial))
    if not found:
        return None
    most = max(information for information, _, _ in found)
    good = [each for each in found if each[0] >= _ABOUT_EQUAL * most]
    return max(good, key=lambda each: (each[1], each[0]))[2]


def _clutter_hz(scene: Scene) -> float:
    """Nothing is rejected at irregular times before a survey has found something."""
    return scene.environment.moving_clutter_hz or 0.0


def _distinct(scene: Scene, clocks_hz: Sequence[float]) -> bool:
    """Whether strong lines are those of one tag each, and not their own mirror images."""
    times_s, period_s = typical_times_s(scene), scene.group_period_s
    lines = timed_lines(clocks_hz, times_s, period_s, _clutter_hz(scene))
    alone = {owner for line in lines if len(line.owners) == 1 for owner in line.owners}
    return all({(tag, m), (tag, -m)} & alone for tag in range(len(clocks_hz)) for m in STRONG_LINES)


def _variances(scene: Scene, clocks: Sequence[TagClock], clutter_hz: float) -> np.ndarray:
    """Of the ends at the times of a typical group, beside clutter of a band; shape (2S,)."""
    times_s = typical_times_s(scene)
    clutter = np.linalg.qr(clutter_at(times_s, scene.group_period_s, clutter_hz))[0]
    return end_variances(clocks, times_s, scene.waveform().averaging_s, clutter)
