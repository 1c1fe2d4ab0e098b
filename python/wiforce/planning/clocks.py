# SPDX-License-Identifier: GPL-3.0-or-later
"""Which clocks tags can have: their lines, what they cost each other, and proposals."""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from ..estimation.clocks.likelihood import PHASE_MARGIN, own_lines, phase_margin
from ..estimation.clocks.tracked_tag import TagClock
from ..scene import Scene, load_scene
from ..signal.lines import (
    CLUTTER_MARGIN,
    HIGHEST_LINE,
    NYQUIST_MARGIN,
    STRONG_LINES,
    aliased_hz,
    centered_times_s,
    clutter_basis,
    lamp_distances_hz,
    tag_lines,
)
from ..signal.switching import harmonics
from ..signal.timed_weights import timed_lines
from ..signal.waveform import Waveform
from ..signal.weights import WORST_GAIN, design_weights
from .loss import (
    BANDS_HZ,
    end_variances,
    end_waveforms,
    timed_clutter,
    typical_times_s,
    variances,
)
from .plan import Plan

# Lines of two tags: strong lines at the same number, or at numbers 1:2 and 1:4. Other pairs of
# lines 1, 2 and 4 are multiples of these.
_PAIRS = np.array([(1, 1), (1, 2), (2, 1), (1, 4), (4, 1)], float)
# Lines whose overlaps are added up; line 16 is 24 dB below line 1.
_HARMONICS = 16


def line_distances_hz(
    one_hz: np.ndarray, other_hz: np.ndarray, tolerance_ppm: float = 0.0
) -> np.ndarray:
    """Least distance of strong lines of two tags at the worst errors of both clocks, in Hz."""
    a, b = _PAIRS.T
    ours = np.multiply.outer(one_hz, a)
    others = np.multiply.outer(other_hz, b)
    wander = 1e-6 * tolerance_ppm * (ours + others)
    return np.maximum(np.min(np.abs(ours - others) - wander, axis=-1), 0.0)


@dataclass(frozen=True)
class LineTable:
    """Lines of C clocks, which may be off by ``tolerance_ppm``, as snapshots show them."""

    clocks_hz: np.ndarray
    waveform: Waveform
    group_length: int
    tolerance_ppm: float

    @cached_property
    def _amplitudes(self) -> np.ndarray:
        """Of the lines, for waveforms of unit power; shape (C, 2, harmonics)."""
        m = np.arange(1, _HARMONICS + 1)
        averaged = self.clocks_hz[:, None] * self.waveform.averaging_s
        lines = np.abs(harmonics(m)).T * np.abs(np.sinc(averaged * m))[:, None, :]
        return lines / np.sqrt(np.sum(lines**2, axis=-1, keepdims=True))

    def overlaps(self, index: int, chosen: np.ndarray | None = None) -> np.ndarray:
        """Share (C', 2, 2) of ``chosen`` tags' power that ends of another may explain, at worst."""
        rows = np.arange(len(self.clocks_hz)) if chosen is None else chosen
        m = np.arange(1, _HARMONICS + 1)
        ours = self.clocks_hz[rows, None, None] * m[:, None]
        others = self.clocks_hz[index] * m
        total = np.zeros((len(rows), 2, 2))
        for sign in (1, -1):
            near = self._near(ours - sign * others, ours + others)
            if sign == 1:
                near[rows == index] *= 1 - np.eye(_HARMONICS)
            total += self._amplitudes[rows] @ near @ self._amplitudes[index].T
        return np.minimum(total, 1.0) ** 2

    def noise_gain(self, frequencies_hz: np.ndarray) -> float:
        """Noise of the worst tone by least squares, over that of a Fourier sum."""
        cycles = np.subtract.outer(frequencies_hz, frequencies_hz)
        cycles *= np.pi * self.waveform.snapshot_period_s
        np.fill_diagonal(cycles, np.pi / 2)
        overlap = np.sin(self.group_length * cycles) / (self.group_length * np.sin(cycles))
        np.fill_diagonal(overlap, 1.0)
        try:
            return float(np.max(np.diag(np.linalg.inv(overlap))))
        except np.linalg.LinAlgError:
            return np.inf

    def _near(self, apart_hz: np.ndarray, wander_hz: np.ndarray) -> np.ndarray:
        """1 for lines that coincide, 0 for those a bin or more apart."""
        rate = 1 / self.waveform.snapshot_period_s
        apart = np.abs((apart_hz + rate / 2) % rate - rate / 2)
        apart = np.maximum(apart - 1e-6 * self.tolerance_ppm * wander_hz, 0)
        return np.maximum(1 - apart * self.group_length / rate, 0)


