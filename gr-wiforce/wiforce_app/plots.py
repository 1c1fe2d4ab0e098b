# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of readings."""

import os
from pathlib import Path

import numpy as np
from gnuradio.wiforce.errors import InputError

_SUFFIXES = (".png", ".pdf", ".svg")


def check_picture(path):
    """Refuses a picture's path before any work is done for it.

    Raises
    ------
    InputError
        For an unknown suffix, a folder that is not there or a file that cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in _SUFFIXES:
        raise InputError(path, f"picture must end in {', '.join(_SUFFIXES)}")
    if not path.parent.is_dir():
        raise InputError(path, "folder does not exist")
    if not os.access(path if path.exists() else path.parent, os.W_OK) or path.is_dir():
        raise InputError(path, "cannot be written")


def figure(rows, title, height_in=2.1):
    """Figure of stacked panels over time, drawn without a display."""
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(9, 1.0 + height_in * rows), layout="constrained")
    axes = canvas.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    canvas.suptitle(title, fontsize=11)
    for axis in axes:
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("time (s)")
    return canvas, axes


def plot_readings(readings, path, title="", truth=None):
    """Force, location, phases and SNR over time, one colour per sensor.

    Parameters
    ----------
    readings : sequence of Reading
    path : str or Path
        PNG, PDF or SVG.
    title : str
    truth : sequence of dict, optional
        Rows of a truth file, drawn as grey lines behind the readings.
    """
    canvas, axes = figure(4, title)
    names = list(dict.fromkeys(reading.sensor for reading in readings))
    for i, name in enumerate(names):
        own = [reading for reading in readings if reading.sensor == name]
        _plot_sensor(axes, own, f"C{2 * i}", name if len(names) > 1 else "reading")
        if truth is not None:
            _plot_truth(axes, [row for row in truth if row["sensor"] == name], i == 0)
    labels = ("force (N)", "location\n(mm from port 1)", "phases psi 1, 2\n(deg)", "SNR (dB)")
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
    axes[0].set_ylim(bottom=0)
    axes[2].set_ylim(-185, 185)
    axes[2].set_yticks([-180, -90, 0, 90, 180])
    axes[0].legend(loc="upper right", fontsize=8)
    canvas.savefig(path, dpi=110)


def _column(readings, name):
    values = [getattr(reading, name) for reading in readings]
    return np.array([np.nan if v is None else v for v in values], float)


def _plot_sensor(axes, readings, color, label):
    time = _column(readings, "time_s")
    for axis, value, std in (
        (axes[0], "force_n", "force_std_n"),
        (axes[1], "location_mm", "location_std_mm"),
    ):
        axis.errorbar(
            time,
            _column(readings, value),
            2 * _column(readings, std),
            fmt=".",
            ms=4,
            lw=0.7,
            color=color,
            label=f"{label} (bars: 2 std)",
        )
        flagged = np.array([bool(set(r.flags) - {"reference"}) for r in readings])
        marked = _column(readings, value)[flagged]
        axis.plot(time[flagged], marked, "x", ms=6, color="C3", label="flagged")
    axes[2].plot(time, _column(readings, "phase1_deg"), ".", ms=3, color=color, label="psi 1")
    axes[2].plot(time, _column(readings, "phase2_deg"), "+", ms=4, color=color, label="psi 2")
    axes[2].legend(loc="upper right", fontsize=8)
    axes[3].plot(time, _column(readings, "snr_db"), ".", ms=3, color=color)


def _plot_truth(axes, rows, labelled):
    time = np.array([row["time_s"] for row in rows])
    touched = np.array([row["touch"] == 1 for row in rows])
    for axis, name in ((axes[0], "force_n"), (axes[1], "location_mm")):
        values = [np.nan if row[name] is None else row[name] for row in rows]
        values = np.where(touched, np.array(values, float), np.nan)
        axis.plot(time, values, color="0.6", lw=2.5, zorder=0, label="truth" if labelled else None)


def plot_calibration(table, model, path):
    """A calibration's phases and the model's curves against force, one panel per carrier and port.

    Parameters
    ----------
    table : CalibrationTable
    model : CurveModel
    path : str or Path
    """
    from matplotlib.figure import Figure

    count = len(model.carriers)
    canvas = Figure(figsize=(10, 1 + 3.6 * count), layout="constrained")
    panels = canvas.subplots(count, 2, squeeze=False)
    canvas.suptitle(f"{model.name}: phase against force, points measured, lines model")
    for carrier, row in zip(model.carriers, panels, strict=True):
        for port, axis in enumerate(row, 1):
            _plot_port(table, model, carrier, port, axis)
    canvas.savefig(path, dpi=110)


def _plot_port(table, model, carrier, port, axis):
    forces = np.linspace(*model.force_span_n, 80)
    own = (table.port == port) & (abs(table.frequency_hz / carrier.frequency_hz - 1) < 1e-3)
    for i, location in enumerate(carrier.location_mm):
        curve = model.phases_deg(forces, location, carrier.frequency_hz)[:, port - 1]
        curve = np.degrees(np.unwrap(np.radians(curve)))
        axis.plot(forces, curve, color=f"C{i}", label=f"{location:g} mm")
        here = own & (table.location_mm == location) & (table.force_n > 0)
        measured = table.phase_deg[here]
        near = np.interp(table.force_n[here], forces, curve)
        turns = np.round((near - measured) / 360)
        axis.plot(table.force_n[here], measured + 360 * turns, ".", ms=3, color=f"C{i}")
    axis.set_title(f"{carrier.frequency_hz / 1e6:g} MHz, port {port}", fontsize=10)
    axis.set_xlabel("force (N)")
    axis.set_ylabel("phase (deg)")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=7, loc="center left", bbox_to_anchor=(1, 0.5))


def plot_error_distributions(scores, forms, path):
    """Cumulative distributions of force and location error on the published trials.

    Parameters
    ----------
    scores : sequence of sensor.published.Score
    forms : dict
        The chosen form of the curves by carrier.
    path : path
    """
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(10, 3.4 * len(forms)), layout="constrained")
    axes = canvas.subplots(len(forms), 2, squeeze=False)
    methods = list(dict.fromkeys(score.method for score in scores))
    for row, (frequency, form) in zip(axes, forms.items(), strict=True):
        own = [s for s in scores if s.press.frequency_hz == frequency and s.form == form]
        _plot_distribution(row[0], own, methods, "force_error", "force error (N)")
        _plot_distribution(row[1], own, methods, "location_error", "location error (mm)")
        row[0].set_ylabel(f"{frequency / 1e6:g} MHz, {form}\npart of the readings")
    axes[0, 0].legend(fontsize=7, loc="lower right")
    canvas.suptitle("Published wireless trials (dashed: with one wireless press per location)")
    canvas.savefig(path, dpi=110)


def _plot_distribution(axis, scores, methods, what, label):
    for i, method in enumerate(methods):
        for refined in (False, True):
            own = [s for s in scores if s.method == method and s.refined == refined]
            errors = np.sort(np.concatenate([getattr(score, what) for score in own]))
            if not np.any(errors):
                continue  # the location was known
            part = np.arange(1, errors.size + 1) / errors.size
            axis.step(
                errors,
                part,
                f"C{i}{'--' if refined else '-'}",
                where="post",
                linewidth=1.2,
                label=None if refined else method,
            )
    axis.set_xlim(0, 3)
    axis.set_ylim(0, 1)
    axis.set_xlabel(label)
    axis.grid(alpha=0.3)
