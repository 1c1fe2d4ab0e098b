# SPDX-License-Identifier: GPL-3.0-or-later
"""Which switching clocks keep every end readable: their lines, collisions and information.

An end is readable when its switching waveform, as snapshots see it, is not a combination of the
other ends' waveforms and of clutter. How well, is its information q in the Cramer-Rao bound
var(phi) = 1 / (2 gamma K N q).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ...estimation.clocks.likelihood import PHASE_MARGIN, phase_margin
from ...signal.lines import (
    STRONG_LINES,
    aliased_hz,
    centered_times_s,
    clutter_basis,
    lamp_distances_hz,
)
from ...signal.waveform import Waveform
from ..plan import Plan
from .spacing import Pulses, double_rate_pulses, line_coefficients, switch_waveform

# An end that loses more than half its information to its neighbours, or to aliases, is not
# readable.
WORST_LOSS_DB = 3.0
# Lines weaker than this against the strongest of their end are not listed.
_WEAKEST_LINE_DB = -20.0
_HIGHEST_HARMONIC = 64
# Clock phases that are tried; clocks that are multiples of each other hide one another at few.
_TRIALS = 48
_BATCHES = 8


@dataclass(frozen=True)
class Line:
    """A line of an end's spectrum."""

    harmonic: int  # multiple of the tag's clock
    # on the air; ``seen_hz`` where snapshots show it, folded at half their rate
    frequency_hz: float
    seen_hz: float
    level_db: float  # against the strongest line of the end
    # tag, end and harmonic of lines of other ends that a group cannot resolve from it
    shared_with: tuple[tuple[int, int, int], ...] = ()


@dataclass(frozen=True)
class End:
    """An end of a tag: its lines, its information, and what the other ends cost it."""

    tag: int  # from 0; ``end`` is 1 or 2
    end: int
    information: float  # q, the worst over relative clock phases and clock errors within tolerance
    loss_db: float  # against the same switch alone, not aliased, with nothing moving
    lines: tuple[Line, ...]  # in ascending order of harmonics

    @property
    def alone(self) -> tuple[Line, ...]:
        """Lines that no other end shares."""
        return tuple(line for line in self.lines if not line.shared_with)


@dataclass(frozen=True)
class ClockReport:
    """How well a set of switching clocks can be read."""

    ends: tuple[End, ...]  # two per tag
    # per tag, the part of its signal that distinguishes the right clock phase from the wrong one
    # that resembles it most; 0 when the ends could be swapped
    phase_margins: tuple[float, ...]

    @property
    def worst_loss_db(self) -> float:
        """Loss of the weakest end, in dB."""
        return max(end.loss_db for end in self.ends)

    @property
    def collisions(self) -> tuple[tuple[int, int, int, int], ...]:
        """Lines of two tags that coincide: (tag, harmonic, other tag, its harmonic)."""
        found = {
            (end.tag, line.harmonic, tag, harmonic)
            for end in self.ends
            for line in end.lines
            for tag, _, harmonic in line.shared_with
            if tag > end.tag
        }
        return tuple(sorted(found))

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
    pulses: tuple[Pulses, Pulses] | None = None,
    tolerance_ppm: float = 100.0,
    clutter_hz: float = 0.0,
) -> ClockReport:
    """How well the ends of tags with given clocks can be separated.

    ``pulses`` are the on-intervals of the two switches, the paper's by default. Clocks may be off
    by ``tolerance_ppm``; ``clutter_hz`` is the highest Doppler frequency of anything that moves.
    """
    pulses = double_rate_pulses() if pulses is None else pulses
    lines = _lines(clocks_hz, waveform, group_length, pulses, tolerance_ppm)
    information = worst_information(
        clocks_hz, waveform, group_length, pulses, tolerance_ppm, clutter_hz
    )
    ends = []
    for (tag, end), q in zip(product(range(len(clocks_hz)), (1, 2)), information, strict=True):
        ideal = _ideal_information(pulses[end - 1], clocks_hz[tag] * waveform.averaging_s)
        loss_db = 10 * np.log10(ideal / max(q, 1e-12))
        ends.append(End(tag, end, float(q), float(loss_db), lines[tag, end]))
    margins = tuple(_phase_margin(pulses, f * waveform.averaging_s) for f in clocks_hz)
    return ClockReport(tuple(ends), margins)