def count_that_fit(conflicts: np.ndarray, free: np.ndarray, start: int = 0) -> int:
    """Clocks of one octave, a circle, without ``conflicts`` (C, C) that fit from a free one on."""
    open_ = np.roll(free, -start)
    turned = np.roll(conflicts, (-start, -start), axis=(0, 1))
    count = 0
    while open_.any():
        open_ = open_ & ~turned[np.argmax(open_)]
        count += 1
    return count


def most_that_fit(conflicts: np.ndarray, free: np.ndarray) -> int:
    """The largest of :func:`count_that_fit` over all starts."""
    if not free.any():
        return 0
    first = int(np.argmax(free))
    # Whatever the best choice is, it has a clock that conflicts with the first free one or is it.
    starts = np.flatnonzero(free & (conflicts[first] | (np.arange(len(free)) == first)))
    return max(count_that_fit(conflicts, free, int(start)) for start in starts)


# An end that loses more than half its information to its neighbours, or to aliases, is not
# readable.
WORST_LOSS_DB = 3.0
# Lines that are weaker than this share of the strongest one of their end do not collide: -20 dB.
_WEAKEST_LINE = 0.1
_HIGHEST_HARMONIC = 64
# Clock phases that are tried; clocks that are multiples of each other hide one another at few.
_TRIALS = 48
_BATCHES = 8


class End(NamedTuple):
    """An end of a tag: its information, and what the other ends cost it."""

    tag: int  # from 0; ``end`` is 1 or 2
    end: int
    information: float  # q, the worst over relative clock phases and clock errors within tolerance
    loss_db: float  # against the same switch alone, not aliased, with nothing moving


class ClockReport(NamedTuple):
    """How well a set of switching clocks can be read."""

    ends: tuple[End, ...]  # two per tag
    # Per tag, the part of its signal that distinguishes the right clock phase from the wrong one
    # that resembles it most; 0 when the ends could be swapped.
    phase_margins: tuple[float, ...]
    # Lines of two tags that a group cannot resolve: (tag, harmonic, other tag, its harmonic).
    collisions: tuple[tuple[int, int, int, int], ...]

    @property
    def worst_loss_db(self) -> float:
        """Loss of the weakest end, in dB."""
        return max(end.loss_db for end in self.ends)

    @property
    def problems(self) -> tuple[str, ...]:
        """Reasons why ends cannot be read, a sentence each; empty when all can."""
        found = [
            f"tag {end.tag + 1}, end {end.end}: loses {end.loss_db:.1f} dB because its signal "
            "resembles that of other ends, aliases or clutter"
            for end in self.ends
            if end.loss_db > WORST_LOSS_DB
        ]
        found += [
            f"tag {tag + 1}: two phases of its clock look alike, so that its ends could be swapped"
            for tag, margin in enumerate(self.phase_margins)
            if margin < PHASE_MARGIN
        ]
        return tuple(found)

    @property
    def readable(self) -> bool:
        """Whether every end of every tag can be read."""
        return not self.problems


def assess_clocks(
    clocks_hz: Sequence[float],
    waveform: Waveform,
    group_length: int,
    tolerance_ppm: float = 100.0,
    clutter_hz: float = 0.0,
) -> ClockReport:
    """How well the ends of tags can be separated whose clocks may be off by ``tolerance_ppm``."""
    information = worst_information(clocks_hz, waveform, group_length, tolerance_ppm, clutter_hz)
    ends = []
    for (tag, end), q in zip(product(range(len(clocks_hz)), (1, 2)), information, strict=True):
        # Power of the switch's averaged waveform about its mean.
        orders = np.arange(1, 4 * _HIGHEST_HARMONIC)
        lines = harmonics(orders, clocks_hz[tag] * waveform.averaging_s)[:, end - 1]
        ideal = 2 * np.sum(np.square(lines))
        loss_db = 10 * np.log10(ideal / max(q, 1e-12))
        ends.append(End(tag, end, float(q), float(loss_db)))
    every = np.r_[-_HIGHEST_HARMONIC:0, 1 : _HIGHEST_HARMONIC + 1]
    margins = tuple(
        phase_margin(harmonics(every, f * waveform.averaging_s), every) for f in clocks_hz
    )
    collisions = _collisions(clocks_hz, waveform, group_length, tolerance_ppm)
    return ClockReport(tuple(ends), margins, tuple(sorted(collisions)))


