# SPDX-License-Identifier: GPL-3.0-or-later
"""Frequencies of the tags' clocks in the Doppler spectrum of the room."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..clocks.tracked_tag import ACQUIRED_PPM, TagClock
from ..groups import Array

# A line stands out where it is this many times the floor.
_STANDS_OUT = 6.4
# Accuracy of the vertex of a line in bins, and the harmonics that refine the frequency of a clock.
_VERTEX_BINS = 0.05
_REFINING = (2, 4, 6)
# Lines that a clock of wide tolerance is recognised by, how many of them are needed, and how many
# times the floor each is: noise has a standard deviation of 9 %.
_RECOGNISED = np.arange(1, 7)
_LEAST_LINES = 3
_VISIBLE = 1.6
# Frequencies that are tried per bin of the highest of these lines.
_TRIALS_PER_BIN = 2
# A line belongs to a comb of another spacing unless it is this many times as strong as the weaker
# of that comb's lines on both sides. Combs: lamps, and tags at a half to a fifth of the clock.
_ABOVE_COMB = 4.0
_LAMPS_HZ = (100.0, 120.0)
_SLOWER = np.arange(2, 6)
# Half width of what is masked around the lines of a tag that was found, and how far a line may lie
# from its place, in bins.
_MASK_BINS = 4.5
# A second tag within a wide tolerance counts down to this power relative to line 1 of the first.
_RIVAL = 1e-3
# All of these lines of it that are not masked must be there: both ends cannot cancel on them.
_ALWAYS = (1, 3, 4)
_APART_BINS = 0.3


class ClockLine(NamedTuple):
    """The first line of a tag."""

    clock_hz: float  # measured; the nominal one where no line stands out
    error_hz: float  # its uncertainty; the tolerance where no line stands out
    height: float  # power of the line over the floor; 0 where none stands out
    rival_hz: float | None = None  # another clock within a wide tolerance, that of a second tag

    @property
    def found(self) -> bool:
        """Whether the line stands out."""
        return self.height > 0


def find_clocks(
    frequency_hz: Array, spectrum: Array, clocks: Sequence[TagClock]
) -> tuple[ClockLine, ...]:
    """Find the first line of every tag within the tolerance of its clock.

    ``spectrum`` is in units of the floor, at frequencies (F,) from 0 in equal steps. In a wide
    tolerance the clock is the f at which most is received at f, 2 f, ..., 6 f together, beside
    combs of lamps and slower tags; the clearest tag comes first, and its lines are then masked.
    """
    found: dict[int, ClockLine] = {}
    rest = spectrum.copy()
    for tag, clock in enumerate(clocks):
        if not clock.wide:
            found[tag] = _line_near(frequency_hz, spectrum, clock)
            _mask(frequency_hz, rest, found[tag])
    missing = [tag for tag in range(len(clocks)) if tag not in found]
    while missing:
        trials = {tag: _recognise(frequency_hz, rest, clocks[tag]) for tag in missing}
        tag = max(missing, key=lambda each: trials[each][0])
        found[tag] = trials[tag][1]
        _mask(frequency_hz, rest, found[tag])
        missing.remove(tag)
    for tag, clock in enumerate(clocks):
        if clock.wide and found[tag].found:
            rival = _recognise(frequency_hz, rest, clock, found[tag].height)[1]
            if rival.found:
                found[tag] = found[tag]._replace(rival_hz=rival.clock_hz)
    return tuple(found[tag] for tag in range(len(clocks)))


def clock_beyond(
    frequency_hz: Array, spectrum: Array, clock: TagClock, others: Sequence[ClockLine]
) -> ClockLine:
    """A tag in a clock's wide tolerance, found as in :func:`find_clocks` beside ``others``."""
    rest = spectrum.copy()
    for line in others:
        _mask(frequency_hz, rest, line)
    return _recognise(frequency_hz, rest, clock)[1]


def vertex(spectrum: Array, best: int) -> tuple[float, float]:
    """Offset of a maximum from its bin (neither first nor last), and height: a parabola in dB."""
    below, top, above = np.log(np.maximum(spectrum[best - 1 : best + 2], 1e-30))
    curvature = below - 2 * top + above
    if curvature >= 0:
        return 0.0, float(np.exp(top))
    offset = float(np.clip(0.5 * (below - above) / curvature, -0.5, 0.5))
    return offset, float(np.exp(top - 0.25 * (below - above) * offset))


def _line_near(frequency_hz: Array, spectrum: Array, clock: TagClock) -> ClockLine:
    """The strongest line within a narrow tolerance."""
    step_hz = float(frequency_hz[1])
    tolerance_hz = clock.clock_hz * clock.tolerance_ppm * 1e-6
    near = np.abs(frequency_hz - clock.clock_hz) <= tolerance_hz + step_hz
    rows = np.flatnonzero(near)
    best = int(rows[np.argmax(spectrum[rows])])
    if spectrum[best] < _STANDS_OUT or not 0 < best < len(spectrum) - 1:
        return ClockLine(clock.clock_hz, tolerance_hz, 0.0)
    offset, top = vertex(spectrum, best)
    found, peak = (best + offset) * step_hz, top - 1
    error_hz = _VERTEX_BINS * step_hz
    for m in _REFINING:
        expected = m * found / step_hz
        around = int(round(expected))
        if m * error_hz > step_hz or around + 3 >= len(spectrum):
            break
        best = around - 2 + int(np.argmax(spectrum[around - 2 : around + 3]))
        finer = (best + vertex(spectrum, best)[0]) * step_hz / m
        # A stronger line of another tag may lie beside this one's.
        if spectrum[best] > _STANDS_OUT and abs(finer - found) <= error_hz + step_hz / m / 2:
            found, error_hz = finer, _VERTEX_BINS * step_hz / m
    return ClockLine(found, min(tolerance_hz, error_hz), peak)


