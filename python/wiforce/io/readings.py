# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings: what is known of one sensor in one phase group, its flags, times and messages."""

import dataclasses
import enum
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timezone
from functools import cache
from typing import Any

# A reading is flagged WEAK where the standard deviation of a phase or of the force is larger.
WEAK_PHASE_DEG = 3.0
WEAK_FORCE_N = 1.5


class Flag(enum.Flag):
    """Conditions that a user of a reading should know of."""

    REFERENCE = enum.auto()  # The group is part of the untouched reference.
    GAP = enum.auto()  # Snapshots of the group are missing.
    # The press changed inside the group, or the tag was received in a part of it only.
    TRANSITION = enum.auto()
    WEAK = enum.auto()  # Standard deviation of a phase above 3 deg, or of the force above 1.5 N.
    AMBIGUOUS = enum.auto()  # Another press, or none, explains the phases too.
    FORCE_UNOBSERVABLE = enum.auto()  # The phases do not determine the force.
    # No force and location of the sensor model explain the phases: two presses, a wide contact, a
    # broken line.
    INCONSISTENT = enum.auto()
    EXTRAPOLATED = enum.auto()  # Force or location lie outside the calibrated span.
    # A phase step common to both ends: the tag or an antenna moved, or the receiver's gain changed.
    MOVED = enum.auto()
    # Samples of 1 % of the group's snapshots reached the converter's full scale, or a lower limit.
    SATURATED = enum.auto()

    @property
    def word(self) -> str:
        """The word of a single flag in files of readings."""
        return str(self.name).lower().replace("_", "-")

    @property
    def words(self) -> frozenset[str]:
        """The words of a combination of flags."""
        return frozenset(flag_words(self.value))


# By meaning, for those who decide by flags. EXPLANATION says how force and location of the sensor
# file explain the phases; every other flag, a new one too, says how the group was received.
EXPLANATION = (
    Flag.WEAK | Flag.AMBIGUOUS | Flag.FORCE_UNOBSERVABLE | Flag.INCONSISTENT | Flag.EXTRAPOLATED
)
RECEPTION = ~EXPLANATION
# With these the phases may be others than those of one force and location.
DOUBTED = RECEPTION | Flag.AMBIGUOUS | Flag.INCONSISTENT


@cache
def flag_words(bits: int) -> tuple[str, ...]:
    """The words of flags that are given as the sum of their values, in the order of the members."""
    return tuple(flag.word for flag in Flag if bits & flag.value)


@cache
def flag_bits(words: tuple[str, ...]) -> int:
    """The sum of the values of flags that are given by their words."""
    return sum(flag.value for flag in Flag if flag.word in words)


@dataclass(frozen=True)
class Reading:
    """One sensor in one phase group.

    Attributes
    ----------
    time_s : float
        Centre of the group, in s from the capture's first sample.
    sensor : str
        Its name.
    touch : int or None
        1 when the line is shorted, 0 when not, None when it is not known.
    force_n, force_std_n, location_mm, location_std_mm : float or None
        Force in N and location in mm from port 1, with standard deviations; None when not
        touched.
    phase1_deg, phase2_deg : float or None
        psi_1 and psi_2 in (-180, 180].
    snr_db : float or None
        SNR of this group, of the weaker end, per subcarrier and snapshot.
    flags : tuple of str
        Words of :class:`Flag`, in its order; empty when nothing is wrong.
    group : int or None
        Index of the phase group on the grid of the run, counted from 0; None for phases that are
        not from a run.
    interference : float or None
        Share of the group's snapshots that were left out because another transmitter interfered
        with them, 0 to 1; None where nothing was received.

    Examples
    --------
    >>> reading = Reading(0.018, "arm", 1, 4.12345678, 0.05, 45.0, 0.1, flags=("gap",))
    >>> reading.row()["force_n"], reading.row()["flags"]
    (4.1235, 'gap')
    >>> print(reading)
    0.018 s arm: 4.12 +- 0.10 N at 45.00 +- 0.20 mm (gap)
    """

    time_s: float
    sensor: str
    touch: int | None = None
    force_n: float | None = None
    force_std_n: float | None = None
    location_mm: float | None = None
    location_std_mm: float | None = None
    phase1_deg: float | None = None
    phase2_deg: float | None = None
    snr_db: float | None = None
    flags: tuple[str, ...] = ()
    group: int | None = None
    interference: float | None = None

    def __str__(self) -> str:
        flags = f" ({' '.join(self.flags)})" if self.flags else ""
        return f"{self.time_s:.3f} s {self.sensor}: {self.press()}{flags}"

    def press(self, bounds: bool = True) -> str:
        """Touch, or force and location, with two standard deviations if ``bounds``."""
        if self.force_n is None and self.location_mm is None:
            return {0: "untouched", 1: "touched", None: "touch unknown"}[self.touch]
        force = _with_std(self.force_n, self.force_std_n, "N", bounds)
        return f"{force} at {self._place(bounds)}"

    def _place(self, bounds: bool) -> str:
        return _with_std(self.location_mm, self.location_std_mm, "mm", bounds)

    def row(self) -> dict[str, Any]:
        """The reading as a row of a file, by column: rounded numbers, None, flags as one text."""
        row = {**vars(self), "flags": " ".join(self.flags)}
        for key in _DECIMALS:
            if (value := row.get(key)) is not None:
                row[key] = rounded(key, value)
        return row