def _collisions(
    clocks_hz: Sequence[float], waveform: Waveform, group_length: int, tolerance_ppm: float
) -> Iterator[tuple[int, int, int, int]]:
    """Lines of two tags, as snapshots show them, that a group cannot resolve."""
    rate, m = 1 / waveform.snapshot_period_s, np.arange(1, _HIGHEST_HARMONIC + 1)
    own = []  # harmonics of either end of a tag, their frequencies, and where they are shown
    for clock_hz in clocks_hz:
        levels = np.abs(harmonics(m, clock_hz * waveform.averaging_s))
        strong = m[(levels >= _WEAKEST_LINE * levels.max(axis=0)).any(axis=1)]
        own.append((strong, strong * clock_hz, np.abs(aliased_hz(strong * clock_hz, rate))))
    for tag, other in combinations(range(len(clocks_hz)), 2):
        (lines, hz, seen_hz), (others, other_hz, other_seen_hz) = own[tag], own[other]
        reach = rate / group_length + 1e-6 * tolerance_ppm * np.add.outer(hz, other_hz)
        rows, columns = np.nonzero(np.abs(np.subtract.outer(seen_hz, other_seen_hz)) < reach)
        for row, column in zip(rows, columns, strict=True):
            yield tag, int(lines[row]), other, int(others[column])


def worst_information(
    clocks_hz: Sequence[float],
    waveform: Waveform,
    group_length: int,
    tolerance_ppm: float,
    clutter_hz: float,
) -> np.ndarray:
    """Power per snapshot (2S,) of what no other waveform explains, at the worst clock phases."""
    period_s, averaging_s = waveform.snapshot_period_s, waveform.averaging_s
    times_s = centered_times_s(group_length, period_s)
    clutter = clutter_basis(group_length, period_s, clutter_hz)
    worst = np.zeros(2 * len(clocks_hz))
    starts = np.random.default_rng(0).random((_TRIALS, len(clocks_hz)))
    errors = np.add.outer(np.arange(_TRIALS), np.arange(len(clocks_hz))) % 3 - 1
    trials_hz = np.array(clocks_hz) * (1 + 1e-6 * tolerance_ppm * errors)
    # Some trials at once: all of them would take 100 MB for many tags in long groups.
    for some in np.array_split(np.arange(_TRIALS), _BATCHES):
        waveforms = end_waveforms(trials_hz[some], starts[some], times_s, averaging_s, clutter)
        worst = np.maximum(worst, variances(waveforms).max(axis=0))
    return 1 / (worst * group_length)


class LampLines(NamedTuple):
    """A tag with strong lines that a phase group cannot separate from those of lamps."""

    tag: int
    lines: tuple[int, ...]  # of its lines 1, 2 and 4, those next to a lamp's line
    distance_hz: float  # least distance of a strong line to a lamp's line


def lines_near_lamps(plan: Plan, bins: float = 1.0) -> Iterator[LampLines]:
    """Tags of a scene whose strong lines lie within some bins of those of lamps."""
    mains_hz = plan.require_scene().environment.possible_mains_hz
    near_hz = bins / plan.group_period_s
    for tag, clock in enumerate(plan.clocks):
        distances_hz = lamp_distances_hz(clock.clock_hz, mains_hz)
        near = tuple(m for m, hz in zip(STRONG_LINES, distances_hz, strict=True) if hz < near_hz)
        if near:
            yield LampLines(tag, near, float(distances_hz.min()))


def line_numbers(lines: Sequence[int]) -> str:
    """Lines of a tag in words, one or more."""
    *first, last = map(str, lines)
    return f"lines {', '.join(first)} and {last}" if first else f"line {last}"


def lines_lie(lines: Sequence[int], sensor: str) -> str:
    """Lines of a tag and the verb of a sentence that says where they lie."""
    verb = "lies" if len(lines) == 1 else "lie"
    return f"{line_numbers(lines)} of '{sensor}' {verb}"


def lamp_multiples(mains_hz: Sequence[float]) -> str:
    """The lines of lamps in words, for the mains frequencies that are possible."""
    return f"multiples of {' and '.join(f'{2 * hz:g}' for hz in mains_hz)} Hz"


