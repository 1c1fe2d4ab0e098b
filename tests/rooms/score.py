# SPDX-License-Identifier: GPL-3.0-or-later
"""Read captures of real rooms with the product and count confident wrong readings.

    build/run python3 tests/rooms/score.py [--room NAME ...] [--seeds 3] [--mixtures 100]
        [--jobs 1] [--keep FOLDER] [--json FILE] [--list]

For every room and seed: a VNA table is calibrated (``gr-wiforce calibrate``), a capture read
(``gr-wiforce read``), and the readings are compared with the truth.

A reading is judged if its whole group lies in the hold of a press (steady) or where nothing is
pressed; presses that come and go are not judged. An unflagged reading is wrong

- in a steady press, if force or location is off by more than five of its own standard deviations
  and by more than 0.3 N or 1 mm, or if it reports no touch above 1.5 N,
- where nothing is pressed, if it reports a touch.
"""

import argparse
import csv
import hashlib
import json
import math
import shutil
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path[0] = str(Path(__file__).resolve().parent.parent)

from second_simulator import FRAME, RATE, phases, pressed  # noqa: E402

from rooms.rooms import ROOMS, room_named, write_room  # noqa: E402

SIGMAS, FORCE_N, LOCATION_MM, MISSED_N = 5.0, 0.3, 1.0, 1.5


@dataclass
class Tally:
    """What is counted over the captures of a room."""

    readable: bool = False
    steady: int = 0  # readings in steady presses
    read: int = 0  # of these: touched and without a flag
    wrong: int = 0
    unflagged: int = 0  # judged readings without a flag
    untouched: int = 0  # readings where nothing is pressed
    false_touches: int = 0  # of these: touched and without a flag
    missed: int = 0  # steady presses above 1.5 N that an unflagged reading denies
    refused: list = field(default_factory=list)
    flags: dict = field(default_factory=dict)  # of steady presses
    phase_error_deg: list = field(default_factory=list)  # pairs
    force_error_n: list = field(default_factory=list)
    force_std_n: list = field(default_factory=list)
    location_error_mm: list = field(default_factory=list)
    location_std_mm: list = field(default_factory=list)
    seconds: float = 0.0

    def add(self, other):
        for name, value in vars(other).items():
            if name == "flags":
                for flag, count in value.items():
                    self.flags[flag] = self.flags.get(flag, 0) + count
            elif name == "readable":
                self.readable = value
            else:
                setattr(self, name, getattr(self, name) + value)

    def summary(self):
        """Figures of the table; NaN where there is nothing to compute them from."""
        phase = np.array(self.phase_error_deg).reshape(-1, 2)
        force, force_std = np.array(self.force_error_n), np.array(self.force_std_n)
        location, location_std = np.array(self.location_error_mm), np.array(self.location_std_mm)
        rms_1, rms_2 = rms(phase, axis=0)
        return {
            "readable": self.readable,
            "refused": sorted(set(self.refused)),
            "steady": self.steady,
            "read_share": self.read / self.steady if self.steady else math.nan,
            "unflagged": self.unflagged,
            "wrong": self.wrong,
            "missed": self.missed,
            "untouched": self.untouched,
            "false_touches": self.false_touches,
            "phase1_rms_deg": rms_1,
            "phase2_rms_deg": rms_2,
            "force_median_n": float(np.median(np.abs(force))) if len(force) else math.nan,
            "force_rms_n": rms(force),
            "force_std_rms_n": rms(force_std),
            "force_error_over_std": rms(force) / rms(force_std) if len(force) else math.nan,
            "force_within_2": share(np.abs(force) <= 2 * force_std),
            "location_median_mm": float(np.median(np.abs(location))) if len(force) else math.nan,
            "location_error_over_std": (
                rms(location) / rms(location_std) if len(force) else math.nan
            ),
            "location_within_2": share(np.abs(location) <= 2 * location_std),
            "flags": dict(sorted(self.flags.items(), key=lambda item: -item[1])),
            "seconds": self.seconds,
        }


def rms(values, axis=None):
    if not len(values):
        return math.nan if axis is None else np.array([math.nan] * 2)
    result = np.sqrt(np.mean(np.square(values), axis=axis))
    return float(result) if axis is None else result


def share(values):
    return float(np.mean(values)) if len(values) else math.nan