def _with_std(value: float | None, std: float | None, unit: str, bounds: bool) -> str:
    if value is None:
        return f"unknown {unit}"
    spread = "" if std is None or not bounds else f" +- {2 * std:.2f}"
    return f"{value:.2f}{spread} {unit}"


@dataclass(frozen=True)
class SurfaceReading(Reading):
    """One press on a surface in one phase group; ``location_mm`` is x, along the strips."""

    y_mm: float | None = None  # across the strips
    y_std_mm: float | None = None
    cov_force_x: float | None = None  # covariances of force and position, in N mm
    cov_force_y: float | None = None
    cov_x_y: float | None = None  # in mm^2

    def _place(self, bounds: bool) -> str:
        across = _with_std(self.y_mm, self.y_std_mm, "mm", bounds)
        return f"x {super()._place(bounds)}, y {across}"


COLUMNS = tuple(Reading.__dataclass_fields__)


def reading_of(fields: Iterable[Any]) -> Reading:
    """A reading of all its fields in order, which a frozen class would set one by one."""
    reading = object.__new__(Reading)
    reading.__dict__.update(zip(COLUMNS, fields, strict=True))
    return reading


# Columns that follow where a scene has a surface.
SURFACE_COLUMNS = tuple(SurfaceReading.__dataclass_fields__)[len(COLUMNS) :]
NUMBERS = tuple(name for name in COLUMNS if name not in ("sensor", "touch", "flags", "group"))
# What an inversion estimates, under the names that it has in Inversion and Groups as well.
ESTIMATES = ("force_n", "force_std_n", "location_mm", "location_std_mm")
# A group's centre lies on half samples, 40 ns apart at 12.5 Msps: coarser times could not be joined
# with those of another file.
_DECIMALS = dict.fromkeys((*NUMBERS, *SURFACE_COLUMNS), 4) | {"time_s": 9, "snr_db": 2}


def rounded(key: str, value: float) -> float | None:
    """A number of a column ``key`` as files hold it, None when it is not finite."""
    return round(value, _DECIMALS[key]) if math.isfinite(value) else None


# Flags of groups that are counted apart.
_REFERENCE, _CHANGING, _SATURATED = "reference", "transition", "saturated"


def outcome_words(counts: Mapping[str, int], doubts: str = "") -> str:
    """Numbers of groups by outcome in words, with ``doubts`` behind the doubtful ones."""
    parts = (
        (counts["reference"], "reference"),
        (counts["changing"], "while pressing, releasing or received in part"),
        (counts["flagged"] - counts["reference"] - counts["changing"], f"doubtful{doubts}"),
        (counts["dropped"], "lost"),
    )
    return f"{counts['clear']} usable" + "".join(f", {n} {what}" for n, what in parts if n)


