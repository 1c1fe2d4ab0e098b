# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of evaluated scenes: readings and truth, errors, spectrum, distance."""

from pathlib import Path

import numpy as np
from gnuradio.wiforce.io.palette import INK, TRUTH, series_style
from gnuradio.wiforce.receiver.plotting import legend_beside
from gnuradio.wiforce.scene import load_scene

from ..shell.plots import save_picture
from .causes import published_phase_std

_STYLES = {"ours": "-", "paper": ":", "paper, clock offset removed": "--"}

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
    """Plot force and location with the truth, error distributions and the Doppler spectrum."""
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(14, 7.5), layout="constrained")
    above, below = canvas.subfigures(2, 1, height_ratios=(2, 1))
    axes = above.subplots(2, 2, width_ratios=(2, 1))
    canvas.suptitle(Path(result["scene"]).stem)
    for i, sensor in enumerate(result["sensors"]):
        truth = np.array(sensor["truth"], float)
        readings = np.array([row[:4] for row in sensor["readings"]], float)
        flagged = np.array([row[4] for row in sensor["readings"]])
        style = series_style(i)
        for row, (column, key, label) in enumerate(
            ((2, "force_n", "force (N)"), (3, "location_mm", "location (mm)"))
        ):
            over_time, distribution = axes[row]
            known = np.where(truth[:, 1] == 1, truth[:, column], np.nan)
            over_time.plot(truth[:, 0], known, color=TRUTH, lw=3, zorder=0)
            name = sensor["sensor"]
            clear = readings[~flagged]
            over_time.plot(clear[:, 0], clear[:, column], ls="", ms=2.5, label=name, **style)
            over_time.plot(
                readings[flagged, 0], readings[flagged, column], "x", ms=5, color=style["color"]
            )
            over_time.set_ylabel(label)
            _distributions(distribution, sensor, f"{key}_errors", style["color"])
            distribution.set_xlabel(f"error of {label}")
    axes[1, 0].set_ylim(0, _length_mm(result["scene"]))
    axes[1, 0].set_xlabel("time (s); grey: truth, crosses: flagged")
    for axis in axes[0]:
        legend_beside(axis)
    spectrum = below.subplots()
    spectrum.plot(result["spectrum"]["hz"], result["spectrum"]["db"], lw=0.6, color=INK)
    spectrum.set_xlabel("Doppler frequency of the snapshots (Hz)")
    spectrum.set_ylabel("power (dB)")
    for axis in (*axes.flat, spectrum):
        axis.grid(alpha=0.3)
    save_picture(canvas, path, dpi=100)


def _length_mm(path):
    """Length of the sensors of a scene."""
    scene = load_scene(path)
    return max(sensor.load_model(scene).length_mm for sensor in scene.sensors)


def _distributions(axis, sensor, key, color):
    for method, style in _STYLES.items():
        errors = np.sort(sensor["methods"][method].get(key, []))
        if len(errors):
            part = np.arange(1, len(errors) + 1) / len(errors)
            name = f"{sensor['sensor']}, {method}"
            axis.semilogx(np.maximum(errors, 1e-4), part, style, color=color, label=name)
    axis.set_ylim(0, 1)
