# SPDX-License-Identifier: GPL-3.0-or-later
"""Search for clocks of many tags, or of further tags beside those that are on the air.

Clocks are chosen one after the other, each of them so that the rest still fits: the search never
has to take a choice back. That is possible because any set of clocks can be moved into one octave
without bringing strong lines nearer to each other (docs/theory.md), where it is known exactly how
many fit.
"""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import InputError
from ...estimation.clocks.likelihood import PHASE_MARGIN, own_lines, phase_margin
from ...estimation.clocks.tracked_tag import TagClock
from ...scene import Scene, load_scene
from ...signal.lines import (
    CLUTTER_MARGIN,
    HIGHEST_LINE,
    NYQUIST_MARGIN,
    STRONG_LINES,
    lamp_distances_hz,
    tag_lines,
)
from ...signal.switching import harmonics
from ...signal.waveform import Waveform
from ...signal.weights import WORST_GAIN, design_weights
from ..loss import BANDS_HZ
from ..packet_clocks import packet_clocks
from .assessment import assess_clocks
from .spacing import LineTable, Pulses, double_rate_pulses, line_distances_hz, most_that_fit

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
# Clocks that are compared; a finer grid would only take longer.
_CANDIDATES = 1000
# Clocks that cost the weakest end so much more than the best one have about the same expected
# error: 5 % of the variance, 2.5 % of the standard deviation. Among them lamps decide.
_ABOUT_EQUAL = 0.05
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

    Each costs the weakest end of all tags hardly more than the best candidate would. Among such
    candidates, it is the one whose strong lines lie farthest from the lines of lamps (``mains_hz``
    is empty without any); among equals of these, the one nearest to the clock that the tag has now
    (``near_hz``, in whose order clocks are returned). Strong lines keep a bin from ``avoid_hz``.

    Every end is readable. At the worst errors of the clocks, lines 1, 2 and 4 of different tags are
    at least two bins apart, a bin being the inverse of the length of a phase group; 1.5 bins or one
    where nothing else fits. When so many do not fit, an InputError states how many do.

    Candidates are multiples of 5 Hz, or of half a bin where that is less. As far as the distances
    of lines decide, as many tags as can be found among them are found.
    """
    settings = waveform, group_length, double_rate_pulses(), tolerance_ppm, clutter_hz
    bin_hz = 1 / (group_length * waveform.snapshot_period_s)
    candidates = _candidates(waveform, bin_hz, clutter_hz, tolerance_ppm)
    apart_hz = np.multiply.outer(candidates, STRONG_LINES)[..., None] - np.asarray(avoid_hz)
    candidates = candidates[np.abs(apart_hz).min(axis=(1, 2), initial=np.inf) >= bin_hz]
    search = _Search(candidates, taken, settings, mains_hz, near_hz)
    found = search.best(count, bin_hz)
    if found is None:
        fewer = range(1, min(count - 1, search.fitting(bin_hz)) + 1)
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
    # least one of lines 1, 2 and 4 of two tags, clocks off by their tolerance
    line_distance_hz: float | None
    # of these lines of each tag to a lamp's; None where lamps are excluded
    lamp_distances_hz: list[float] | None
    bin_hz: float  # inverse of the length of a phase group
    worst_loss_db: float  # what neighbours, aliases and clutter cost the weakest end


def clocks_for(scene: Any, count: int) -> SceneClocks:
    """Clocks for a number of tags in the frame, the groups and the room of a scene
    (:func:`propose_clocks`).

    The scene's own clocks are kept where they are as good as any other.
    """
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
    report = assess_clocks(clocks_hz, waveform, group_length, None, tolerance_ppm, clutter_hz)
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
        settings: tuple[Waveform, int, tuple[Pulses, Pulses], float, float],
        mains_hz: Sequence[float],
        near_hz: Sequence[float] = (),
    ) -> None:
        waveform, group_length, pulses, tolerance_ppm, self._clutter_hz = settings
        self._settings, self._candidates, self._near_hz = settings, candidates, near_hz
        self._taken = [float(hz) for hz in taken]
        self._clocks = np.r_[candidates, self._taken]
        self._lines = LineTable(self._clocks, waveform, group_length, pulses, tolerance_ppm)
        self._distances_hz = line_distances_hz(candidates[:, None], self._clocks, tolerance_ppm)
        self._lamps_hz = np.array([lamp_distances_hz(hz, mains_hz).min() for hz in candidates])
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

    def fitting(self, distance_hz: float) -> int:
        """How many candidates can be used together when only the distance of lines counts."""
        return self._packed(*self._constraints(distance_hz))

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
            for best in self._ranked(free, cost, near_hz):
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

    def _ranked(
        self, free: np.ndarray, cost: np.ndarray, near_hz: Sequence[float]
    ) -> Iterator[int]:
        """Free candidates, the best one first."""
        if not free.any():
            return
        good = cost <= cost[free].min() + _ABOUT_EQUAL
        apart_hz = np.abs(np.subtract.outer(self._candidates, near_hz))
        moved_hz = apart_hz.min(axis=1) if len(near_hz) else np.zeros(len(free))
        order = np.lexsort((cost, *np.where(good, (moved_hz, -self._lamps_hz), 0.0), ~good))
        yield from (int(i) for i in order if free[i])

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
    waveform: Waveform, bin_hz: float, clutter_hz: float, tolerance_ppm: float
) -> np.ndarray:
    """Frequencies within three octaves, in Hz, ascending; at most _CANDIDATES.

    Strong lines of clocks further apart than three octaves cannot coincide.
    """
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
    return np.round(found, 9)
