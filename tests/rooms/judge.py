# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of a capture against the truth."""

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from second_simulator import FRAME, RATE, phases, pressed

# What makes an unflagged reading wrong.
SIGMAS, FORCE_N, LOCATION_MM, MISSED_N = 5.0, 0.3, 1.0, 1.5
PHASES = ["phase1_deg", "phase2_deg"]


@dataclass
class Tally:
    """What is found in the captures of a room.

    ``judged``: tables of `judge`; ``refused``: messages of the product; ``suspected``: captures by
    what the reader suspects.
    """

    judged: list = field(default_factory=list)
    refused: list = field(default_factory=list)
    suspected: Counter = field(default_factory=Counter)

    def add(self, other):
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)

    @property
    def readings(self):
        """All readings that are judged."""
        none = pd.DataFrame(columns=COLUMNS, dtype=float).astype(dict.fromkeys(MARKS, bool))
        return pd.concat(self.judged) if self.judged else none

    @property
    def wrong(self):
        return int(self.readings["wrong"].sum())

    @property
    def touches(self):
        """Readings of a steady press that say touched."""
        return self.readings.query("steady and touched")

    def summary(self):
        """Figures by name; NaN where there is nothing to compute them from.

        Errors are those of unflagged touches, but ``all_phases_rms_deg`` includes flagged ones.
        """
        read, touches = self.readings, self.touches
        trusted, steady = touches[~touches["flagged"]], read[read["steady"]]
        force = trusted["force_n"]
        return {
            "refused": sorted(set(self.refused)),
            "steady": len(steady),
            "read_share": len(trusted) / len(steady) if len(steady) else math.nan,
            "unflagged": int((~read["flagged"]).sum()),
            "wrong": self.wrong,
            "missed": int((steady["wrong"] & ~steady["touched"]).sum()),
            "untouched": len(read) - len(steady),
            "false_touches": int((read["wrong"] & ~read["steady"]).sum()),
            "phase1_rms_deg": rms(trusted["phase1_deg"]),
            "phase2_rms_deg": rms(trusted["phase2_deg"]),
            "all_phases_rms_deg": rms(touches[PHASES].to_numpy(float).ravel()),
            "suspected": dict(self.suspected.most_common()),
            "rejected": read["interference"].mean(),
            "force_median_n": force.abs().median(),
            "force_90th_n": force.abs().quantile(0.9),
            "force_error_over_std": rms(force) / rms(trusted["force_std_n"]),
            "force_within_2": (force.abs() <= 2 * trusted["force_std_n"]).mean(),
            "location_median_mm": trusted["location_mm"].abs().median(),
            "flags": dict(Counter(" ".join(steady["flags"]).split()).most_common()),
        }


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
    return "untouched", 0.0, 40.0


def phases_at_rest(readings):
    """Phases that readings start from: mean over the groups of the reference, (2,)."""
    reference = readings.loc[readings["flags"].str.contains("reference"), PHASES]
    return np.rad2deg(np.angle(np.exp(1j * np.deg2rad(reference.to_numpy(float))).mean(axis=0)))


MARKS = ["steady", "touched", "flagged", "wrong"]
COLUMNS = [*MARKS, "force_n", "force_std_n", "location_mm", "location_std_mm", *PHASES, "flags"]
COLUMNS += ["interference"]


def judge(room, readings):
    """Compare the readings of one capture, the product's table, with the truth.

    Returns a table of the readings whose group is ``steady`` or untouched; force, location and
    phases are errors, reading minus truth.
    """
    found = readings.fillna({"flags": ""})
    # The reader's groups are shorter than ours where its scene states another frame length.
    half_s = (found["time_s"].diff().min() if len(found) > 1 else room.group * FRAME / RATE) / 2
    truth = [truth_of(room, time_s - half_s, time_s + half_s) for time_s in found["time_s"]]
    kind, force, location = (np.array(each) for each in zip(*truth, strict=True))
    psi = phases(room.tag, force, location)
    rest = phases_at_rest(found) - phases(room.tag, np.zeros(1), np.full(1, 40.0))[0]
    found[PHASES] = (found[PHASES] - psi - rest + 180) % 360 - 180
    found["force_n"] -= force
    found["location_mm"] -= location
    found["steady"], found["touched"] = kind == "steady", found["touch"] == 1
    found["flagged"] = found["flags"] != ""
    # Off by more than is said and than matters; a value without a std claims to be exact.
    off = np.zeros(len(found), bool)
    for name, std, least in (
        ("force_n", "force_std_n", FORCE_N),
        ("location_mm", "location_std_mm", LOCATION_MM),
    ):
        error = found[name].abs()
        off |= (error > least) & ~(error <= SIGMAS * found[std])
    missed = found["steady"] & ~found["touched"] & (force > MISSED_N)
    wrong = missed | found["touched"] & (off | ~found["steady"])
    found["wrong"] = wrong & ~found["flagged"]
    return found.loc[kind != "changing", COLUMNS]


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
