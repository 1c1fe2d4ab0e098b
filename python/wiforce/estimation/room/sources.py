# SPDX-License-Identifier: GPL-3.0-or-later
"""Sources of the lines that a survey of the room has found: lamps, other tags, and the rest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...signal.lines import COINCIDING_BINS, aliased_hz, lamp_distances_hz
from ...signal.switching import line_envelope
from ...signal.waveform import Waveform
from ..groups import Array

# Lines of a source follow its fundamental within this distance: the accuracy of a frequency in the
# survey, and the drift of the mains or of a tag's clock during it.
_APART_HZ = 1.5
_APART_SHARE = 5e-4
# Frequencies of a tag's harmonics follow from that of a line, which is known to a twentieth of a
# step of the spectrum; oscillators without a crystal wander by 20 ppm per root of a second.
_TAG_STEPS, _TAG_SHARE = 0.1, 1e-4
# Lamps are recognised by this share of their first harmonics, a tag by this many of its own.
_FIRST_LAMPS = 14
_LAMPS_SHARE = 0.6
_LEAST_LAMPS = 4
# Own lines hide others where they raise the least visible power by this factor.
_STRONG = 30.0
_LEAST_LINES = 3
# So many odd harmonics show a clock whose first line is masked.
_LEAST_ODD = 2
# Whatever repeats more slowly is Doppler, such as that of a fan's blades, and no tag's clock.
SLOWEST_TAG_HZ = 250.0
_FIRST_LINES = 12
# Lines beyond this harmonic are below the noise, and those of a tag that are weaker than this part
# of its first one do not matter.
_MOST_HARMONICS = 1000
_NEGLIGIBLE = 1e-6
# How far a line of each kind of source may move after the survey, relative to its frequency: the
# mains drift by some 0.05 %, clocks by less.
_WIDTH_SHARE = {"lamps": 2e-3, "tag": 2e-4, "line": 5e-4}


class RoomLine(NamedTuple):
    """A line in the Doppler spectrum."""

    frequency_hz: float  # magnitude, within half the snapshot rate
    power: float  # per sign of the frequency, subcarrier and snapshot, in units of the white noise


class Source(NamedTuple):
    """Something in the room, by its lines."""

    kind: str  # ``lamps``, ``tag`` or ``line``
    fundamental_hz: float  # twice the mains frequency, clock of the tag, or the line
    lines: tuple[RoomLine, ...]  # those found
    # Those that must lie under the scene's own tags, of expected power.
    masked: tuple[RoomLine, ...]

    @property
    def power(self) -> float:
        """Of its strongest line."""
        return max(line.power for line in (*self.lines, *self.masked))

    @property
    def width_share(self) -> float:
        """How far its lines may move after the survey, relative to their frequency."""
        return _WIDTH_SHARE[self.kind]

    def meets(self, clocks_hz: Sequence[float], group_period_s: float) -> Array:
        """Whether lines 1, 2 or 4 of clocks (S,) coincide with its multiples, by group length."""
        mains_hz = (self.fundamental_hz / 2,)
        nearest_hz = lamp_distances_hz(clocks_hz, mains_hz).min(axis=1)
        return np.asarray(nearest_hz < COINCIDING_BINS / group_period_s)


class _Spectrum(NamedTuple):
    """What identification needs of a survey."""

    step_hz: float
    least_power: Array
    waveform: Waveform

    def least(self, hertz: float) -> float:
        """Power from which on a line stands out at a frequency."""
        middle = round(hertz / self.step_hz)
        return float(self.least_power[max(middle - 1, 0) : middle + 2].max(initial=0.0))

    def is_masked(self, hertz: float) -> bool:
        """Whether a strong line of the scene's own tags is near."""
        return self.least(hertz) > _STRONG * float(self.least_power.min())

    @property
    def highest_hz(self) -> float:
        return (len(self.least_power) - 1) * self.step_hz


def identify(
    lines: Sequence[RoomLine],
    step_hz: float,
    least_power: Array,
    waveform: Waveform,
    mains_hz: Sequence[float],
) -> list[Source]:
    """Attribute lines to their sources, the strongest first.

    ``least_power`` (F,) is that from which on a line stands out of noise and of the scene's own
    tags, at frequencies from 0 in ``step_hz``; ``mains_hz`` is empty where there are no lamps.
    """
    spectrum = _Spectrum(step_hz, least_power, waveform)
    rest = sorted(lines, key=lambda line: -line.power)
    sources = []
    for mains in mains_hz:
        lamps = _lamps(rest, 2 * mains, spectrum)
        if lamps is not None:
            sources.append(lamps)
            rest = [line for line in rest if line not in lamps.lines]
    while rest:
        tag = _tag(rest, spectrum)
        if tag is None:
            break
        sources.append(tag)
        rest = [line for line in rest if line not in tag.lines]
    sources += [Source("line", line.frequency_hz, (line,), ()) for line in rest]
    return sorted(sources, key=lambda source: -source.power)


def _reach_hz(hertz: float) -> float:
    return _APART_HZ + _APART_SHARE * hertz


def _order(hertz: float, fundamental_hz: float, reaches: int = 1) -> int:
    """Order of the harmonic that a frequency is near to; 0 where it is near to none."""
    order = round(hertz / fundamental_hz)
    return order if abs(hertz - order * fundamental_hz) <= reaches * _reach_hz(hertz) else 0


