#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws docs/images/turn.png: a tag that turns during a press, as three readers see it.

build/run python3 docs/make_turn_picture.py
"""

import tempfile
from pathlib import Path

import pandas
from gnuradio import wiforce
from gnuradio.wiforce.io.palette import INK, PAPER, SERIES, TRUTH
from matplotlib.figure import Figure

PICTURE = Path(__file__).resolve().parent / "images" / "turn.png"
# The tag moves away from the antennas, so that both ends turn alike.
TURN_S, DISTANCE_MM, END_S = 2.0, 3.0, 4.4
PRESS = {"start_s": 1.0, "hold_s": 2.2, "force_n": 2.5, "location_mm": 40.0}
# What each reader knows of the sensor.
READERS = {
    "turns are rare (nothing stated)": {},
    "turns_per_s: 1": {"turns_per_s": 1.0},
    "off states +0.3 and -0.3, known to 0.0005": {
        "off_reflection": [[0.3, 0], [-0.3, 0]],
        "off_reflection_std": 0.0005,
    },
}


def main():
    canvas = Figure(figsize=(9, 8.5), layout="constrained")
    phases, *forces = canvas.subplots(1 + len(READERS), 1, sharex=True)
    with tempfile.TemporaryDirectory() as folder:
        for number, (axis, (title, stated)) in enumerate(zip(forces, READERS.items(), strict=True)):
            readings, truth = read(Path(folder) / "turn", stated)
            draw_force(axis, readings, truth)
            axis.set_title(title, fontsize=10)
            if number == 0:
                draw_phases(phases, readings)
    for axis, (low, high) in zip((phases, *forces), ((88, 112), *[(0, 5)] * 3), strict=True):
        axis.set_ylim(low, high)
        axis.axvline(TURN_S, color=INK, lw=1, ls=":")
        axis.grid(alpha=0.3)
    for axis in (phases, forces[0]):
        axis.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize=9, frameon=False)
    place = phases.get_xaxis_transform()
    phases.annotate("the tag turns", (TURN_S, 1), (3, -12), place, "offset points", fontsize=9)
    forces[-1].set_xlabel("time (s)")
    canvas.savefig(PICTURE, dpi=100)


def read(path, stated):
    """Readings of the press by a reader, and what was applied."""
    scene = {
        "sensors": [{"name": "arm", "model": "line-900mhz-calibrated", **stated}],
        "simulation": {
            "truth_model": "line-900mhz",
            "duration_s": END_S,
            "seed": 17,
            "snr_db": 15,
            "moves": [{"start_s": TURN_S, "duration_s": 0.05, "distance_mm": DISTANCE_MM}],
            "presses": [PRESS],
        },
    }
    wiforce.simulate(scene, path, overwrite=True)
    return wiforce.read(path), pandas.read_csv(path.with_suffix(".truth.csv"))


def draw_phases(axis, readings):
    """Phases while pressed, which are far from those of the untouched line."""
    for end, size, fill in ((1, 7, PAPER), (2, 3, SERIES[1])):
        style = {"color": SERIES[end - 1], "marker": "os"[end - 1], "ls": "", "ms": size}
        phases = readings[f"phase{end}_deg"]
        axis.plot(readings.time_s, phases, mfc=fill, label=f"end {end}", **style)
    axis.set_title("phases while pressed", fontsize=10)
    axis.set_ylabel("phase (deg)")


def draw_force(axis, readings, truth):
    """Forces with two standard deviations; flagged ones are hollow."""
    axis.plot(truth.time_s, truth.force_n, color=TRUTH, lw=4, label="applied")
    moved = readings["flags"].str.contains("moved")
    for which, style, name in (
        (readings["ok"], {}, "read (bars: 2 std)"),
        (~readings["ok"] & ~moved, {"mfc": PAPER}, "flagged"),
        (moved, {"mfc": PAPER, "marker": "D"}, "flagged moved"),
    ):
        rows = readings[which & readings["force_n"].notna()]
        style = {"color": SERIES[0], "marker": "o", "ls": "", "ms": 4, "lw": 1, **style}
        bars = None if "mfc" in style else 2 * rows.force_std_n
        axis.errorbar(rows.time_s, rows.force_n, bars, label=name, **style)
    axis.set_ylabel("force (N)")


if __name__ == "__main__":
    main()
