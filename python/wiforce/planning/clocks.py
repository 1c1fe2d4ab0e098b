# SPDX-License-Identifier: GPL-3.0-or-later
"""Which clocks tags can have: their lines, what they cost each other, and proposals."""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from ..estimation.clocks.tracked_tag import TagClock
from ..scene import load_scene
from ..signal.lines import (
    CLUTTER_MARGIN,
    HIGHEST_LINE,
    NYQUIST_MARGIN,
    lamp_distances_hz,
)
from ..signal.switching import harmonics
from .loss import BANDS_HZ, Snapshots, gram, tried_phases, typical_times_s, variances
from .plan import HARMONICS, Plan

# Lines of two tags: strong lines at the same number, or at numbers 1:2 and 1:4. Other pairs of
# lines 1, 2 and 4 are multiples of these.
_PAIRS = np.array([(1, 1), (1, 2), (2, 1), (1, 4), (4, 1)], float)


def line_distances_hz(one_hz: np.ndarray, other_hz: np.ndarray, tolerance_ppm: float) -> np.ndarray:
    """Least distance of strong lines of two tags at the worst errors of both clocks, in Hz."""
    a, b = _PAIRS.T
    ours = np.multiply.outer(one_hz, a)
    others = np.multiply.outer(other_hz, b)
    wander = 1e-6 * tolerance_ppm * (ours + others)
    return np.maximum(np.min(np.abs(ours - others) - wander, axis=-1), 0.0)


# An end that loses more than half its information to its neighbours, or to aliases, is not
# readable.
WORST_LOSS_DB = 3.0
_HIGHEST_HARMONIC = 64
# Clock phases that are tried; clocks that are multiples of each other hide one another at few.
_TRIALS = 48
_BATCHES = 8


class ClockReport(NamedTuple):
    """How well a set of switching clocks can be read, by the ends (2S,) of its tags."""

    information: np.ndarray  # q, the worst over relative clock phases and errors within tolerance
    loss_db: np.ndarray  # against the same switch alone, not aliased, with nothing moving

    @property
    def worst_loss_db(self) -> float:
        """Loss of the weakest end, in dB."""
        return float(self.loss_db.max())

    @property
    def problems(self) -> tuple[str, ...]:
        """Reasons why ends cannot be read, a sentence each; empty when all can."""
        return tuple(
            f"tag {end // 2 + 1}, end {end % 2 + 1}: loses {loss:.1f} dB because its signal "
            "resembles that of other ends, aliases or clutter"
            for end, loss in enumerate(self.loss_db)
            if loss > WORST_LOSS_DB
        )

    @property
    def readable(self) -> bool:
        """Whether every end of every tag can be read."""
        return self.worst_loss_db <= WORST_LOSS_DB


def assess_clocks(plan: Plan) -> ClockReport:
    """How well the ends of a plan's tags can be separated whose clocks are off by their tolerance.

    Information is the power per snapshot of what no other waveform explains, at the worst of some
    clock phases.
    """
    snapshots, clocks_hz = Snapshots.of(plan), np.array(plan.clocks_hz)
    starts = np.random.default_rng(0).random((_TRIALS, len(clocks_hz)))
    errors = np.add.outer(np.arange(_TRIALS), np.arange(len(clocks_hz))) % 3 - 1
    planned_ppm = np.array([clock.planned_ppm for clock in plan.clocks])
    trials_hz = clocks_hz * (1 + 1e-6 * planned_ppm * errors)
    # Some trials at once: all of them would take 100 MB for many tags in long groups.
    worst = np.max(
        [
            variances(gram(snapshots.ends(trials_hz[some], starts[some]))).max(axis=0)
            for some in np.array_split(np.arange(_TRIALS), _BATCHES)
        ],
        axis=0,
    )
    information = 1 / (worst * len(snapshots.times_s))
    ideal = _ideal_power(clocks_hz, plan.waveform.averaging_s)
    return ClockReport(information, 10 * np.log10(ideal / np.maximum(information, 1e-12)))


