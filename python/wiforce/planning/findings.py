# SPDX-License-Identifier: GPL-3.0-or-later
"""Findings of a survey in words: what is in the room, how strong, and what was done about it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from ..estimation.capture.recorded_frames import SAMPLE_RATE_RATIOS
from ..estimation.groups import Groups
from ..estimation.room.clock_lines import clock_beyond
from ..estimation.room.sources import SLOWEST_TAG_HZ, Source
from ..estimation.room.survey import Survey
from ..scene.schema import LOOSEST_CLOCK_PPM
from ..signal.lines import COINCIDING_BINS, STRONG_LINES, RoomNoise, aliased_hz
from .adaptation import NEGLIGIBLE, room_noise_of_tones
from .clocks import line_numbers
from .plan import Plan

# Lines are where they are expected within this distance.
_APART_HZ = 1.5


def other_clocks(clocks_hz: Sequence[float]) -> str:
    """That tags are received with clocks that the scene does not list; empty without such."""
    if not clocks_hz:
        return ""
    named = " and ".join(f"{clock_hz:.6g} Hz" for clock_hz in clocks_hz)
    return (
        f"on the air is a clock of {named}, which the scene does not list: is it the scene of what "
        "is received?"
    )


def _wrong_clock(survey: Survey, plan: Plan, tag: int) -> str:
    """What :func:`wrong_clocks` says of one sensor; empty where its clock is right."""
    clock, listed = plan.clocks[tag], plan.require_scene().sensors[tag]
    sensor, stated_hz = listed.name, listed.clock_hz
    reach_hz = stated_hz * listed.clock_tolerance_ppm * 1e-6
    sources = [source for source in survey.sources if source.kind != "lamps"]
    tags_hz = [source.fundamental_hz for source in sources if source.kind == "tag"]
    lines_hz = [line.frequency_hz for source in sources for line in source.lines]

    def is_among(hertz: Sequence[float], at_hz: float) -> bool:
        reach = _APART_HZ + at_hz * clock.planned_ppm * 1e-6
        return any(abs(each - at_hz) <= reach for each in hertz)

    for ratio in sorted(SAMPLE_RATE_RATIOS):  # harmonics of a tag are at higher ones
        at_hz = ratio * stated_hz
        # Lines 1 and 4 suffice: the second of the others may be hidden.
        strong = all(is_among(lines_hz, m * at_hz) for m in (1, STRONG_LINES[-1]))
        if strong or is_among(tags_hz, at_hz):
            return (
                f"a tag is found at {at_hz:.6g} Hz, {ratio:g} times the clock_hz of {sensor}; "
                "check clock_hz, and sample_rate_hz of the scene, which may be "
                f"{ratio:g} times that of the samples"
            )
    near, others = survey.clocks[tag], (*survey.clocks[:tag], *survey.clocks[tag + 1 :])
    if not near.found or abs(near.clock_hz - stated_hz) > reach_hz:
        wide = replace(clock, clock_hz=stated_hz, tolerance_ppm=LOOSEST_CLOCK_PPM)
        near = clock_beyond(survey.frequency_hz, survey.spectrum, wide, others)
    if near.found and abs(near.clock_hz - stated_hz) > reach_hz:
        apart_ppm = 1e6 * (near.clock_hz / stated_hz - 1)
        return (
            f"a tag is found at {near.clock_hz:.6g} Hz, {apart_ppm:+.0f} ppm from the clock_hz of "
            f"{sensor}; check clock_hz, or state a clock_tolerance_ppm that holds it"
        )
    return ""


def wrong_clocks(survey: Survey | None, plan: Plan) -> dict[str, str]:
    """Tags that are received beyond their tolerance, or at a simple multiple of their clock."""
    if survey is None:
        return {}
    found = {name: _wrong_clock(survey, plan, tag) for tag, name in enumerate(_names(plan))}
    return {name: wrong for name, wrong in found.items() if wrong}


# At most so many single lines are reported, the strongest first.
_MOST_LINES = 12
# So many slow lines are the blades of something that turns.
_BLADES = 3
# Hum is at the frequency of the mains within the survey's accuracy and their drift.
_HUM_HZ = 0.6
_ENTERS = "it enters the standard deviations"
_SPURIOUS = "an unknown source: a power supply, another reader or a spurious oscillation"


@dataclass(frozen=True)
class Finding:
    """Something that a survey has found."""

    kind: str  # ``clutter`` (something moves), ``lamps``, ``tag`` or ``line``
    frequency_hz: float  # highest one of clutter, mains of lamps, clock of a tag, or line
    # Power per sign of the frequency relative to :func:`level_reference`: of all clutter, or of a
    # source's strongest line.
    level_db: float
    meaning: str  # what it probably is
    handling: str  # what the plan does about it
    matters: bool  # it changed the plan or cannot be handled
    lines_hz: tuple[float, ...] = ()  # the source's visible lines

    def row(self) -> dict[str, Any]:
        """The finding as a dictionary for JSON."""
        return {"name": self.name, **asdict(self)}

    @property
    def line(self) -> str:
        return f"{self.name}, {self.level_db:+.0f} dB: {self.handling}"

    @property
    def name(self) -> str:
        """Kind and frequency in a few words."""
        hertz = f"{self.frequency_hz:.6g} Hz"
        return {
            "clutter": f"moving clutter up to {self.frequency_hz:.0f} Hz",
            "lamps": f"lamps on {hertz} mains",
            "tag": f"tag with a clock of {hertz}",
            "line": f"line at {self.frequency_hz:.1f} Hz",
        }[self.kind]


def level_reference(survey: Survey, plan: Plan) -> tuple[float, str]:
    """Power that the levels of findings refer to, and its name: line 1 of the first tag, or 1."""
    if len(survey.line_power) and survey.line_power[0] > 0:
        return float(survey.line_power[0]), f"line 1 of '{_names(plan)[0]}'"
    return 1.0, "the noise of a snapshot"


def findings(survey: Survey | None, plan: Plan, adapted: Plan) -> list[Finding]:
    """What a survey has found and a plan does about it: clutter, other sources."""
    if survey is None:
        return []
    report = _Report(survey, plan, adapted)
    return [*report.clutter(), *report.sources()]


def _names(plan: Plan) -> list[str]:
    return list(plan.require_scene().sensor_names)


class _Report:
    """Findings of one survey."""

    def __init__(self, survey: Survey, plan: Plan, adapted: Plan) -> None:
        self._survey, self._plan, self._adapted = survey, plan, adapted
        self._reference = level_reference(survey, plan)[0]
        self._mains_hz = plan.require_scene().environment.possible_mains_hz
        self._moving_hz = self._fastest_hz()
        same = adapted.clutter_hz == plan.clutter_hz
        self._table = plan.table if same else replace(plan, clutter_hz=adapted.clutter_hz).table

    def _db(self, power: float) -> float:
        return float(10 * np.log10(max(power, 1e-30) / self._reference))

    def _fastest_hz(self) -> float:
        """Highest frequency of what moves, the slow lines of turning blades included."""
        moving_hz = self._survey.moving_hz()
        blades = [
            source.fundamental_hz
            for source in self._survey.sources
            if source.kind == "line"
            and source.fundamental_hz < SLOWEST_TAG_HZ
            and not self._is_hum(source.fundamental_hz)
        ]
        if not moving_hz and len(blades) < _BLADES:
            return 0.0
        return max([moving_hz, *blades])

    def _is_hum(self, hertz: float) -> bool:
        """Whether a line is at the frequency of the mains, or at twice that."""
        return any(abs(hertz - k * mains) < _HUM_HZ for mains in self._mains_hz for k in (1, 2))

    def clutter(self) -> Iterator[Finding]:
        """Everything that moves slowly, where it does."""
        survey, band_hz = self._survey, self._adapted.clutter_hz
        if not self._moving_hz:
            return
        rows = survey.frequency_hz <= self._moving_hz
        power = float(np.sum(survey.spectrum[rows] - 1) / (2 * len(rows)))
        handling = "the weights reject the mean only"
        if band_hz:
            handling = f"rejected by the weights up to {band_hz:.0f} Hz"
        wider = band_hz > self._plan.clutter_hz
        if wider:
            handling += f" ({self._plan.clutter_hz:.0f} Hz in the scene's own plan)"
        inside = self._moving_hz <= band_hz + survey.resolution_hz
        if not inside:
            noise = self._adapted.room is not None
            handling += "; treated as noise beyond" if noise else f"; beyond, {_ENTERS}"
        meaning = "persons, a fan or other things that move"
        level_db, matters = self._db(power), wider or not inside
        yield Finding("clutter", self._moving_hz, level_db, meaning, handling, matters)

    def sources(self) -> Iterator[Finding]:
        """Lamps, tags and single lines."""
        single = 0
        for source in self._survey.sources:
            hertz = source.fundamental_hz
            if source.kind == "line":
                if hertz <= self._moving_hz and not self._is_hum(hertz):
                    continue
                single += 1
            if source.kind != "line" or single <= _MOST_LINES:
                yield self._finding(source)

    def _finding(self, source: Source) -> Finding:
        handling, matters = self._handling(source)
        if matters and not self._is_solved(source):
            handling += self._clashes(source)
        hertz, hum = source.fundamental_hz, "probably hum of a power supply"
        meaning = {
            "lamps": f"light that flickers at multiples of {hertz:g} Hz",
            "tag": "a tag that the scene does not list",
        }.get(source.kind, hum if self._is_hum(hertz) else _SPURIOUS)
        lines_hz = [line.frequency_hz for line in source.lines]
        if source.kind == "tag":
            lines_hz = [hz for hz in lines_hz if hz > self._moving_hz]
        named_hz = float(hertz / 2 if source.kind == "lamps" else hertz)
        level_db = self._db(source.power)
        return Finding(source.kind, named_hz, level_db, meaning, handling, matters, (*lines_hz,))

    def _is_solved(self, source: Source) -> bool:
        return source.kind == "tag" and any(
            clock.clock_hz == source.fundamental_hz for clock in self._adapted.others
        )

    def _handling(self, source: Source) -> tuple[str, bool]:
        """What the plan does about a source, and whether it matters."""
        lines = (*source.lines, *source.masked)
        if self._is_solved(source):
            return "solved for, like the scene's own tags", True
        if all(line.frequency_hz <= self._adapted.clutter_hz for line in lines):
            return f"rejected by the weights up to {self._adapted.clutter_hz:.0f} Hz", False
        length = self._plan.group_length
        hertz, power = np.array([(line.frequency_hz, line.power) for line in lines]).T
        power *= self._survey.weight(source, length)
        room = RoomNoise(hertz, power, length, self._survey.snapshot_period_s)
        if room_noise_of_tones(self._table, room).max() < NEGLIGIBLE:
            return "does not reach the lines of the tags", False
        if self._adapted.room is not None:
            return "treated as noise, which the weights suppress", True
        return f"not suppressed; {_ENTERS}", True

    def _clashes(self, source: Source) -> str:
        """Strong lines of the scene's tags that coincide with those of a source, in words."""
        plan, rate_hz = self._plan, 1 / self._survey.snapshot_period_s
        lines = [*source.lines, *source.masked]
        lines_hz = [line.frequency_hz for line in lines if line.power * plan.group_length > 1]
        texts = ""
        for name, clock_hz in zip(_names(plan), plan.clocks_hz, strict=True):
            own_hz = [abs(aliased_hz(m * clock_hz, rate_hz)) for m in STRONG_LINES]
            apart_hz = np.abs(np.subtract.outer(own_hz, lines_hz)).min(axis=1, initial=np.inf)
            near = np.array(STRONG_LINES)[apart_hz < COINCIDING_BINS / plan.group_period_s]
            if len(near):
                texts += f"; coincides with {line_numbers(near.tolist())} of '{name}': readings "
                texts += "are uncertain; choose another clock (`plan --clocks`)"
        return texts


