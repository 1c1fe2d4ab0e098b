# SPDX-License-Identifier: GPL-3.0-or-later
"""Compares readings with what was played."""

import re
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd
from loops import RATE_HZ
from world import LOST, OFF

# A reading is wrong if it is off by more than each of these.
_STDS, _FORCE_N, _LOCATION_MM = 5.0, 0.3, 1.0
# Around the force that shorts the line, a touch may be read or not.
_ONSET_MARGIN_N = 0.3
_POINTS = 9  # of a group at which the truth is asked for
# By which times may be off, and for each slip of the frame timing and each loss.
_MARGIN_S, _SLIP_S = 1.5e-3, 0.3e-3
# The reader looks at its frame timing every 1024 frames.
_SLIP_LASTS_S = 0.6
# For a clock that was set, and for the reader that is behind.
_UTC_S, _UTC_LATE_S = 0.1, 14.0
_RENAMED = re.compile(r"-\d{8}T\d{6}\.\d{3}Z\.csv")


class Judge:
    """Reads the files of readings, and counts what is wrong.

    ``output``: of the reader; renamed files lie beside it, and are deleted when they have been
    read. ``counts``: of readings, by what they are; ``flags``: of readings, by their flags.
    """

    def __init__(self, output, world):
        self._output, self._world = Path(output), world
        self.counts, self.flags, self.problems = Counter(), Counter(), []
        self._next_group, self._rest = {}, 0

    def read_renamed(self):
        """Judge the files that the reader has finished."""
        pattern = f"{self._output.stem}-*Z.csv"
        for path in sorted(self._output.parent.glob(pattern)):
            if _RENAMED.fullmatch(path.name.removeprefix(self._output.stem)):
                self._judge_file(path)
                path.unlink()

    def read_all(self):
        """Judge what is left, after the end."""
        self.read_renamed()
        self._judge_file(self._output)
        for name, run in self._world.runs.items():
            groups, expected = self._next_group.get(name, 0), run.total // self._world.group
            # The last frames may be incomplete after a slip; a full disk takes no more rows.
            if not run.full and run.status == 0 and abs(groups - expected) > 1 + len(run.slips):
                self.problems.append(f"run {name}: {groups} groups instead of {expected}")

    def _judge_file(self, path):
        if path.read_bytes()[-1:] != b"\n":
            self.problems.append(f"{path.name} ends within a row")
        table = pd.read_csv(path, keep_default_na=False, na_values=[""], low_memory=False)
        table["flags"] = table["flags"].fillna("")
        for name, rows in table.groupby("run", sort=False):
            self._judge_rows(name, self._world.runs[name], rows.reset_index(drop=True))

    def _judge_rows(self, name, run, rows):
        first = self._next_group.get(name, 0)
        self._check_order(name, rows, first)
        self._next_group[name] = int(rows["group"].iloc[-1]) + 1
        truth = self._truth(run, rows["time_s"].to_numpy())
        flags = rows["flags"].to_numpy(str)
        unflagged = np.isin(flags, ("", "reference"))
        touch = rows["touch"].to_numpy(float)
        self.counts["rows"] += len(rows)
        self.counts["unflagged"] += int(unflagged.sum())
        self.counts["unflagged touched"] += int((unflagged & (touch == 1)).sum())
        self.flags.update(flags)
        wrong = unflagged & self._wrong(rows, touch, truth)
        self._note(name, rows, wrong, "wrong without a flag")
        # What was received as a whole must not be missing.
        absent = np.char.find(flags, "gap") >= 0
        self._note(name, rows, absent & truth["whole"], "received, but flagged gap")
        self._note(name, rows, ~absent & truth["nothing"], "lost, but not flagged gap")
        late_s = self._utc_late_s(run, rows)
        bad = late_s > _UTC_LATE_S
        after = f"{late_s[bad].max():.1f} s after that clock was set" if bad.any() else ""
        self._note(name, rows, bad, f"wrong time_utc, {after}")

    def _check_order(self, name, rows, first):
        """Every group once and in order; only a break of more than an hour has no rows."""
        groups = rows["group"].to_numpy()
        steps = np.diff(groups, prepend=first - 1)
        skipped = steps - 1
        hour = 3600 * RATE_HZ / self._world.group
        for at in np.flatnonzero((skipped != 0) & (skipped < hour)):
            self.problems.append(f"run {name}: group {groups[at]} follows by {steps[at]}")
        self.counts["skipped in long breaks"] += int(skipped[skipped >= hour].sum())
        times = (groups + 0.5) * self._world.group / RATE_HZ
        if np.abs(times - rows["time_s"]).max() > 2e-6:
            self.problems.append(f"run {name}: time_s is not on the grid of groups")

    def _truth(self, run, times_s):
        """What was played in each group: extremes of the force, location, and what was lost."""
        late_s = _MARGIN_S + _SLIP_S * (len(run.slips) + run.gaps)
        half_s = self._world.group / RATE_HZ / 2 + late_s
        points = times_s[:, None] + np.linspace(-half_s, half_s, _POINTS)
        samples = np.clip(np.round(points * RATE_HZ).astype(np.int64), 0, run.total - 1)
        stretch = np.searchsorted(run.starts, samples, "right") - 1
        loops = np.asarray(run.loops)[stretch]
        inside = samples - np.asarray(run.starts)[stretch]
        positions = (np.asarray(run.positions)[stretch] + inside) % self._world.loops.length
        force, location = np.zeros(loops.shape), np.full(loops.shape, np.nan)
        for loop in range(len(self._world.loops.loops)):
            at = loops == loop
            force[at], location[at] = self._world.loops.truth(loop, positions[at])
        lost = loops == LOST
        # A loss of a few samples may lie between the points.
        begins, ends = self._losses(run)
        losses = np.searchsorted(begins, samples[:, -1], "right")
        losses -= np.searchsorted(ends, samples[:, 0], "left")
        # Where samples of a press were lost, it is as it was just before and after.
        return {
            "least_n": np.where(lost, np.inf, force).min(axis=1),
            "most_n": np.where(lost, 0, force).max(axis=1),
            "location_mm": _first_finite(location),
            "off": (loops == OFF).any(axis=1),
            "whole": ~lost.any(axis=1) & (losses == 0),
            "nothing": lost.all(axis=1),
        }

    @staticmethod
    def _losses(run):
        """Where samples are missing, with those that a slip of the frame timing costs."""
        starts, lost = np.asarray([*run.starts, run.total]), np.asarray(run.loops) == LOST
        slips = np.asarray(run.slips, float)
        begins = np.concatenate([starts[:-1][lost], slips])
        ends = np.concatenate([starts[1:][lost], slips + _SLIP_LASTS_S * RATE_HZ])
        return np.sort(begins), np.sort(ends)

    def _wrong(self, rows, touch, truth):
        onset = self._world.loops.onset_n
        wrong = (touch == 1) & (truth["most_n"] < onset - _ONSET_MARGIN_N)
        wrong |= (touch == 0) & (truth["least_n"] > onset + _ONSET_MARGIN_N) & ~truth["off"]
        force, std = rows["force_n"].to_numpy(float), rows["force_std_n"].to_numpy(float)
        least, most = truth["least_n"], truth["most_n"]
        off_n = np.maximum(least - force, force - most)
        read = (touch == 1) & ~np.isnan(force)
        wrong |= read & (off_n > _STDS * std) & (off_n > _FORCE_N)
        off_mm = np.abs(rows["location_mm"].to_numpy(float) - truth["location_mm"])
        std_mm = rows["location_std_mm"].to_numpy(float)
        return wrong | read & (off_mm > _STDS * std_mm) & (off_mm > _LOCATION_MM)

    def _utc_late_s(self, run, rows):
        """How long ago the clock was set whose UTC each row states; infinite if it is of none."""
        utc = pd.to_datetime(rows["time_utc"], utc=True).astype("int64").to_numpy() / 1e9
        times_s = rows["time_s"].to_numpy()
        stated = utc - times_s
        late_s = np.full(len(rows), np.inf)
        ends_s = [at / RATE_HZ for at, _ in run.utc[1:]] + [np.inf]
        for (begin, offset), end_s in zip(run.utc, ends_s, strict=True):
            stating = (times_s >= begin / RATE_HZ - 2) & (np.abs(stated - offset) < _UTC_S)
            since_s = np.where(stating, np.maximum(times_s - end_s, 0), np.inf)
            late_s = np.minimum(late_s, since_s)
        return late_s

    def _note(self, name, rows, bad, what):
        self.counts[what] += int(bad.sum())
        for at in np.flatnonzero(bad)[:5]:
            row = rows.iloc[at].drop(["run"]).to_dict()
            self.problems.append(f"run {name}: {what}: {row}")
            print("PROBLEM", self.problems[-1], flush=True)


def _first_finite(values):
    """The first finite value of each row, or NaN."""
    finite = np.isfinite(values)
    return values[np.arange(len(values)), finite.argmax(axis=1)]
