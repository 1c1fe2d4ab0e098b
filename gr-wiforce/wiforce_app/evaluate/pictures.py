# SPDX-License-Identifier: GPL-3.0-or-later
"""Picture of readings beside a force gauge."""

import numpy as np
from gnuradio.wiforce.io.palette import TRUTH, series_style
from gnuradio.wiforce.receiver.plotting import legend_beside

from ..shell.plots import save_picture

_BINS = 40


def plot_comparison(readings, gauge, found, path, title):
    """Draw both forces over time, the errors over time and over the force."""
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(11, 8), layout="constrained")
    canvas.suptitle(title, fontsize=11)
    over_time, errors, of_force = canvas.subplots(3, 1, height_ratios=(3, 2, 2))
    errors.sharex(over_time)
    gauge_n = found.sign * (gauge.force_n - found.zero_n)
    over_time.plot(gauge.time_s - found.offset_s, gauge_n, color=TRUTH, lw=3, label="gauge")
    clear, touched = readings.clear, readings.touched
    reading, median = ({"ms": ms, **series_style(i)} for i, ms in enumerate((2.5, 4)))
    times_s, forces_n = readings.time_s[clear], readings.force_n[clear]
    over_time.plot(times_s, forces_n, ls="", label="reading", **reading)
    flagged = touched & ~clear
    over_time.plot(
        readings.time_s[flagged],
        readings.force_n[flagged],
        "x",
        ms=5,
        color=reading["color"],
        label="flagged, not compared",
    )
    span = readings.time_s[[0, -1]]
    over_time.set_xlim(*span)
    top = 1.15 * max(found.force_n.max(), found.gauge_n.max())
    over_time.set_ylim(-0.1 * top, top)
    over_time.set_ylabel("force (N)")
    legend_beside(over_time)
    errors.errorbar(found.time_s, found.error_n, 2 * found.force_std_n, ls="", lw=0.7, **reading)
    errors.axhline(0, color=TRUTH, lw=1)
    errors.set_ylabel("reading - gauge (N)\nbars: 2 std")
    errors.set_xlabel("time (s)")
    of_force.plot(found.gauge_n, found.error_n, ls="", label="error", **reading)
    of_force.plot(
        *_medians(found.gauge_n, found.error_n), label="median over\nan interval of force", **median
    )
    of_force.axhline(0, color=TRUTH, lw=1)
    of_force.set_xlabel("force of the gauge (N)")
    of_force.set_ylabel("reading - gauge (N)")
    legend_beside(of_force)
    for axis in (over_time, errors, of_force):
        axis.grid(alpha=0.3)
    save_picture(canvas, path)


def _medians(force_n, error_n):
    """Medians of the errors over intervals of the force with at least five of them."""
    edges = np.linspace(force_n.min(), force_n.max(), max(2, min(_BINS, len(force_n) // 20)) + 1)
    place = np.clip(np.digitize(force_n, edges) - 1, 0, len(edges) - 2)
    kept = [each for each in range(len(edges) - 1) if np.sum(place == each) >= 5]
    centres = [(edges[each] + edges[each + 1]) / 2 for each in kept]
    return centres, [np.median(error_n[place == each]) for each in kept]
