# SPDX-License-Identifier: GPL-3.0-or-later
"""Picture of a calibration: what was measured, the model's curves, and what lies between them."""

import numpy as np
from gnuradio.wiforce.io.palette import FAINT, series_style
from gnuradio.wiforce.receiver.plotting import legend_beside
from gnuradio.wiforce.signal.carrier import same_carrier, wrap_deg

from ..shell.plots import save_picture

_POINTS = 80
# Forces whose phases are drawn against location.
_FORCES_SHOWN = 4


def plot_calibration(table, model, path):
    """Plot phases, at the turn closest to the curves, by force and location, and residuals."""
    from matplotlib.figure import Figure

    rows = [(index, port) for index in range(len(model.carriers)) for port in (1, 2)]
    canvas = Figure(figsize=(13, 0.6 + 3.0 * len(rows)), layout="constrained")
    panels = canvas.subplots(len(rows), 3, squeeze=False)
    canvas.suptitle(f"{model.name}: points measured, lines model, dashed untouched")
    for (index, port), axes in zip(rows, panels, strict=True):
        frequency_hz = model.carriers[index].frequency_hz
        own = (table.port == port) & same_carrier(table.frequency_hz, frequency_hz)
        axes[0].set_title(f"{frequency_hz / 1e6:g} MHz, port {port}", fontsize=10)
        _plot_port(table.take(own & (table.force_n > 0)), model, index, port, axes)
    save_picture(canvas, path)


def _plot_port(pressed, model, index, port, axes):
    """The three panels of the rows of one carrier and port."""
    locations = model.carriers[index].location_mm

    def curve(force_n, location_mm):
        """The model's phases, not wrapped."""
        both = np.broadcast_arrays(np.asarray(force_n, float), np.asarray(location_mm, float))
        return model.short_deg(*both, index)[..., port - 1]

    residuals = wrap_deg(pressed.phase_deg - curve(pressed.force_n, pressed.location_mm))
    forces = np.linspace(*model.force_span_n, _POINTS)
    for number, location in enumerate(locations):
        style = series_style(number)
        at = pressed.location_mm == location
        force_n, beside = pressed.force_n[at], residuals[at]
        axes[0].plot(forces, curve(forces, location), color=style["color"])
        axes[0].plot(force_n, curve(force_n, location) + beside, ls="", ms=2.5, **style)
        axes[2].plot(force_n, beside, ls="", ms=3, label=f"{location:g} mm", **style)
    # Over location, at the least and greatest force measured and at some between. The points are
    # the measurements at the next force, shifted along their curve.
    every = np.unique(pressed.force_n)
    shown = every[np.unique(np.linspace(0, len(every) - 1, _FORCES_SHOWN).round().astype(int))]
    places = np.linspace(min(locations), max(locations), _POINTS)
    for number, force_n in enumerate(shown):
        style, label = series_style(number), f"{force_n:g} N"
        axes[1].plot(places, curve(force_n, places), color=style["color"], label=label)
        for location in locations:
            away = np.where(
                pressed.location_mm == location, np.abs(pressed.force_n - force_n), np.inf
            )
            near = away == away.min()
            measured = curve(force_n, pressed.location_mm[near]) + residuals[near]
            axes[1].plot(pressed.location_mm[near], measured, ls="", ms=3, **style)
    untouched = model.untouched_deg(model.frequencies_hz[index])[port - 1]
    for axis in axes[:2]:
        middle = np.mean(axis.get_ylim())
        nearest = middle + wrap_deg(untouched - middle)
        axis.axhline(nearest, color=FAINT, ls="--", lw=1, label="untouched")
    axes[2].axhline(0.0, color=FAINT, lw=0.8)
    labels = ("phase (deg)", "phase (deg)", "measured - model (deg)")
    for axis, across, up in zip(
        axes, ("force (N)", "location (mm)", "force (N)"), labels, strict=True
    ):
        axis.set_xlabel(across)
        axis.set_ylabel(up)
        axis.grid(alpha=0.3)
    axes[1].set_xlim(0, model.length_mm)
    legend_beside(axes[1], "these lines")
    legend_beside(axes[2], "left and right")