def _recognise(
    frequency_hz: Array, spectrum: Array, clock: TagClock, above: float = 0.0
) -> tuple[float, ClockLine]:
    """Evidence for the clock of most lines, and its line; a rival's beside line 1 ``above`` 0."""
    step_hz = float(frequency_hz[1])
    tolerance_hz = clock.clock_hz * clock.tolerance_ppm * 1e-6
    highest_hz = float(frequency_hz[-1]) - 4 * step_hz
    orders = _RECOGNISED[_RECOGNISED * (clock.clock_hz + tolerance_hz) < highest_hz]
    trials = 2 * int(np.ceil(_TRIALS_PER_BIN * orders[-1] * tolerance_hz / step_hz)) + 1
    candidates = clock.clock_hz + np.linspace(-tolerance_hz, tolerance_hz, trials)
    levels = np.log(np.maximum(spectrum, 1.0))

    def level(hertz: Array) -> Array:
        return np.interp(hertz, frequency_hz, levels)

    lines = candidates[:, None] * orders
    least = np.full_like(lines, np.log(max(_VISIBLE, _RIVAL * above)))
    spacings = [candidates[:, None] / k for k in _SLOWER]
    # A clock may be as slow as the lamps.
    spacings += [np.array([[hz]]) for hz in _LAMPS_HZ if hz < 0.9 * candidates[0]]
    for spacing in spacings:
        comb = np.minimum(level(np.abs(lines - spacing)), level(lines + spacing))
        least = np.maximum(least, comb + np.log(_ABOVE_COMB))
    evidence = np.maximum(level(lines) - least, 0.0)
    enough = np.count_nonzero(evidence, axis=1) >= min(_LEAST_LINES, len(orders))
    # A tag at twice the clock has no odd lines.
    odd = (evidence[:, orders % 2 == 1] > 0).any(axis=1)
    evidence[~(enough & odd)] = 0.0
    if above:
        masked = np.interp(lines, frequency_hz, (spectrum == 1.0).astype(float)) > 0
        shown = (evidence > 0) | masked | ~np.isin(orders, _ALWAYS)
        # The strongest line of a slower tag is its first.
        slower = level(candidates[:, None] / _SLOWER).max(axis=1) > level(lines).max(axis=1)
        evidence[~shown.all(axis=1) | slower] = 0.0
    else:
        evidence[level(candidates) < np.log(_VISIBLE)] = 0.0
    best = int(np.argmax(evidence.sum(axis=1)))
    total = float(evidence[best].sum())
    if total == 0:
        return 0.0, ClockLine(clock.clock_hz, tolerance_hz, 0.0)
    places: dict[int, float] = {}
    for m in orders[evidence[best] > 0].tolist():
        around = int(round(m * candidates[best] / step_hz))
        peak = around - 2 + int(np.argmax(spectrum[around - 2 : around + 3]))
        places[m] = (peak + vertex(spectrum, peak)[0]) * step_hz
    clock_hz, error_hz = _clock_through(places, step_hz)
    height = float(np.exp(level(np.array([clock_hz]))[0]))  # 1 where it is masked
    return total, ClockLine(clock_hz, min(tolerance_hz, error_hz), height)


def _clock_through(places: dict[int, float], step_hz: float) -> tuple[float, float]:
    """Least-squares clock through the places of its lines, without those that something moved."""
    orders, hertz = np.array(list(places)), np.array(list(places.values()))
    trials = hertz / orders
    apart = np.abs(hertz - np.multiply.outer(trials, orders))
    kept = apart[np.argmin(apart.sum(axis=1))] <= _APART_BINS * step_hz
    orders, hertz = orders[kept], hertz[kept]
    clock_hz = float(orders @ hertz / (orders @ orders))
    apart = np.abs(hertz - orders * clock_hz)
    spread_hz = max(_VERTEX_BINS * step_hz, float(apart.max()))
    return clock_hz, spread_hz / float(np.sqrt(orders @ orders))


def _mask(frequency_hz: Array, spectrum: Array, line: ClockLine) -> None:
    """Set the surroundings of a tag's lines to the floor."""
    if not line.found:
        return
    step_hz = float(frequency_hz[1])
    order = np.maximum(np.rint(frequency_hz / line.clock_hz), 1)
    apart_hz = np.abs(frequency_hz - order * line.clock_hz)
    spectrum[apart_hz <= _MASK_BINS * step_hz + order * line.error_hz] = 1.0


def measured(clock: TagClock, line: ClockLine) -> TagClock:
    """The clock as a survey measured it where its tolerance is wide; nominal without a line."""
    if not clock.wide:
        return clock
    if not line.found:
        return TagClock(clock.clock_hz, clock.planned_ppm)
    error_ppm = 3e6 * line.error_hz / line.clock_hz
    return TagClock(line.clock_hz, max(ACQUIRED_PPM, error_ppm), clock.stated_hz)
