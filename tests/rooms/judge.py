# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of a capture against the truth."""

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from second_simulator import FRAME, RATE, phases, pressed

# What makes an unflagged reading wrong.
SIGMAS, FORCE_N, LOCATION_MM, MISSED_N = 5.0, 0.3, 1.0, 1.5


@dataclass
class Touch:
    """A reading of a steady press that says touched; errors are reading minus truth."""

    flagged: bool
    phase_deg: tuple  # errors of both ends
    force_n: float
    force_std_n: float
    location_mm: float
    location_std_mm: float

    @property
    def wrong(self):
        return beyond(self.force_n, self.force_std_n, FORCE_N) or beyond(
            self.location_mm, self.location_std_mm, LOCATION_MM
        )


def beyond(error, std, least):
    """Off by more than is said and than matters; a value without a std claims to be exact."""
    return abs(error) > least and not abs(error) <= SIGMAS * std


@dataclass
class Tally:
    """What is counted over the captures of a room. Only steady groups are judged."""

    steady: int = 0  # readings in steady presses
    untouched: int = 0  # readings where nothing is pressed
    unflagged: int = 0  # of both
    false_touches: int = 0  # unflagged
    missed: int = 0  # steady presses above 1.5 N that an unflagged reading denies
    touches: list = field(default_factory=list)
    rejected: list = field(default_factory=list)  # share of each group, because of interference
    refused: list = field(default_factory=list)  # messages of the product
    flags: Counter = field(default_factory=Counter)  # of steady presses
    captures: int = 0
    suspected: Counter = field(default_factory=Counter)  # captures by what the reader suspects
    seconds: float = 0.0

    def add(self, other):
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)

    @property
    def wrong(self):
        own = sum(touch.wrong for touch in self.touches if not touch.flagged)
        return own + self.false_touches + self.missed

    def summary(self):
        """Figures by name; NaN where there is nothing to compute them from.

        Errors are those of unflagged touches, but ``all_phases_rms_deg`` includes flagged ones.
        """
        trusted = [touch for touch in self.touches if not touch.flagged]
        phase = np.array([touch.phase_deg for touch in trusted]).reshape(-1, 2)
        every_phase = np.array([touch.phase_deg for touch in self.touches]).reshape(-1)
        figures = {
            "refused": sorted(set(self.refused)),
            "steady": self.steady,
            "read_share": len(trusted) / self.steady if self.steady else math.nan,
            "unflagged": self.unflagged,
            "wrong": self.wrong,
            "missed": self.missed,
            "untouched": self.untouched,
            "false_touches": self.false_touches,
            "phase1_rms_deg": rms(phase[:, 0]),
            "phase2_rms_deg": rms(phase[:, 1]),
            "all_phases_rms_deg": rms(every_phase),
            "captures": self.captures,
            "suspected": dict(self.suspected.most_common()),
            "rejected": float(np.mean(self.rejected)) if self.rejected else math.nan,
        }
        for key, unit in (("force", "n"), ("location", "mm")):
            error = np.array([getattr(touch, f"{key}_{unit}") for touch in trusted])
            std = np.array([getattr(touch, f"{key}_std_{unit}") for touch in trusted])
            size = np.abs(error)
            figures |= {
                f"{key}_median_{unit}": float(np.median(size)) if len(size) else math.nan,
                f"{key}_90th_{unit}": float(np.quantile(size, 0.9)) if len(size) else math.nan,
                f"{key}_rms_{unit}": rms(error),
                f"{key}_std_rms_{unit}": rms(std),
                f"{key}_error_over_std": rms(error) / rms(std) if len(size) else math.nan,
                f"{key}_within_2": float(np.mean(size <= 2 * std)) if len(size) else math.nan,
            }
        return figures | {"flags": dict(self.flags.most_common()), "seconds": self.seconds}


def rms(values):
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else math.nan