@dataclass
class GroupCounts:
    """Counts of phase groups by outcome; together all groups that the stream spans."""

    clear: int = 0  # without a flag of any sensor
    flagged: int = 0  # the next two included
    dropped: int = 0  # of which nothing was received
    reference: int = 0
    # In which something began, ended or changed, or the tag was received in a part only.
    changing: int = 0
    # Of the other flagged groups and the saturated ones, by word.
    flags: Counter[str] = field(default_factory=Counter)
    # Those of the reference in which a sensor was touched, by its name.
    touched: Counter[str] = field(default_factory=Counter)

    def note(self, readings: Iterable[Reading]) -> None:
        """Count one group by its readings, one per sensor."""
        flags = set[str]()
        for reading in readings:
            flags.update(reading.flags)
            if reading.touch and _REFERENCE in reading.flags:
                self.touched[reading.sensor] += 1
        if not flags:
            self.clear += 1
            return
        self.flagged += 1
        if _SATURATED in flags:  # the cause of what the others say
            self.flags.update(flags - {_REFERENCE, _CHANGING})
        elif _REFERENCE in flags:
            self.reference += 1
        elif _CHANGING in flags:
            self.changing += 1
        else:
            self.flags.update(flags)

    def add(self, other: "GroupCounts") -> None:
        """Add the counts of another run."""
        for name, count in vars(other).items():
            setattr(self, name, getattr(self, name) + count)

    @property
    def groups(self) -> int:
        return self.clear + self.flagged + self.dropped

    def touched_reference(self) -> dict[str, str]:
        """What to say of each sensor that was touched while its reference was measured."""
        return {
            name: f"{name}: was touched in {_groups(count)} of the reference; its readings rest on "
            "the untouched ones before or behind; begin untouched"
            for name, count in self.touched.items()
        }

    def asdict(self) -> dict[str, int]:
        """Number of groups by outcome."""
        keys = "clear", "flagged", "dropped", "reference", "changing"
        return {key: getattr(self, key) for key in keys}

    def __str__(self) -> str:
        words = [flag.word for flag in Flag if self.flags[flag.word]]
        named = ", ".join(f"{self.flags[word]} {word}" for word in words)
        return f"{_groups(self.groups)}: {outcome_words(self.asdict(), f' ({named})')}"


def _groups(count: int) -> str:
    return f"{count} group{'' if count == 1 else 's'}"


_FLAGS = frozenset(flag.word for flag in Flag)


def as_reading(reading: Any) -> Reading | None:
    """A Reading from a message of the port ``readings``, or a part; None without sensor or time."""
    if isinstance(reading, Reading):
        reading = dataclasses.asdict(reading)
    if not isinstance(reading, dict):
        return None
    numbers = {name: _number(reading.get(name)) for name in NUMBERS}
    time_s, sensor = numbers.pop("time_s"), reading.get("sensor")
    if time_s is None or not isinstance(sensor, str) or not sensor:
        return None
    touch = _number(reading.get("touch"))
    group = _number(reading.get("group"))
    flags = reading.get("flags") or ()
    flags = flags.split() if isinstance(flags, str) else flags
    also = {name: _number(reading.get(name)) for name in SURFACE_COLUMNS}
    kind, known = (Reading, numbers) if also["y_mm"] is None else (SurfaceReading, numbers | also)
    return kind(
        time_s=time_s,
        sensor=sensor,
        touch=None if touch is None else int(touch == 1),
        flags=tuple(flag for flag in flags if flag in _FLAGS),
        group=None if group is None else int(group),
        **known,
    )


def _number(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if math.isfinite(value) else None


def written_utc(utc_s: float | None) -> str:
    """Write a time in seconds since 1970; empty for an unknown one."""
    if utc_s is None:
        return ""
    written = datetime.fromtimestamp(utc_s, timezone.utc).isoformat(timespec="microseconds")
    return written.replace("+00:00", "Z")


def parsed_utc(text: str) -> datetime:
    """Parse a time that :func:`written_utc` or another program wrote, or raise ValueError."""
    # Python 3.10 accepts neither Z nor other decimals than three or six.
    decimals = re.sub(r"\.(\d+)", lambda found: f".{found[1]:0<6.6}", text)
    return datetime.fromisoformat(decimals.replace("Z", "+00:00"))