def command(*arguments):
    """Run the product; returns exit status and message."""
    done = subprocess.run(
        ["gr-wiforce", *map(str, arguments)], capture_output=True, text=True, timeout=300
    )
    return done.returncode, done.stderr.strip()


def calibrated(table, cache):
    """Sensor model of a VNA table beside it; equal tables are calibrated once."""
    kept = cache / f"{hashlib.sha256(table.read_bytes()).hexdigest()[:16]}.yaml"
    if not kept.exists():
        status, message = command("calibrate", table, "-o", table.with_suffix(".yaml"))
        if status:
            raise RuntimeError(f"calibrate: {message}")
        table.with_suffix(".yaml").replace(kept.with_name(f"{table.parent.name}.tmp"))
        kept.with_name(f"{table.parent.name}.tmp").replace(kept)
    shutil.copy(kept, table.with_suffix(".yaml"))


def truth_of(room, begin_s, end_s):
    """What happens in a group: "steady", "untouched" or None, and force and location."""
    margin = 1e-4
    for start, rise, hold, _, _, location in room.presses:
        if start + rise - margin <= begin_s and end_s <= start + rise + hold + margin:
            force = pressed(room.tag, np.array([(begin_s + end_s) / 2]))[0][0]
            return "steady", float(force), location
        if begin_s < start + 2 * rise + hold + margin and end_s > start - margin:
            return None, math.nan, math.nan
    return "untouched", 0.0, math.nan


def number(row, key):
    return float(row[key]) if row.get(key) else math.nan


def circular(angle):
    return (np.asarray(angle) + 180) % 360 - 180


def untouched_phases(rows):
    """Phases that readings start from: mean over the groups of the reference, (2,)."""
    reference = [row for row in rows if "reference" in row["flags"].split()]
    psi = np.array([[number(row, f"phase{i}_deg") for i in (1, 2)] for row in reference])
    return np.rad2deg(np.angle(np.exp(1j * np.deg2rad(psi)).mean(axis=0)))


def judge(room, rows, group_s):
    """Compare the readings of one capture with the truth."""
    tally = Tally()
    if not any("reference" in row["flags"].split() for row in rows):
        return tally
    start = untouched_phases(rows)
    at_rest = phases(room.tag, np.zeros(1), np.full(1, 40.0))[0]
    for row in rows:
        time_s, flags = float(row["time_s"]), row["flags"].split()
        kind, force, location = truth_of(room, time_s - group_s / 2, time_s + group_s / 2)
        touch = row["touch"] == "1"
        if kind is None or row["touch"] == "":
            continue
        tally.unflagged += not flags
        if kind == "untouched":
            tally.untouched += 1
            false = touch and not flags
            tally.false_touches += false
            tally.wrong += false
            continue
        tally.steady += 1
        for flag in flags:
            tally.flags[flag] = tally.flags.get(flag, 0) + 1
        psi = phases(room.tag, np.array([force]), np.array([location]))[0]
        error = circular(
            [number(row, f"phase{i + 1}_deg") - start[i] - psi[i] + at_rest[i] for i in (0, 1)]
        )
        if np.all(np.isfinite(error)) and touch:
            tally.phase_error_deg.append(error.tolist())
        if flags:
            continue
        if not touch:
            missed = force > MISSED_N
            tally.missed += missed
            tally.wrong += missed
            continue
        tally.read += 1
        off, std = number(row, "force_n") - force, number(row, "force_std_n")
        aside, aside_std = number(row, "location_mm") - location, number(row, "location_std_mm")
        tally.wrong += beyond(off, std, FORCE_N) or beyond(aside, aside_std, LOCATION_MM)
        if math.isfinite(off) and math.isfinite(std):
            tally.force_error_n.append(off)
            tally.force_std_n.append(std)
            tally.location_error_mm.append(aside)
            tally.location_std_mm.append(aside_std)
    return tally


def beyond(error, std, least):
    """Off by more than is said and than matters; a value without a std claims to be exact."""
    return abs(error) > least and not abs(error) <= SIGMAS * std


