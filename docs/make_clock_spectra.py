#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws docs/images/clock_spectra.png and prints the table of docs/theory.md.

build/run python3 docs/make_clock_spectra.py
"""

from pathlib import Path

import numpy as np
from gnuradio.wiforce.estimation.clocks.tracked_tag import TagClock
from gnuradio.wiforce.io.palette import SERIES
from gnuradio.wiforce.planning.clocks import assess_clocks
from gnuradio.wiforce.planning.plan import Plan
from gnuradio.wiforce.signal.lines import aliased_hz
from gnuradio.wiforce.signal.switching import harmonics
from gnuradio.wiforce.signal.waveform import sounding_waveform
from matplotlib.figure import Figure

PICTURE = Path(__file__).resolve().parent / "images" / "clock_spectra.png"
WAVEFORM = sounding_waveform("repeated", 720, 12.5e6)
GROUP_LENGTH = 625
SETS = (
    ("one tag, clocks at fs and 2 fs, 25 % each", [1000]),
    ("two tags at 1.0 and 1.4 kHz", [1000, 1400]),
    ("two tags at 1.0 and 1.79 kHz", [1000, 1790]),
    ("two tags at 1.0 and 2.0 kHz", [1000, 2000]),
)
DRAWN = (0, 1, 3)
NAIVE_HZ = (1000, 1400)
LOWEST_DB, WEAKEST_DB = -40, -20  # of the picture, and of an end's lines
# |G_through - G_1 - G_2| of an untouched 80 mm line at 900 MHz, against |G_1|.
PASSING = 2.7


def main():
    plans = [
        Plan(WAVEFORM, (*map(TagClock, clocks),), GROUP_LENGTH, 0.0, 8, 1, 1) for _, clocks in SETS
    ]
    reports = [assess_clocks(each) for each in plans]
    print("| clocks | information q of the ends | worst loss | readable |")
    print("|---|---|---|---|")
    for (name, _), report in zip(SETS, reports, strict=True):
        q = ", ".join(f"{each:.3f}" for each in report.information)
        why = "yes" if report.readable else f"no: {report.problems[0].partition(': ')[2]}"
        print(f"| {name} | {q} | {report.worst_loss_db:.1f} dB | {why} |")
    canvas = Figure(figsize=(10, 9), layout="constrained")
    axes = canvas.subplots(len(DRAWN) + 1, 1, sharex=True, sharey=True)
    for axis, index in zip(axes, DRAWN, strict=False):
        _draw(axis, *SETS[index], reports[index])
    _draw_naive(axes[-1])
    axes[-1].set_xlabel("where snapshots show the line (Hz); half the snapshot rate at the right")
    canvas.savefig(PICTURE, dpi=100)


def _draw(axis, name, clocks_hz, report):
    """Lines of every end; hollow where another end has one there."""
    levels_db = 10 * np.log10(report.information / report.information.max())
    rate, m, shown = 1 / WAVEFORM.snapshot_period_s, np.arange(1, 65), []
    for i in range(len(levels_db)):
        clock_hz = clocks_hz[i // 2]
        level = np.abs(harmonics(m, clock_hz * WAVEFORM.averaging_s)[:, i % 2])
        level_db = 20 * np.log10(np.maximum(level / level.max(), 1e-9))
        own = level_db >= WEAKEST_DB
        shown.append((np.abs(aliased_hz(m[own] * clock_hz, rate)), level_db[own]))
    for i, (lift, (seen_hz, level_db)) in enumerate(zip(levels_db, shown, strict=True)):
        others_hz = np.concatenate([hz for k, (hz, _) in enumerate(shown) if k != i])
        for hz, db in zip(seen_hz, level_db, strict=True):
            shared = np.abs(others_hz - hz).min() < rate / GROUP_LENGTH
            if db + lift > LOWEST_DB:
                _stem(axis, hz, db + lift, SERIES[i], shared, i % 2 == 0)
        axis.plot([], [], "o", color=SERIES[i], ms=5, label=f"tag {i // 2 + 1}, end {i % 2 + 1}")
    _finish(axis, name)


def _draw_naive(axis):
    """Two square waves of 50 %: their own lines, and those of their product."""
    m = np.arange(0, 10)
    level = np.abs(np.sinc(m / 2)) / 2
    for i, clock_hz in enumerate(NAIVE_HZ):
        for harmonic in m[1:]:
            _stem_line(axis, harmonic * clock_hz, level[harmonic] / level[1], SERIES[i])
        axis.plot([], [], "o", color=SERIES[i], ms=5, label=f"switch {i + 1}")
    # What both switches on together show beyond the sum of the two ends.
    for a in m[1:]:
        for b in m[1:]:
            for sign in (-1, 1):
                frequency = abs(a * NAIVE_HZ[0] + sign * b * NAIVE_HZ[1])
                _stem_line(axis, frequency, PASSING * level[a] * level[b] / level[1], SERIES[3])
    axis.plot([], [], "o", color=SERIES[3], ms=5, label="intermodulation")
    _finish(axis, "naive: two square waves at 1.0 and 1.4 kHz, both on a quarter of the time")


def _stem_line(axis, frequency_hz, amplitude, color):
    rate = 1 / WAVEFORM.snapshot_period_s
    seen = abs((frequency_hz + rate / 2) % rate - rate / 2)
    if amplitude > 10 ** (LOWEST_DB / 20):
        _stem(axis, seen, 20 * np.log10(amplitude), color, False)


def _stem(axis, hz, level_db, color, shared, wide=False):
    """A line; where ends share it, that of end 1 is ``wide``, so that both are seen."""
    lw, ms = (3, 8) if shared and wide else (1, 5)
    axis.plot([hz, hz], [LOWEST_DB, level_db], color=color, lw=lw)
    axis.plot(hz, level_db, "o", color=color, ms=ms, mfc="white" if shared else color)


def _finish(axis, name):
    axis.set_title(name, fontsize=10)
    axis.set_ylabel("level (dB)")
    axis.set_ylim(LOWEST_DB, 4)
    axis.set_xlim(0, 0.5 / WAVEFORM.snapshot_period_s)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.02))


if __name__ == "__main__":
    main()