# Clocks that are tried: slow tags, whose oscillators are watch crystals and dividers. Higher ones
# gain nothing where packets are irregular, and meet their own aliases where they are regular.
_LOWEST_HZ, _HIGHEST_HZ, _PACKET_STEP_HZ = 50.0, 200.0, 1.0
# Bins between strong lines of two tags.
_APART_BINS = 4


def packet_clocks(scene: Scene, count: int) -> tuple[list[float], float] | None:
    """Clocks in Hz as :func:`_ranked`, and what the weakest end loses in dB; None if none."""
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
    others_hz = [other.clock_hz for other in chosen]
    candidates = np.arange(_LOWEST_HZ, _HIGHEST_HZ + _PACKET_STEP_HZ / 2, _PACKET_STEP_HZ)
    apart_hz = line_distances_hz(candidates[:, None], np.array(others_hz))
    candidates = candidates[(apart_hz >= _APART_BINS / scene.group_period_s).all(axis=1)]
    possible_hz = [hz for hz in candidates.tolist() if _distinct(scene, [*others_hz, hz])]
    trials = [replace(clock, clock_hz=hz) for hz in possible_hz]
    if not trials:
        return None
    variance = [_variances(scene, [*chosen, t], _clutter_hz(scene)).max() for t in trials]
    lamps_hz = _lamp_distances_hz(possible_hz, scene.environment.possible_mains_hz)
    return trials[next(_ranked(np.array(variance) / min(variance), lamps_hz))]


def _lamp_distances_hz(
    clocks_hz: Sequence[float] | np.ndarray, mains_hz: Sequence[float]
) -> np.ndarray:
    """Least distance of strong lines of each clock from those of lamps, in Hz."""
    return np.array([lamp_distances_hz(hz, mains_hz).min() for hz in clocks_hz])


def _ranked(
    cost: np.ndarray, lamps_hz: np.ndarray, moved_hz: np.ndarray | None = None
) -> Iterator[int]:
    """Candidates of about the least cost, by lamps and cost, the best one first.

    A clock that a tag has now stays unless another lies half as far again from lamps.
    """
    if not cost.size:
        return
    moved = np.full(cost.shape, np.inf) if moved_hz is None else moved_hz
    good = cost <= cost.min() + _ABOUT_EQUAL
    # A tag's own clock counts as farther, by hardly less than the factor for which it changes.
    lamps = lamps_hz * np.where(moved < _SAME_HZ, FARTHER * (1 - 1e-9), 1.0)
    order = np.lexsort((cost, *np.where(good, (moved, -lamps), 0.0), ~good))
    yield from map(int, order)


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
    clutter = timed_clutter(times_s, scene.group_period_s, clutter_hz)
    return end_variances(clocks, times_s, scene.waveform().averaging_s, clutter)


# Distances of strong lines that are tried, in bins. Lines one bin apart are separate. More than
# two are only a reserve, so that they are given up for a place away from lamps.
_GENEROUS, _CLOSE = (4.0, 3.0, 2.0), (1.5, 1.0)
# Bins between the lowest clock and clutter: at ten bins their sidelobes cost 0.1 dB, at three up to
# 1 dB. Short groups have to do with less than ten where this would take more than a quarter of all
# clocks.
_CLEAR_BINS, _FEWEST_CLEAR_BINS, _CLEAR_PART = 10, 3, 0.25
# Clocks are multiples of this, or of less where half a bin is less: crystals and dividers are
# bought for round numbers.
_STEP_HZ = 5.0
# Clocks that differ by less are one, given with other digits.
_SAME_HZ = 1e-6
# Clocks that are compared; a finer grid would only take longer.
_CANDIDATES = 1000
# Clocks that cost the weakest end so much more than the best one have about the same expected
# error: 5 % of the variance, 2.5 % of the standard deviation. Among them lamps decide.
_ABOUT_EQUAL = 0.05
# A tag changes its clock for one that lies half as far again from the lamps' lines, not for less.
FARTHER = 1.5
# Sets that are assessed before the search gives up.
_ATTEMPTS = 8


