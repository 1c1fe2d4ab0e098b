# SPDX-License-Identifier: GPL-3.0-or-later
"""Read captures of real rooms with the product and count confident wrong readings.

    build/run python3 tests/rooms/score.py [--room NAME ...] [--seeds 3] [--mixtures 100]
        [--jobs 1] [--keep FOLDER] [--list]

For every room and seed: a VNA table is calibrated (``gr-wiforce calibrate``), a capture read
(``gr-wiforce read``), and the readings are compared with the truth.

A reading is judged if its whole group lies in the hold of a press (steady) or where nothing is
pressed; presses that come and go are not judged. An unflagged reading is wrong

- in a steady press, if force or location is off by more than five of its own standard deviations
  and by more than 0.3 N or 1 mm, or if it reports no touch above 1.5 N,
- where nothing is pressed, if it reports a touch.
"""

import argparse
import hashlib
import math
import shutil
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from pathlib import Path

TESTS = Path(__file__).resolve().parent.parent
sys.path[:1] = [str(TESTS), str(TESTS / "helpers"), str(TESTS / "models")]

import pandas as pd  # noqa: E402
from command_runs import run_command, succeeded  # noqa: E402

from rooms.judge import Tally, failures, judge, suspected  # noqa: E402
from rooms.rooms import ROOMS, TABLES, room_named, write_room  # noqa: E402


def calibrated(table, cache):
    """Sensor model of a VNA table beside it; equal tables are calibrated once."""
    kept = cache / f"{hashlib.sha256(table.read_bytes()).hexdigest()[:16]}.yaml"
    if not kept.exists():
        succeeded("calibrate", table, "-o", table.with_suffix(".yaml"))
        table.with_suffix(".yaml").replace(kept.with_name(f"{table.parent.name}.tmp"))
        kept.with_name(f"{table.parent.name}.tmp").replace(kept)
    shutil.copy(kept, table.with_suffix(".yaml"))


def score_capture(name, seed, folder, cache, keep=False, room=None):
    """Write, calibrate, read and judge one capture; of another room than its name's if given."""
    room = room or room_named(name)
    folder.mkdir(parents=True, exist_ok=True)
    write_room(room, seed, folder)
    calibrated(folder / "finger.csv", cache)
    output = folder / "readings.csv"
    files = folder / "capture", "--scene", folder / "scene.yaml", "-o", output
    done = run_command("read", *files)
    if done.returncode == 0:
        tally = Tally([judge(room, pd.read_csv(output))], suspected=suspected(done.stderr))
    else:
        said = done.stderr.strip().replace(f"{folder}/", "")
        tally = Tally(refused=[f"exit {done.returncode}: {said}"])
    if not keep:
        shutil.rmtree(folder)
    return tally


COLUMNS = (
    # title, key, format
    ("read", "read_share", "{:.0%}"),
    ("wrong", "wrong", "{}"),
    ("of", "unflagged", "{}"),
    ("false", "false_touches", "{}"),
    ("missed", "missed", "{}"),
    ("phase1", "phase1_rms_deg", "{:.3f}"),
    ("phase2", "phase2_rms_deg", "{:.3f}"),
    ("all", "all_phases_rms_deg", "{:.3f}"),
    ("F med", "force_median_n", "{:.3f}"),
    ("F 90th", "force_90th_n", "{:.3f}"),
    ("err/std", "force_error_over_std", "{:.2f}"),
    ("in 2s", "force_within_2", "{:.0%}"),
    ("l med", "location_median_mm", "{:.3f}"),
    ("left out", "rejected", "{:.0%}"),
)


def header():
    titles = (f"{title:>{max(len(title), 6)}}" for title, *_ in COLUMNS)
    return " ".join([f"{'room':<26}", *titles, " fails; flags of steady presses, suspicions"])


def row_of(name, figures):
    cells = [f"{name:<26}"]
    for title, key, form in COLUMNS:
        value = figures[key]
        missing = isinstance(value, float) and math.isnan(value)
        cells.append(f"{'-' if missing else form.format(value):>{max(len(title), 6)}}")
    fails = ",".join(failures(room_named(name), figures)) or "-"
    counts = figures["flags"] | figures["suspected"]
    flags = " ".join(f"{flag}:{count}" for flag, count in counts.items())
    return " ".join([*cells, f" {fails};", flags, *(text[:120] for text in figures["refused"])])


def parse(arguments):
    parser = argparse.ArgumentParser(
        description="Score the reader in real rooms.", epilog=__doc__.partition("\n\n")[2]
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "--room",
        nargs="+",
        metavar="NAME",
        help=f"rooms, mixture-SEED, or those of a table: {' or '.join(TABLES)}",
    )
    parser.add_argument("--seeds", type=int, default=3, help="captures of every room")
    parser.add_argument("--mixtures", type=int, default=0, help="random mixtures, one capture each")
    parser.add_argument("--jobs", type=int, default=1, help="captures at the same time")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep all files there")
    parser.add_argument("--list", action="store_true", help="print the names of the rooms")
    options = parser.parse_args(arguments)
    options.room = [name for each in options.room or () for name in TABLES.get(each, [each])]
    for name in options.room:
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
    seeds = {name: range(1, options.seeds + 1) for name in names}
    seeds |= {f"mixture-{seed}": [seed] for seed in range(1, options.mixtures + 1)}
    kept = nullcontext(options.keep) if options.keep else tempfile.TemporaryDirectory()
    tallies, total = {}, Tally()
    print(header())
    with kept as base, ProcessPoolExecutor(options.jobs) as pool:
        base = Path(base)

        def scored(name, seed):
            folder = base / f"{name}.{seed}"
            return pool.submit(score_capture, name, seed, folder, base, options.keep)

        tasks = {name: [scored(name, seed) for seed in seeds[name]] for name in seeds}
        for name, own in tasks.items():
            tallies[name] = Tally()
            for task in own:
                tallies[name].add(task.result())
            print(row_of(name, tallies[name].summary()), flush=True)
            total.add(tallies[name])
    rooms_wrong = sum(tally.wrong > 0 for tally in tallies.values())
    print(
        f"wrong: {total.wrong} of {total.summary()['unflagged']} unflagged readings, "
        f"in {rooms_wrong} of {len(tallies)} rooms"
    )
    return int(total.wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