def _lamps(lines: Sequence[RoomLine], fundamental_hz: float, spectrum: _Spectrum) -> Source | None:
    """Lamps at twice a mains frequency, where most of the first harmonics are there."""
    found: dict[int, RoomLine] = {}
    rate_hz = 1 / spectrum.waveform.snapshot_period_s
    # Twice the present frequency of the mains, from the first harmonics.
    present: dict[int, RoomLine] = {}
    for line in lines:
        if 0 < (order := _order(line.frequency_hz, fundamental_hz, 2)) < _FIRST_LAMPS:
            present.setdefault(order, line)
    present_hz = _fundamental_hz(present) if present else fundamental_hz
    for line in lines:
        if order := _order(line.frequency_hz, present_hz):
            found.setdefault(order, line)
    direct = set(found.values())
    # Aliases are of higher orders than all of these, and weaker.
    highest = spectrum.highest_hz / 2
    limit = max((line.power for line in direct if line.frequency_hz > highest), default=0.0)
    for line in lines:
        if line in direct or line.power > limit:
            continue
        for original in (rate_hz - line.frequency_hz, rate_hz + line.frequency_hz):
            if order := _order(original, present_hz):
                found.setdefault(order, line)
                break
    first = [
        order for order in range(1, _FIRST_LAMPS) if not spectrum.is_masked(order * fundamental_hz)
    ]
    if sum(order in found for order in first) < max(_LAMPS_SHARE * len(first), _LEAST_LAMPS):
        return None
    masked = []
    for order in range(1, int(spectrum.highest_hz / fundamental_hz) + 1):
        around = [found[n].power for n in (order - 1, order + 1) if n in found]
        if order not in found and around and spectrum.least(order * fundamental_hz) > max(around):
            masked.append(RoomLine(order * fundamental_hz, float(np.mean(around))))
    return Source("lamps", fundamental_hz, tuple(found.values()), tuple(masked))


def _tag(lines: Sequence[RoomLine], spectrum: _Spectrum) -> Source | None:
    """The tag that explains most of the lines by its first harmonics."""
    rate_hz = 1 / spectrum.waveform.snapshot_period_s
    lines_hz = np.array([line.frequency_hz for line in lines])
    first = np.arange(1, _FIRST_LINES + 1)

    def harmonics_of(clock_hz: float) -> dict[int, RoomLine]:
        seen_hz = np.abs(aliased_hz(first * clock_hz, rate_hz))
        apart_hz = np.abs(np.subtract.outer(seen_hz, lines_hz))
        reach_hz = _APART_HZ + first * (_TAG_STEPS * spectrum.step_hz + _TAG_SHARE * clock_hz)
        near = np.flatnonzero(apart_hz.min(axis=1) <= reach_hz)
        return {i + 1: lines[apart_hz[i].argmin()] for i in near.tolist()}

    best: dict[int, RoomLine] = {}
    clock_hz = 0.0
    for line in lines[:6]:
        for divisor in (1, 2):
            candidate_hz = line.frequency_hz / divisor
            # A line is the second one only where the first one is masked.
            only_second = divisor == 2 and not spectrum.is_masked(candidate_hz)
            if only_second or candidate_hz < SLOWEST_TAG_HZ:
                continue
            found = harmonics_of(candidate_hz)
            second = 2 in found or spectrum.is_masked(abs(aliased_hz(2 * candidate_hz, rate_hz)))
            enough = len(found) >= _LEAST_LINES and divisor in found and second
            if divisor == 2:  # otherwise the line that is there is the first
                enough = enough and sum(m % 2 for m in found) >= _LEAST_ODD
            # A tag's second line has harmonics too, but without the first.
            if enough and _total_power(found) > _total_power(best):
                best, clock_hz = found, candidate_hz
    if not best:
        return None
    clock_hz = _fundamental_hz({m: line for m, line in best.items() if m * clock_hz < rate_hz / 2})
    lowest = min(best)
    envelope = line_envelope(np.arange(1, _MOST_HARMONICS), clock_hz, spectrum.waveform)
    power = envelope * (best[lowest].power / envelope[lowest - 1])
    explained, masked = set(best.values()), []
    for m in (np.flatnonzero(power > _NEGLIGIBLE * power[0]) + 1).tolist():
        hertz = abs(aliased_hz(m * clock_hz, rate_hz))
        near = np.flatnonzero(np.abs(lines_hz - hertz) <= _reach_hz(m * clock_hz / 4))
        # The lines of an unlisted tag may be stronger than ideal switches make them.
        weak = [lines[i] for i in near if lines[i].power < 30 * power[m - 1]]
        explained.update(weak)
        if not weak and spectrum.least(hertz) > power[m - 1]:
            masked.append(RoomLine(hertz, float(power[m - 1])))
    return Source(
        "tag", clock_hz, tuple(line for line in lines if line in explained), tuple(masked)
    )


def _total_power(found: dict[int, RoomLine]) -> float:
    return sum(line.power for line in set(found.values()))


def _fundamental_hz(found: dict[int, RoomLine]) -> float:
    """Fundamental by its unaliased harmonics, the higher ones counting for more."""
    orders = np.array(list(found))
    hertz = np.array([line.frequency_hz for line in found.values()])
    return float(orders @ hertz / (orders @ orders))