def changes_of(plan: Plan, adapted: Plan) -> tuple[list[str], list[str]]:
    """What a room changes in a plan, and what it does not need."""
    changes = []
    if adapted.clutter_hz != plan.clutter_hz:
        changes.append(
            f"the weights reject clutter up to {adapted.clutter_hz:.0f} Hz instead of "
            f"{plan.clutter_hz:.0f} Hz"
        )
    steps = {
        "separation of tags that the scene does not list": bool(adapted.others),
        "weights against noise between the lines of the tags": adapted.room is not None,
        "correction of the receiver's compression": adapted.compression is not None,
    }
    changes += [f"adds {step}" for step, needed in steps.items() if needed]
    if adapted.tag_ratios:
        levels = " and ".join(f"{20 * math.log10(ratio):.0f} dB" for ratio in adapted.tag_ratios)
        changes.append(
            "adds to the standard deviations that the ratio of two antennas is not linear "
            f"(tag against static path: {levels})"
        )
    return changes, [step for step, needed in steps.items() if not needed]


@dataclass(frozen=True)
class MeasuredTag:
    """One tag as measured: None or empty where it, or an end of it, was not detected."""

    name: str
    clock_offset_ppm: float | None = None
    snr_db: list[float | None] = field(default_factory=list)
    phase_error_deg: list[float | None] = field(default_factory=list)

    def __str__(self) -> str:
        if self.clock_offset_ppm is None:
            return "not detected"
        text = f"clock {self.clock_offset_ppm:+.2f} ppm, SNR {_texts(self.snr_db, 1)} dB"
        if self.phase_error_deg:
            error = _texts(self.phase_error_deg, 2)
            text += f", expected phase error {error} deg per group"
        return text


def measure_tags(plan: Plan, groups: Groups) -> list[MeasuredTag]:
    """Medians of each tag over the groups in which its clock was locked."""
    return [_measure_tag(name, index, groups) for index, name in enumerate(_names(plan))]


def _measure_tag(name: str, index: int, groups: Groups) -> MeasuredTag:
    if not len(groups) or not groups.locked[:, index].any():
        return MeasuredTag(name)
    locked = groups[groups.locked[:, index]]
    ends = slice(2 * index, 2 * index + 2)
    return MeasuredTag(
        name,
        float(np.median(locked.clock_offset_ppm[:, index])),
        _finite(np.median(locked.snr_db[:, ends], axis=0).round(2)),
        _finite(np.median(locked.phase_std_deg[:, ends], axis=0).round(3)),
    )


def _finite(values: np.ndarray) -> list[float | None]:
    """Values for JSON, which has neither nan nor infinity."""
    return [float(value) if np.isfinite(value) else None for value in values]


def _texts(values: Sequence[float | None], digits: int) -> str:
    return " and ".join("unknown" if v is None else f"{v:.{digits}f}" for v in values)