# What the reader suspects by the presses, and how its warning of it begins.
SUSPICIONS = {
    "other sensor": "touched readings have phases that no calibrated press causes",
    "swapped ends": "the ends are swapped",
    "moving location": "the location moves with the force",
    "off state": "changes as with an off state",
    "amplitude": "pressing changes the amplitude",
}


def suspected(messages):
    """Kinds of mistakes that messages of the reader suspect."""
    return Counter(kind for kind, text in SUSPICIONS.items() if text in messages)


def truth_of(room, begin_s, end_s):
    """What happens in a group: "steady", "untouched" or "changing", and force and location."""
    margin = 1e-4
    for start, rise, hold, _, _, location in room.presses:
        if start + rise - margin <= begin_s and end_s <= start + rise + hold + margin:
            force = pressed(room.tag, np.array([(begin_s + end_s) / 2]))[0][0]
            return "steady", float(force), location
        if begin_s < start + 2 * rise + hold + margin and end_s > start - margin:
            return "changing", math.nan, math.nan
    return "untouched", 0.0, math.nan


def number(row, key):
    return float(row[key]) if row.get(key) else math.nan


def read_phases(row):
    return np.array([number(row, "phase1_deg"), number(row, "phase2_deg")])


def phases_at_rest(rows):
    """Phases that readings start from: mean over the groups of the reference, (2,)."""
    reference = [read_phases(row) for row in rows if "reference" in row["flags"].split()]
    if not reference:
        return np.full(2, math.nan)
    return np.rad2deg(np.angle(np.exp(1j * np.deg2rad(reference)).mean(axis=0)))


def judge(room, rows):
    """Compare the readings of one capture, rows of the product's CSV, with the truth."""
    tally = Tally()
    times = [float(row["time_s"]) for row in rows]
    # The reader's groups are shorter than ours where its scene states another frame length.
    group_s = min(np.diff(times)) if len(times) > 1 else room.group * FRAME / RATE
    rest = phases_at_rest(rows)
    rest -= phases(room.tag, np.zeros(1), np.full(1, 40.0))[0]
    for time_s, row in zip(times, rows, strict=True):
        kind, force, location = truth_of(room, time_s - group_s / 2, time_s + group_s / 2)
        flags, touch = row["flags"].split(), row["touch"] == "1"
        if kind == "changing":
            continue
        tally.unflagged += not flags
        tally.rejected.append(number(row, "interference"))
        if kind == "untouched":
            tally.untouched += 1
            tally.false_touches += touch and not flags
            continue
        tally.steady += 1
        tally.flags.update(flags)
        if touch:
            psi = phases(room.tag, np.array([force]), np.array([location]))[0]
            error = (read_phases(row) - psi - rest + 180) % 360 - 180
            tally.touches.append(
                Touch(
                    bool(flags),
                    tuple(error.tolist()),
                    number(row, "force_n") - force,
                    number(row, "force_std_n"),
                    number(row, "location_mm") - location,
                    number(row, "location_std_mm"),
                )
            )
        elif not flags and force > MISSED_N:
            tally.missed += 1
    return tally


def failures(room, figures):
    """What a room's figures lack of the acceptance, as short words."""
    share = figures["read_share"]
    least = 0.8 if room.phase_deg is not None else 0.7
    worst_phase = max(figures["phase1_rms_deg"], figures["phase2_rms_deg"])
    quiet = figures["force_error_over_std"] < 1 / 3
    reasons = {
        "refused": bool(figures["refused"]) and not room.refusable,
        "wrong": figures["wrong"] > 0,
        "false": figures["false_touches"] > 0.01 * max(figures["untouched"], 1),
        # Comparisons with NaN are false: nothing was read.
        "flags": room.readable and not share >= least,
        "phase": room.phase_deg is not None and not worst_phase <= room.phase_deg,
        "force": room.force_n is not None and not figures["force_median_n"] <= room.force_n,
        "2s": room.readable and not figures["force_within_2"] >= 0.9,
        "std": room.readable and quiet,
    }
    return [word for word, failed in reasons.items() if failed]