def score_capture(name, seed, folder, cache, keep):
    """Write, calibrate, read and judge one capture."""
    began = time.monotonic()
    room = room_named(name)
    folder.mkdir(parents=True, exist_ok=True)
    write_room(room, seed, folder)
    calibrated(folder / "finger.csv", cache)
    output = folder / "readings.csv"
    status, message = command(
        "read", folder / "capture", "--scene", folder / "scene.yaml", "-o", output
    )
    tally = Tally(refused=[f"exit {status}: {message}"])
    if status == 0:
        with open(output, newline="") as stream:
            rows = list(csv.DictReader(stream))
        times = [float(row["time_s"]) for row in rows]
        # The reader's groups are shorter than ours where it was told another frame length.
        group_s = min(np.diff(times)) if len(times) > 1 else room.group * FRAME / RATE
        tally = judge(room, rows, group_s)
    tally.readable = room.readable
    tally.seconds = time.monotonic() - began
    if not keep:
        shutil.rmtree(folder)
    return name, tally


COLUMNS = (
    # title, key, format
    ("read", "read_share", "{:.0%}"),
    ("wrong", "wrong", "{}"),
    ("of", "unflagged", "{}"),
    ("false", "false_touches", "{}"),
    ("missed", "missed", "{}"),
    ("phase1", "phase1_rms_deg", "{:.3f}"),
    ("phase2", "phase2_rms_deg", "{:.3f}"),
    ("F med", "force_median_n", "{:.3f}"),
    ("err/std", "force_error_over_std", "{:.2f}"),
    ("in 2s", "force_within_2", "{:.0%}"),
    ("l med", "location_median_mm", "{:.3f}"),
)


def row_of(name, tally):
    figures = tally.summary()
    cells = [f"{name:<26}"]
    for title, key, form in COLUMNS:
        value = figures[key]
        missing = isinstance(value, float) and math.isnan(value)
        cells.append(f"{'-' if missing else form.format(value):>{max(len(title), 6)}}")
    flags = " ".join(f"{flag}:{count}" for flag, count in figures["flags"].items())
    return " ".join([*cells, " " + (figures["refused"][0][:90] if figures["refused"] else flags)])


def parse(arguments):
    parser = argparse.ArgumentParser(
        description="Score the reader in real rooms.", epilog=__doc__.partition("\n\n")[2]
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--room", nargs="+", metavar="NAME", help="rooms, or mixture-SEED")
    parser.add_argument("--seeds", type=int, default=3, help="captures of every room")
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--mixtures", type=int, default=0, help="random mixtures, one capture each")
    parser.add_argument("--jobs", type=int, default=1, help="captures at the same time")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep all files there")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    parser.add_argument("--list", action="store_true", help="print the names of the rooms")
    options = parser.parse_args(arguments)
    for name in options.room or ():
        try:
            room_named(name)
        except (KeyError, ValueError):
            parser.error(f"--room: no room is named {name!r}; --list prints the names")
    return options


def main(arguments=None):
    options = parse(arguments)
    if options.list:
        print("\n".join(ROOMS))
        return 0
    names = options.room or ([] if options.mixtures else list(ROOMS))
    work = [
        (name, seed)
        for name in names
        for seed in range(options.first_seed, options.first_seed + options.seeds)
    ]
    first = options.first_seed
    work += [(f"mixture-{seed}", seed) for seed in range(first, first + options.mixtures)]
    base = options.keep or Path(tempfile.mkdtemp(prefix="rooms-"))
    base.mkdir(parents=True, exist_ok=True)
    print(" ".join([f"{'room':<26}", *(f"{title:>{max(len(title), 6)}}" for title, *_ in COLUMNS)]))
    tallies, total = {}, Tally()
    try:
        with ProcessPoolExecutor(options.jobs) as pool:
            tasks = [
                pool.submit(score_capture, name, seed, base / f"{name}.{seed}", base, options.keep)
                for name, seed in work
            ]
            for (name, seed), task in zip(work, tasks, strict=True):
                tally = task.result()[1]
                tallies.setdefault(name, Tally()).add(tally)
                total.add(tally)
                if (name, seed) == [item for item in work if item[0] == name][-1]:
                    print(row_of(name, tallies[name]), flush=True)
    finally:
        if not options.keep:
            shutil.rmtree(base)
    rooms_wrong = sum(tally.wrong > 0 for tally in tallies.values())
    print(
        f"wrong: {total.wrong} of {total.unflagged} unflagged readings, "
        f"in {rooms_wrong} of {len(tallies)} rooms"
    )
    if options.json:
        figures = {name: tally.summary() for name, tally in tallies.items()}
        text = json.dumps(figures, indent=1, default=float).replace("NaN", "null")
        options.json.write_text(text + "\n")
    return int(total.wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