def propose_clocks(
    count: int,
    waveform: Waveform,
    group_length: int,
    taken: Sequence[float] = (),
    tolerance_ppm: float = 100.0,
    clutter_hz: float = 0.0,
    mains_hz: Sequence[float] = (50.0, 60.0),
    near_hz: Sequence[float] = (),
    avoid_hz: Sequence[float] = (),
) -> list[float]:
    """Clocks for ``count`` more tags beside those ``taken``, chosen one after the other.

    Each costs the weakest end hardly more than the best candidate; among such, its strong lines lie
    farthest from lamps (``mains_hz``), then nearest to its present clock (``near_hz``, which orders
    the result). At the worst errors lines 1, 2 and 4 of tags are two bins apart, 1.5 or one where
    nothing else fits; an InputError says how many do. Candidates are ``near_hz`` and multiples of 5
    Hz or half a bin.
    """
    settings = waveform, group_length, tolerance_ppm, clutter_hz
    bin_hz = 1 / (group_length * waveform.snapshot_period_s)
    candidates = _candidates(waveform, bin_hz, clutter_hz, tolerance_ppm, near_hz)
    apart_hz = np.multiply.outer(candidates, STRONG_LINES)[..., None] - np.asarray(avoid_hz)
    candidates = candidates[np.abs(apart_hz).min(axis=(1, 2), initial=np.inf) >= bin_hz]
    search = _Search(candidates, taken, settings, mains_hz, near_hz)
    found = search.best(count, bin_hz)
    if found is None:
        fewer = range(1, count)
        fitting = bisect_left(fewer, True, key=lambda n: search.best(n, bin_hz) is None)
        beside = "beside these clocks " if taken else ""
        rule = (
            f"must be at most {fitting}: no more tags fit {beside}with lines 1, 2 and 4 one bin "
            f"({bin_hz:.3g} Hz) apart and every end readable; longer phase groups have smaller bins"
        )
        raise InputError("count", rule, count)
    return _in_order_of_tags(found, near_hz)


def _in_order_of_tags(clocks_hz: Sequence[float], near_hz: Sequence[float]) -> list[float]:
    """Clocks in an order that changes those of the first tags least; further ones behind them."""
    from scipy.optimize import linear_sum_assignment  # 0.1 s to import

    moved_hz = np.abs(np.subtract.outer(np.asarray(near_hz), np.asarray(clocks_hz)))
    chosen = linear_sum_assignment(moved_hz)[1].tolist()
    return [clocks_hz[i] for i in (*chosen, *sorted(set(range(len(clocks_hz))) - {*chosen}))]


@dataclass(frozen=True)
class SceneClocks:
    """Clocks for the tags of a scene."""

    clocks_hz: list[float]
    # Least one of lines 1, 2 and 4 of two tags, clocks off by their tolerance.
    line_distance_hz: float | None
    # Of these lines of each tag to a lamp's; None where lamps are excluded.
    lamp_distances_hz: list[float] | None
    bin_hz: float  # inverse of the length of a phase group
    worst_loss_db: float  # what neighbours, aliases and clutter cost the weakest end


def clocks_for(scene: Any, count: int) -> SceneClocks:
    """Clocks for tags in a scene's frames and room; its own are kept where as good."""
    scene = load_scene(scene)
    mains_hz = scene.environment.possible_mains_hz
    tags = [TagClock(sensor.clock_hz, sensor.clock_tolerance_ppm) for sensor in scene.sensors]
    tolerance_ppm = max(tag.planned_ppm for tag in tags)
    choose = _clocks_on_grid if scene.packets is None else _clocks_of_packets
    clocks_hz, loss_db = choose(scene, count, tolerance_ppm)
    clocks = np.array(clocks_hz)
    one, other = np.triu_indices(count, 1)
    distances = line_distances_hz(clocks[one], clocks[other], tolerance_ppm)
    lamps = [float(lamp_distances_hz(hz, mains_hz).min()) for hz in clocks_hz]
    return SceneClocks(
        clocks_hz,
        float(distances.min()) if count > 1 else None,
        lamps if mains_hz else None,
        1 / scene.group_period_s,
        loss_db,
    )


def _clocks_on_grid(scene: Scene, count: int, tolerance_ppm: float) -> tuple[list[float], float]:
    """Clocks for snapshots at regular times, and what the weakest end loses, in dB."""
    waveform, group_length = scene.waveform(), scene.phase_group.snapshots
    stated_hz = scene.environment.moving_clutter_hz
    # The plan rejects a wide band where the clocks leave room for it.
    for clutter_hz in [BANDS_HZ[0], 0.0] if stated_hz is None else [stated_hz]:
        try:
            clocks_hz = propose_clocks(
                count,
                waveform,
                group_length,
                tolerance_ppm=tolerance_ppm,
                clutter_hz=clutter_hz,
                mains_hz=scene.environment.possible_mains_hz,
                near_hz=[sensor.clock_hz for sensor in scene.sensors],
            )
            break
        except InputError:
            if clutter_hz in (0.0, stated_hz):
                raise
    report = assess_clocks(clocks_hz, waveform, group_length, tolerance_ppm, clutter_hz)
    return clocks_hz, report.worst_loss_db