def _ideal_power(clocks_hz: np.ndarray, averaging_s: float) -> np.ndarray:
    """Power (2S,) of each switch's averaged waveform about its mean."""
    orders = np.arange(1, 4 * _HIGHEST_HARMONIC)[:, None]
    lines = harmonics(orders, clocks_hz * averaging_s)
    return 2 * np.sum(lines**2, axis=0).ravel()


def line_numbers(lines: Sequence[int]) -> str:
    """Lines of a tag in words, one or more."""
    *first, last = map(str, lines)
    return f"lines {', '.join(first)} and {last}" if first else f"line {last}"


def lamp_multiples(mains_hz: Sequence[float]) -> str:
    """The lines of lamps in words, for the mains frequencies that are possible."""
    return f"multiples of {' and '.join(f'{2 * hz:g}' for hz in mains_hz)} Hz"


# Clocks that are tried for packets: slow tags, whose oscillators are watch crystals and dividers.
# Higher ones gain nothing where packets are irregular, and meet their own aliases where they are
# regular.
_LOWEST_HZ, _HIGHEST_HZ, _PACKET_STEP_HZ = 50.0, 200.0, 1.0
# Distances of strong lines that are tried, in bins. Lines one bin apart are separate. More than
# two are only a reserve, so that they are given up for a place away from lamps.
_DISTANCES = ((4.0, 3.0, 2.0), (1.5,), (1.0,))
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
_CANDIDATES = 300
# Clocks that cost the weakest end so much more than the best one have about the same expected
# error: 5 % of the variance, 2.5 % of the standard deviation. Among them lamps decide.
_ABOUT_EQUAL = 0.05
# A tag changes its clock for one that lies half as far again from the lamps' lines, not for less.
FARTHER = 1.5
# Sets that are assessed before the search gives up.
_ATTEMPTS = 8


def propose_clocks(
    count: int,
    settings: Plan,
    tolerance_ppm: float = 100.0,
    mains_hz: Sequence[float] = (50.0, 60.0),
    near_hz: Sequence[float] = (),
) -> list[float]:
    """Clocks for ``count`` more tags beside those of a plan, chosen one after the other.

    Each costs the weakest end hardly more than the best candidate; among such, its strong lines lie
    farthest from lamps (``mains_hz``), then nearest to its present clock (``near_hz``, which orders
    the result). At the worst errors lines 1, 2 and 4 of tags are two bins apart, 1.5 or one where
    nothing else fits; an InputError says how many do.
    """
    search = _Search(settings, tolerance_ppm, mains_hz, near_hz)
    found = search.best(count)
    if found is None:
        fitting = bisect_left(range(1, count), True, key=lambda n: search.best(n) is None)
        beside = "beside these clocks " if settings.clocks else ""
        rule = (
            f"must be at most {fitting}: no more are found {beside}with lines 1, 2 and 4 one bin "
            f"({search.bin_hz:.3g} Hz) apart and every end readable; longer phase groups have "
            "smaller bins"
        )
        raise InputError("count", rule, count)
    # In the order that changes the clocks of the first tags least; further ones behind them.
    from scipy.optimize import linear_sum_assignment  # 0.1 s to import

    moved_hz = np.abs(np.subtract.outer(np.asarray(near_hz), np.asarray(found)))
    chosen = linear_sum_assignment(moved_hz)[1].tolist()
    return [found[i] for i in (*chosen, *sorted(set(range(count)) - {*chosen}))]