def _lines(
    clocks_hz: Sequence[float],
    waveform: Waveform,
    group_length: int,
    pulses: tuple[Pulses, Pulses],
    tolerance_ppm: float,
) -> dict[tuple[int, int], tuple[Line, ...]]:
    """Lines of every (tag, end) at positive harmonics, and which others share them."""
    rate = 1 / waveform.snapshot_period_s
    resolution_hz = rate / group_length
    found: list[tuple[int, int, Line]] = []
    for tag, clock_hz in enumerate(clocks_hz):
        m = np.arange(1, _HIGHEST_HARMONIC + 1)
        for end in (1, 2):
            level = np.abs(line_coefficients(pulses[end - 1], m, clock_hz * waveform.averaging_s))
            level_db = 20 * np.log10(np.maximum(level / level.max(), 1e-9))
            for i in np.flatnonzero(level_db >= _WEAKEST_LINE_DB):
                frequency = float(m[i] * clock_hz)
                seen = abs(aliased_hz(frequency, rate))
                found.append((tag, end, Line(int(m[i]), frequency, seen, float(level_db[i]))))
    tags, ends = np.array([each[:2] for each in found]).T
    frequencies, seen_hz = np.array([(x.frequency_hz, x.seen_hz) for _, _, x in found]).T
    wander = 1e-6 * tolerance_ppm * np.add.outer(frequencies, frequencies)
    shared = np.abs(np.subtract.outer(seen_hz, seen_hz)) < resolution_hz + wander
    shared &= np.not_equal.outer(2 * tags + ends, 2 * tags + ends)
    result: dict[tuple[int, int], tuple[Line, ...]] = {}
    for (tag, end, line), row in zip(found, shared, strict=True):
        others = tuple(
            (found[i][0], found[i][1], found[i][2].harmonic) for i in np.flatnonzero(row)
        )
        result[tag, end] = (*result.get((tag, end), ()), replace(line, shared_with=others))
    return result


def _ideal_information(pulses: Pulses, averaging_cycles: float) -> float:
    """Power of one switch's averaged waveform about its mean."""
    m = np.arange(1, 4 * _HIGHEST_HARMONIC)
    return float(2 * np.sum(np.abs(line_coefficients(pulses, m, averaging_cycles)) ** 2))


def worst_information(
    clocks_hz: Sequence[float],
    waveform: Waveform,
    group_length: int,
    pulses: tuple[Pulses, Pulses],
    tolerance_ppm: float,
    clutter_hz: float,
) -> np.ndarray:
    """Information q (2S,) of every end at the least favourable clock phases and errors.

    Power per snapshot of the part of its waveform that no other waveform explains.
    """
    period_s, averaging_s = waveform.snapshot_period_s, waveform.averaging_s
    times_s = centered_times_s(group_length, period_s)
    clutter = clutter_basis(group_length, period_s, clutter_hz)
    worst = np.full(2 * len(clocks_hz), np.inf)
    phases = np.random.default_rng(0).random((_TRIALS, len(clocks_hz)))
    trials = np.arange(_TRIALS)
    # Some trials at once: all of them would take 100 MB for many tags in long groups.
    for some in np.array_split(trials, _BATCHES):
        columns = []
        for tag, clock_hz in enumerate(clocks_hz):
            error = tolerance_ppm * 1e-6 * ((some + tag) % 3 - 1)
            cycles = np.multiply.outer(clock_hz * (1 + error), times_s) + phases[some, tag, None]
            columns += [switch_waveform(p, cycles, clock_hz * averaging_s) for p in pulses]
        waveforms = np.stack(columns, axis=-1)
        waveforms -= clutter @ (clutter.T @ waveforms)
        found = _unexplained(waveforms) / group_length
        worst = np.minimum(worst, found.min(axis=0))
    return worst


def _unexplained(waveforms: np.ndarray) -> np.ndarray:
    """Energy of each column's residual after projection on the others; shape (..., columns)."""
    scale = np.sqrt(np.maximum(np.sum(waveforms**2, axis=-2), 1e-300))
    scaled = waveforms / scale[..., None, :]
    values, vectors = np.linalg.eigh(np.swapaxes(scaled, -1, -2) @ scaled)
    inverse = np.sum(vectors**2 / np.maximum(values, 1e-9)[..., None, :], axis=-1)
    return scale**2 / inverse


def _phase_margin(pulses: tuple[Pulses, Pulses], averaging_cycles: float) -> float:
    """``phase_margin`` of all lines of a tag."""
    m = np.r_[-_HIGHEST_HARMONIC:0, 1 : _HIGHEST_HARMONIC + 1]
    spectra = np.stack([line_coefficients(p, m, averaging_cycles) for p in pulses], axis=1)
    return phase_margin(spectra, m)


@dataclass(frozen=True)
class LampLines:
    """A tag with strong lines that a phase group cannot separate from those of lamps."""

    tag: int
    lines: tuple[int, ...]  # of its lines 1, 2 and 4, those within one bin of a lamp's line
    distance_hz: float  # least distance of a strong line to a lamp's line


def lines_near_lamps(plan: Plan) -> Iterator[LampLines]:
    """Tags of a scene whose strong lines lie within one bin of those of lamps."""
    mains_hz = plan.require_scene().environment.possible_mains_hz
    bin_hz = 1 / plan.group_period_s
    for tag, clock in enumerate(plan.clocks):
        distances_hz = lamp_distances_hz(clock.clock_hz, mains_hz)
        near = tuple(m for m, hz in zip(STRONG_LINES, distances_hz, strict=True) if hz < bin_hz)
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