def _clocks_of_packets(scene: Scene, count: int, tolerance_ppm: float) -> tuple[list[float], float]:
    """The same for snapshots at the times of packets."""
    found = packet_clocks(scene, count)
    if found is None:
        raise InputError("count", "must be fewer: no more tags can be separated", count)
    return _in_order_of_tags(found[0], [sensor.clock_hz for sensor in scene.sensors]), found[1]


class _Search:
    """Chooses from candidates those that fit together."""

    def __init__(
        self,
        candidates: np.ndarray,
        taken: Sequence[float],
        settings: tuple[Waveform, int, float, float],
        mains_hz: Sequence[float],
        near_hz: Sequence[float] = (),
    ) -> None:
        waveform, group_length, tolerance_ppm, self._clutter_hz = settings
        self._settings, self._candidates, self._near_hz = settings, candidates, near_hz
        self._taken = [float(hz) for hz in taken]
        self._clocks = np.r_[candidates, self._taken]
        self._lines = LineTable(self._clocks, waveform, group_length, tolerance_ppm)
        self._distances_hz = line_distances_hz(candidates[:, None], self._clocks, tolerance_ppm)
        self._lamps_hz = _lamp_distances_hz(candidates, mains_hz)
        # The highest octave, where most fit.
        self._octave = np.flatnonzero(candidates > candidates.max(initial=0) / 2)
        every = range(len(self._clocks))
        own = [self._lines.overlaps(i, np.array([i]))[0].sum(axis=1) for i in every]
        # Of each end: what its tag's own aliases cost it.
        self._own_losses = np.reshape(own, (len(every), 2))

    def best(self, count: int, bin_hz: float) -> list[float] | None:
        """Clocks of ``count`` tags at the best distance of their lines; None without any."""
        possible = []
        for bins in _GENEROUS:
            chosen = self._readable(count, bins * bin_hz)
            if chosen is not None:
                possible.append((np.sum(self._lamps_hz[chosen] >= bin_hz), bins, chosen))
        if possible:
            return self._clocks[max(possible, key=lambda each: each[:2])[2]].tolist()
        for bins in _CLOSE:
            chosen = self._readable(count, bins * bin_hz)
            if chosen is not None:
                return self._clocks[chosen].tolist()
        return None

    def _constraints(self, distance_hz: float) -> tuple[np.ndarray, np.ndarray]:
        """Which candidates are too near to each other, and which are not to those in use."""
        conflicts = self._distances_hz < distance_hz
        count = len(self._candidates)
        return conflicts[:, :count], ~conflicts[:, count:].any(axis=1)

    def _packed(self, conflicts: np.ndarray, free: np.ndarray) -> int:
        """The largest number of free candidates of the highest octave without a conflict."""
        return most_that_fit(conflicts[np.ix_(self._octave, self._octave)], free[self._octave])

    def _readable(self, count: int, distance_hz: float) -> list[int] | None:
        """``count`` candidates with which all ends are readable; None where none are found."""
        conflicts, free = self._constraints(distance_hz)
        for _ in range(_ATTEMPTS):
            if self._packed(conflicts, free) < count:
                return None
            chosen = self._fill(count, conflicts, free)
            if chosen is None:
                return None
            clocks_hz = [*self._taken, *self._clocks[chosen]]
            report = assess_clocks(clocks_hz, *self._settings)
            if report.readable and (self._clutter_hz == 0 or self._accepted(clocks_hz)):
                return chosen
            added = report.ends[2 * len(self._taken) :]
            worst = max(added, key=lambda end: end.loss_db)
            free[chosen[worst.tag - len(self._taken)]] = False
        return None

    def _fill(self, count: int, conflicts: np.ndarray, free: np.ndarray) -> list[int] | None:
        """``count`` candidates, the best one first; None where lines cannot be distinguished."""
        lost = self._own_losses.copy()
        overlaps: dict[int, np.ndarray] = {}
        for tag in range(len(self._candidates), len(self._clocks)):
            self._add(tag, overlaps, lost)
        chosen: list[int] = []
        near_hz = [*self._near_hz]
        while len(chosen) < count:
            cost = lost[: len(free)].max(axis=1)
            for tag, overlap in overlaps.items():
                cost = np.maximum(cost, (lost[tag] + overlap[: len(free)].sum(axis=1)).max(axis=1))
            apart_hz = np.abs(np.subtract.outer(self._candidates, near_hz))
            moved_hz = apart_hz.min(axis=1, initial=np.inf)
            for each in _ranked(cost[free], self._lamps_hz[free], moved_hz[free]):
                best = int(np.flatnonzero(free)[each])
                rest = free & ~conflicts[best]
                fits = self._packed(conflicts, rest) >= count - len(chosen) - 1
                if fits and self._separable([*overlaps, best]):
                    break
            else:
                return None
            free = rest
            chosen.append(best)
            if near_hz:
                near_hz.remove(min(near_hz, key=lambda hz: abs(hz - self._clocks[best])))
            self._add(best, overlaps, lost)
        return chosen

    def _add(self, tag: int, overlaps: dict[int, np.ndarray], lost: np.ndarray) -> None:
        """Add what a tag costs the ends of all others, and what those before it cost its own."""
        overlap = self._lines.overlaps(tag)
        overlap[tag] = 0.0
        lost += overlap.sum(axis=2)
        overlaps[tag] = overlap

    def _separable(self, tags: Sequence[int]) -> bool:
        """Whether a receiver can separate the lines that it uses at least."""
        clocks_hz, lines = self._clocks[list(tags)], self._lines
        tones = tag_lines(
            clocks_hz,
            lines.waveform.snapshot_period_s,
            lines.group_length,
            clutter_hz=self._clutter_hz,
        )
        for tag, clock_hz in enumerate(clocks_hz):
            _, own = own_lines(tones, tag)
            spectra = harmonics(own, clock_hz * lines.waveform.averaging_s)
            if phase_margin(spectra, own) < PHASE_MARGIN:
                return False
        frequencies_hz = np.array([0.0, *(tone.frequency_hz for tone in tones)])
        return lines.noise_gain(frequencies_hz) <= WORST_GAIN

    def _accepted(self, clocks_hz: Sequence[float]) -> bool:
        """Whether the receiver's weights can be designed, clutter included."""
        waveform, group_length = self._lines.waveform, self._lines.group_length
        period_s = waveform.snapshot_period_s
        try:
            design_weights(clocks_hz, group_length, period_s, self._clutter_hz)
        except InputError:
            return False
        return True