@dataclass(frozen=True)
class SceneClocks:
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
    mains_hz, stated_hz = scene.environment.possible_mains_hz, scene.environment.moving_clutter_hz
    tolerance_ppm = max(
        TagClock(sensor.clock_hz, sensor.clock_tolerance_ppm).planned_ppm
        for sensor in scene.sensors
    )
    times_s, length = typical_times_s(scene), scene.phase_group.snapshots
    # The plan rejects a wide band where the clocks leave room for it; at irregular times it rejects
    # nothing before a survey has found something.
    bands_hz = [BANDS_HZ[0], 0.0] if times_s is None else [0.0]
    for clutter_hz in bands_hz if stated_hz is None else [stated_hz]:
        settings = Plan(
            scene.waveform(), (), length, clutter_hz, HARMONICS[0], 1, 1, times_s=times_s
        )
        near_hz = [sensor.clock_hz for sensor in scene.sensors]
        try:
            clocks_hz = propose_clocks(count, settings, tolerance_ppm, mains_hz, near_hz)
            break
        except InputError:
            if clutter_hz in (0.0, stated_hz):
                raise
    one, other = np.array(clocks_hz)[np.array(np.triu_indices(count, 1))]
    distances_hz = line_distances_hz(one, other, tolerance_ppm)
    lamps_hz = lamp_distances_hz(clocks_hz, mains_hz).min(axis=1)
    return SceneClocks(
        clocks_hz,
        float(distances_hz.min()) if count > 1 else None,
        lamps_hz.tolist() if mains_hz else None,
        1 / scene.group_period_s,
        assess_clocks(_with_tags(settings, clocks_hz, tolerance_ppm)).worst_loss_db,
    )


def _with_tags(settings: Plan, clocks_hz: Sequence[float], tolerance_ppm: float) -> Plan:
    """Settings with these tags as well, before those that they have."""
    more = tuple(TagClock(hz, tolerance_ppm) for hz in clocks_hz)
    return replace(settings, clocks=(*more, *settings.clocks), room=None)


