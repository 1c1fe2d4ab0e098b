# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of evaluated scenes, and of a force gauge."""

from pathlib import Path

import numpy as np
from gnuradio.wiforce.io.palette import INK, TRUTH, series_style
from gnuradio.wiforce.io.readings import as_reading
from gnuradio.wiforce.receiver.plotting import legend_beside
from gnuradio.wiforce.scene import load_scene

from ..shell.plots import plot_readings, save_picture
from .causes import published_phase_std

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


_OF_CAUSES = {"ours": "ours, by cause", "paper": "paper, clock offset removed, by cause"}


def plot_distances(results, folder, figures):
    """Write ``distance.png``, phase rms over distance; False when too few scenes state one."""
    from matplotlib.figure import Figure

    at = [figures.get(Path(result["scene"]).stem, {}).get("distance_m") for result in results]
    own = sorted(
        ((d, r) for d, r in zip(at, results, strict=True) if d is not None),
        key=lambda item: item[0],
    )
    if len(own) < 2:
        return False
    distance = [100 * d for d, _ in own]
    published = published_phase_std()
    canvas = Figure(figsize=(9, 4), layout="constrained")
    axis = canvas.subplots()
    axis.errorbar(
        published["distance_from_rx_cm"],
        published["phase_std_deg"],
        [published["err_minus_deg"], published["err_plus_deg"]],
        ls="-",
        ms=4,
        **series_style(2),
        label="published",
    )
    for at_cm, (_, result) in zip(distance, own, strict=True):
        for number, method in enumerate(("ours", "paper")):
            rms = [found[method]["phase_rms_deg"] for found in result["causes"].values()]
            label = _OF_CAUSES[method] if at_cm == distance[0] else None
            axis.plot([at_cm] * len(rms), rms, ms=4, label=label, **series_style(number))
    bound = [result["sensors"][0]["bound_rms_deg"] for _, result in own]
    axis.plot(distance, bound, ":", color=INK, label="bound")
    axis.set_yscale("log")
    axis.set_xlabel("distance from the receiver (cm), antennas 4 m apart")
    axis.set_ylabel("phase rms (deg)")
    axis.grid(alpha=0.3)
    legend_beside(axis)
    save_picture(canvas, folder / "distance.png", dpi=100)
    return True


def plot_scene(result, path):
    """Plot the readings of all sensors over time, with the truth."""
    readings = [as_reading(row) for sensor in result["sensors"] for row in sensor["readings"]]
    truth = [row for sensor in result["sensors"] for row in sensor["truth"]]
    scene = load_scene(result["scene"])
    length_mm = max(sensor.load_model(scene).length_mm for sensor in scene.sensors)
    plot_readings(readings, path, Path(result["scene"]).stem, truth, length_mm)
