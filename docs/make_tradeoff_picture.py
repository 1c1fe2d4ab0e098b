#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws docs/images/tradeoff.png from docs/data/tradeoff.csv: run time against error.

build/run python3 docs/make_tradeoff_picture.py
"""

import csv
from pathlib import Path

import numpy as np
from gnuradio.wiforce.io.palette import FAINT, SERIES, series_style
from matplotlib.figure import Figure

ROOT = Path(__file__).resolve().parent
PICTURE, TABLE = ROOT / "images" / "tradeoff.png", ROOT / "data" / "tradeoff.csv"
# Those of the table in results.md that differ from the plan, as many as there are colours.
SETTINGS = {
    "N_g 125": "groups of 125 snapshots",
    "N_g 1250": "groups of 1250 snapshots",
    "every second subcarrier": "every second subcarrier",
    "every fourth subcarrier": "every fourth subcarrier",
    "channel first": "channel before tones",
    "stock blocks": "stock blocks",
}
QUARTILES = (25, 50, 75)


def ratios():
    """By setting: quartiles over the scenes of time and error over those of the plan; (2, 3)."""
    rows = list(csv.DictReader(TABLE.open(encoding="utf-8")))
    plans = {row["scene"]: row for row in rows if row["setting"] == "plan"}
    found = {}
    for setting in SETTINGS:
        own = [
            [
                float(row[key]) / float(plans[row["scene"]][key])
                for key in ("ms per s", "phase (deg)")
            ]
            for row in rows
            if row["setting"] == setting
            and row["phase (deg)"]
            and plans[row["scene"]]["phase (deg)"]
        ]
        found[setting] = np.percentile(own, QUARTILES, axis=0).T
    return found


def main():
    canvas = Figure(figsize=(9, 5), layout="constrained")
    axis = canvas.subplots()
    for number, (setting, quartiles) in enumerate(ratios().items()):
        (low_x, x, high_x), (low_y, y, high_y) = quartiles
        axis.errorbar(
            x,
            y,
            xerr=[[x - low_x], [high_x - x]],
            yerr=[[y - low_y], [high_y - y]],
            ls="",
            ms=8,
            lw=1,
            label=SETTINGS[setting],
            **series_style(number),
        )
    axis.plot(1, 1, "*", ms=16, color=SERIES[-1], label="the plan", zorder=3)
    for line in (axis.axhline, axis.axvline):
        line(1, color=FAINT, lw=0.8, ls="--", zorder=0)
    axis.set_xscale("log")
    axis.set_yscale("log")
    for side, ticks in (
        (axis.xaxis, (0.8, 1, 1.5, 2, 3, 4, 6, 12)),
        (axis.yaxis, (0.7, 0.8, 1, 1.2, 1.5, 2, 2.5)),
    ):
        side.set_ticks(ticks)
        side.set_ticks([], minor=True)
        side.set_major_formatter("{x:g}")
    axis.set_xlabel("processor time, relative to the plan")
    axis.set_ylabel("phase error, relative to the plan")
    axis.set_title("one setting changed: medians and quartiles over 17 scenes", fontsize=11)
    axis.grid(alpha=0.3)
    axis.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=9)
    canvas.savefig(PICTURE, dpi=100)


if __name__ == "__main__":
    main()