class _Search:
    """Chooses clocks that fit together, and beside those of a plan, from candidates."""

    def __init__(
        self,
        settings: Plan,
        tolerance_ppm: float,
        mains_hz: Sequence[float],
        near_hz: Sequence[float],
    ) -> None:
        self._settings, self._tolerance_ppm, self._near_hz = settings, tolerance_ppm, near_hz
        self.bin_hz = 1 / (settings.group_length * settings.waveform.snapshot_period_s)
        found = _candidates(settings, self.bin_hz, tolerance_ppm, near_hz)
        self._grid, self._clocks = found, np.r_[found, settings.clocks_hz]
        self._distances_hz = line_distances_hz(found[:, None], self._clocks, tolerance_ppm)
        self._lamps_hz = lamp_distances_hz(found, mains_hz).min(axis=1)

    @cached_property
    def _gram(self) -> np.ndarray:
        """Products (3, 2C, 2C) of the ends of all clocks at some phases, over their power."""
        snapshots = Snapshots.of(self._settings)
        power = _ideal_power(self._clocks, snapshots.averaging_s) * len(snapshots.times_s)
        # One phase at a time: many clocks in long groups take 50 MB each.
        return np.stack(
            [
                gram(snapshots.ends(hz[None], start[None])[0]) / np.sqrt(np.outer(power, power))
                for hz, start in zip(*tried_phases(self._clocks), strict=True)
            ]
        )

    def best(self, count: int) -> list[float] | None:
        """Clocks of ``count`` tags at the best distance of their lines; None without any."""
        for distances in _DISTANCES:
            sets = (self._readable(count, bins * self.bin_hz) for bins in distances)
            possible = [chosen for chosen in sets if chosen is not None]
            if possible:
                best = max(possible, key=lambda c: np.sum(self._lamps_hz[c] >= self.bin_hz))
                return self._clocks[best].tolist()
        return None

    def _readable(self, count: int, distance_hz: float) -> list[int] | None:
        """``count`` candidates with which all ends are readable; None where none are found."""
        conflicts = self._distances_hz < distance_hz
        # Those in use are behind the candidates.
        others = len(self._grid)
        conflicts, free = conflicts[:, :others], ~conflicts[:, others:].any(axis=1)
        for _ in range(_ATTEMPTS):
            chosen = self._fill(count, conflicts, free)
            if chosen is None:
                return None
            report = assess_clocks(self._with(chosen))
            if report.readable:
                return chosen
            free[chosen[int(np.argmax(report.loss_db[: 2 * count])) // 2]] = False
        return None

    def _fill(self, count: int, conflicts: np.ndarray, free: np.ndarray) -> list[int] | None:
        """``count`` candidates, the best one first; None where lines cannot be distinguished."""
        chosen: list[int] = []
        near_hz = [*self._near_hz]
        while len(chosen) < count:
            possible = np.flatnonzero(free)
            apart_hz = np.abs(np.subtract.outer(self._grid[possible], near_hz))
            moved_hz = apart_hz.min(axis=1, initial=np.inf)
            for best in possible[self._ranked(chosen, possible, moved_hz)].tolist():
                if self._with([*chosen, best]).separable:
                    break
            else:
                return None
            free = free & ~conflicts[best]
            chosen.append(best)
            if near_hz:
                near_hz.remove(min(near_hz, key=lambda hz: abs(hz - self._clocks[best])))
        return chosen

    def _ranked(
        self, chosen: Sequence[int], possible: np.ndarray, moved_hz: np.ndarray
    ) -> np.ndarray:
        """Order of candidates: those of about the least cost by lamps, then those by cost.

        A clock that a tag has now stays unless another lies half as far again from lamps.
        """
        if not len(possible):
            return possible
        beside = [*range(len(self._grid), len(self._clocks)), *chosen]
        tags = np.column_stack([np.tile(beside, (len(possible), 1)), possible]).astype(int)
        ends = (2 * tags[:, :, None] + np.arange(2)).reshape(len(possible), -1)
        found = variances(self._gram[:, ends[:, :, None], ends[:, None, :]])
        cost = found.mean(axis=0).max(axis=-1)
        good = cost <= (1 + _ABOUT_EQUAL) * cost.min()
        # A tag's own clock counts as farther, by hardly less than the factor for which it changes.
        lamps = self._lamps_hz[possible] * np.where(moved_hz < _SAME_HZ, FARTHER * (1 - 1e-9), 1.0)
        return np.lexsort((cost, *np.where(good, (moved_hz, -lamps), 0.0), ~good))

    def _with(self, tags: Sequence[int]) -> Plan:
        """The settings with some of the candidates as well."""
        return _with_tags(self._settings, self._clocks[tags].tolist(), self._tolerance_ppm)


def _candidates(
    settings: Plan, bin_hz: float, tolerance_ppm: float, near_hz: Sequence[float]
) -> np.ndarray:
    """Frequencies in Hz, ascending, within three octaves, beyond which lines cannot coincide.

    They are those of ``near_hz`` and multiples of 5 Hz or half a bin, for packets of 1 Hz.
    """
    if settings.times_s is not None:
        return np.arange(_LOWEST_HZ, _HIGHEST_HZ + _PACKET_STEP_HZ / 2, _PACKET_STEP_HZ)
    nyquist_hz = 0.5 / settings.waveform.snapshot_period_s
    highest_hz = min(NYQUIST_MARGIN * nyquist_hz, nyquist_hz - CLUTTER_MARGIN * bin_hz)
    highest_hz /= HIGHEST_LINE * (1 + 1e-6 * tolerance_ppm)
    fewest_hz = max(_FEWEST_CLEAR_BINS * bin_hz, _CLEAR_PART * (highest_hz - settings.clutter_hz))
    clear_hz = min(_CLEAR_BINS * bin_hz, fewest_hz)
    lowest_hz = max(settings.clutter_hz + clear_hz, highest_hz / 8)
    if lowest_hz >= highest_hz:
        return np.empty(0)
    wanted_hz = max(min(_STEP_HZ, bin_hz / 2), (highest_hz - lowest_hz) / _CANDIDATES)
    decade = 10 ** np.floor(np.log10(wanted_hz))
    step = decade * max(s for s in (1, 2, 5) if s * decade <= wanted_hz * (1 + 1e-9))
    found = np.arange(np.ceil(lowest_hz / step), np.floor(highest_hz / step) + 1) * step
    own = np.unique([hz for hz in near_hz if lowest_hz <= hz <= highest_hz])
    other = np.abs(np.subtract.outer(found, own)).min(axis=1, initial=np.inf) >= _SAME_HZ
    return np.sort(np.concatenate([found[other], own]))
