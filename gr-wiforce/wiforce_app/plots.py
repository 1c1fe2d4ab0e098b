# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of readings."""

from pathlib import Path

import numpy as np
from gnuradio.wiforce.errors import InputError, unwritable
from gnuradio.wiforce.io.optional import optional_module
from gnuradio.wiforce.io.textfile import check_output, replacing

_SUFFIXES = (".png", ".pdf", ".svg")
_PANEL_IN = 2.1  # height of a panel


def check_picture(path, inputs=()):
    """Check the path of a picture before any work is done for it.

    Parameters
    ----------
    path : str or Path
    inputs : iterable of str or Path, optional
        Files that the picture is made from.

    Raises
    ------
    InputError
        For an unknown suffix, a missing folder, a file that cannot be written, or an input; when
        matplotlib is missing.
    """
    path = Path(path)
    if path.suffix.lower() not in _SUFFIXES:
        raise InputError(path, "name of a picture must end in .png, .pdf or .svg")
    optional_module("matplotlib.figure", path)
    check_output(path, inputs)


def figure(rows, title):
    """Make a figure of stacked panels over time, without a display."""
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(9, 1.0 + _PANEL_IN * rows), layout="constrained")
    axes = canvas.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    canvas.suptitle(title, fontsize=11)
    for axis in axes:
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("time (s)")
    return canvas, axes


def save_picture(canvas, path, dpi=110):
    """Write a figure; the file appears when it is complete.

    Parameters
    ----------
    canvas : matplotlib.figure.Figure
    path : str or Path
    dpi : int

    Raises
    ------
    InputError, OutputError
        When it cannot be written.
    """
    path = Path(path)
    try:
        with replacing(path) as part:
            # A pipe or a device has any name.
            canvas.savefig(part, dpi=dpi, format=path.suffix[1:].lower())
    except OSError as error:
        raise unwritable(path, error) from error


def plot_readings(readings, path, title="", truth=None):
    """Plot force, location, phases and SNR over time, one colour per sensor.

    Parameters
    ----------
    readings : sequence of Reading
    path : str or Path
        PNG, PDF or SVG.
    title : str
    truth : sequence of dict, optional
        Rows of a truth file, drawn as grey lines.
    """
    canvas, axes = figure(4, title)
    names = list(dict.fromkeys(reading.sensor for reading in readings))
    for i, name in enumerate(names):
        own = [reading for reading in readings if reading.sensor == name]
        _plot_sensor(axes, own, f"C{2 * i}", name if len(names) > 1 else "reading")
        if truth is not None:
            _plot_truth(axes, [row for row in truth if row["sensor"] == name], i == 0)
    _plot_flagged(axes, readings)
    labels = ("force (N)", "location\n(mm from port 1)", "phases psi 1, 2\n(deg)", "SNR (dB)")
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
    axes[2].set_ylim(-185, 185)
    axes[2].set_yticks([-180, -90, 0, 90, 180])
    for axis in (axes[0], axes[2]):
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc="upper right", fontsize=8)
    save_picture(canvas, path)


def _flagged(reading):
    return bool(set(reading.flags) - {"reference"})


def _column(readings, name):
    values = [getattr(reading, name) for reading in readings]
    return np.array([np.nan if v is None else v for v in values], float)


def _force(readings):
    """Forces, 0 N while untouched."""
    untouched = np.array([reading.touch == 0 for reading in readings], bool)
    return np.where(untouched, 0.0, _column(readings, "force_n"))


def _plot_sensor(axes, readings, color, label):
    """The values of readings without a warning, and the phases and SNR of all of them."""
    time = _column(readings, "time_s")
    reliable = [reading for reading in readings if not _flagged(reading)]
    for axis, values, std in (
        (axes[0], _force(reliable), "force_std_n"),
        (axes[1], _column(reliable, "location_mm"), "location_std_mm"),
    ):
        known = np.isfinite(values)  # of rows without values Matplotlib warns
        axis.errorbar(
            _column(reliable, "time_s")[known],
            values[known],
            2 * np.nan_to_num(_column(reliable, std)[known]),
            fmt=".",
            ms=4,
            lw=0.7,
            color=color,
            label=f"{label} (bars: 2 std)",
        )
    axes[2].plot(time, _column(readings, "phase1_deg"), ".", ms=3, color=color, label="psi 1")
    axes[2].plot(time, _column(readings, "phase2_deg"), "+", ms=4, color=color, label="psi 2")
    axes[3].plot(time, _column(readings, "snr_db"), ".", ms=3, color=color)


def _plot_truth(axes, rows, labelled):
    time = np.array([row["time_s"] for row in rows])
    touched = np.array([row["touch"] == 1 for row in rows])
    for axis, name, untouched in ((axes[0], "force_n", 0.0), (axes[1], "location_mm", np.nan)):
        values = [np.nan if row[name] is None else row[name] for row in rows]
        values = np.where(touched, np.array(values, float), untouched)
        axis.plot(time, values, color="0.6", lw=2.5, zorder=0, label="truth" if labelled else None)


def _plot_flagged(axes, readings):
    """Cross out flagged readings, at the edge where they lie outside the axis of all others."""
    flagged = [reading for reading in readings if _flagged(reading)]
    time = _column(flagged, "time_s")
    for axis, values in ((axes[0], _force(flagged)), (axes[1], _column(flagged, "location_mm"))):
        known = np.isfinite(values)
        if np.any(np.isfinite(axis.dataLim.get_points())) or not np.any(known):
            limits = axis.get_ylim()
        else:  # there is no other
            limits = np.min(values[known]) - 1, np.max(values[known]) + 1
        lowest = -0.05 * limits[1] if axis is axes[0] else limits[0]
        limits = lowest, limits[1]
        if np.any(known):  # Matplotlib gives markers outside the axis no size without any
            axis.plot(
                time[known],
                np.clip(values[known], *limits),
                "x",
                ms=6,
                color="C3",
                clip_on=False,
                label="flagged",
            )
        axis.set_ylim(limits)