def _candidates(
    waveform: Waveform,
    bin_hz: float,
    clutter_hz: float,
    tolerance_ppm: float,
    near_hz: Sequence[float] = (),
) -> np.ndarray:
    """Frequencies in Hz, ascending, within three octaves, beyond which lines cannot coincide."""
    nyquist_hz = 0.5 / waveform.snapshot_period_s
    highest_hz = NYQUIST_MARGIN * nyquist_hz / HIGHEST_LINE
    highest_hz = min(highest_hz, (nyquist_hz - CLUTTER_MARGIN * bin_hz) / HIGHEST_LINE)
    highest_hz /= 1 + 1e-6 * tolerance_ppm
    fewest_hz = max(_FEWEST_CLEAR_BINS * bin_hz, _CLEAR_PART * (highest_hz - clutter_hz))
    lowest_hz = max(clutter_hz + min(_CLEAR_BINS * bin_hz, fewest_hz), highest_hz / 8)
    if lowest_hz >= highest_hz:
        return np.empty(0)
    wanted_hz = max(min(_STEP_HZ, bin_hz / 2), (highest_hz - lowest_hz) / _CANDIDATES)
    decade = 10 ** np.floor(np.log10(wanted_hz))
    step = decade * max(s for s in (1, 2, 5) if s * decade <= wanted_hz * (1 + 1e-9))
    found = np.arange(np.ceil(lowest_hz / step), np.floor(highest_hz / step) + 1) * step
    own = np.unique([hz for hz in near_hz if lowest_hz <= hz <= highest_hz])
    other = [bool((np.abs(own - hz) >= _SAME_HZ).all()) for hz in found]
    return np.sort(np.concatenate([found[np.array(other, bool)], own]))
