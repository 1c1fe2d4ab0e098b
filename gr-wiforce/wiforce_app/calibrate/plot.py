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
    """Plot a calibration's phases, the model's curves, and the residuals of the fit.

    Each carrier and port has a row of three panels: phase against force at each calibrated
    location, phase against location at some forces, and measurement minus model. Phases are
    not wrapped: measurements and the untouched phase, which is dashed, are shown at the turn that
    is closest to the curves.
    """
    from matplotlib.figure import Figure

    rows = [(index, port) for index in range(len(model.carriers)) for port in (1, 2)]
    canvas = Figure(figsize=(13, 0.6 + 3.0 * len(rows)), layout="constrained")
    panels = canvas.subplots(len(rows), 3, squeeze=False)
    canvas.suptitle(f"{model.name}: points measured, lines model, dashed untouched")
    for (index, port), axes in zip(rows, panels, strict=True):
        frequency_hz = model.carriers[index].frequency_hz
        own = table.take((table.port == port) & same_carrier(table.frequency_hz, frequency_hz))
        axes[0].set_title(f"{frequency_hz / 1e6:g} MHz, port {port}", fontsize=10)
        _plot_port(_Port(own, model, index, port), axes)
    save_picture(canvas, path)


class _Port:
    """What was measured at one carrier and port, and the model of it."""

    def __init__(self, own, model, index, port):
        self._model, self._index, self._port = model, index, port
        self.pressed = own.take(own.force_n > 0)
        self.force_span_n = model.force_span_n
        self.locations = model.carriers[index].location_mm
        self.length_mm = model.length_mm

    def curve(self, force_n, location_mm):
        """The model's phases, not wrapped."""
        both = np.broadcast_arrays(np.asarray(force_n, float), np.asarray(location_mm, float))
        return self._model.short_deg(*both, self._index)[..., self._port - 1]

    def residuals(self, rows):
        """Measured minus modelled phases of some rows."""
        return wrap_deg(rows.phase_deg - self.curve(rows.force_n, rows.location_mm))

    def untouched_near(self, phase_deg):
        """The untouched phase of the model at the turn that is closest to another phase."""
        untouched = self._model.untouched_deg(self._model.frequencies_hz[self._index])
        return phase_deg + wrap_deg(untouched[self._port - 1] - phase_deg)


def _plot_port(port, axes):
    forces = np.linspace(*port.force_span_n, _POINTS)
    for number, location in enumerate(port.locations):
        style = series_style(number)
        here = port.pressed.take(port.pressed.location_mm == location)
        residuals = port.residuals(here)
        axes[0].plot(forces, port.curve(forces, location), color=style["color"])
        measured = port.curve(here.force_n, location) + residuals
        axes[0].plot(here.force_n, measured, ls="", ms=2.5, **style)
        axes[2].plot(here.force_n, residuals, ls="", ms=3, label=f"{location:g} mm", **style)
    _plot_over_location(port, axes[1])
    for axis in axes[:2]:
        middle = np.mean(axis.get_ylim())
        axis.axhline(port.untouched_near(middle), color=FAINT, ls="--", lw=1, label="untouched")
    axes[2].axhline(0.0, color=FAINT, lw=0.8)
    labels = ("phase (deg)", "phase (deg)", "measured - model (deg)")
    for axis, across, up in zip(
        axes, ("force (N)", "location (mm)", "force (N)"), labels, strict=True
    ):
        axis.set_xlabel(across)
        axis.set_ylabel(up)
        axis.grid(alpha=0.3)
    axes[1].set_xlim(0, port.length_mm)
    legend_beside(axes[1], "these lines")
    legend_beside(axes[2], "left and right")


def _plot_over_location(port, axis):
    """Curves at the least and greatest force measured and at some between.

    The points are the measurements at the next force, shifted along their curve.
    """
    every = np.unique(port.pressed.force_n)
    shown = every[np.unique(np.linspace(0, len(every) - 1, _FORCES_SHOWN).round().astype(int))]
    locations = np.linspace(min(port.locations), max(port.locations), _POINTS)
    for number, force_n in enumerate(shown):
        style, label = series_style(number), f"{force_n:g} N"
        axis.plot(locations, port.curve(force_n, locations), color=style["color"], label=label)
        for location in port.locations:
            here = port.pressed.take(port.pressed.location_mm == location)
            away = np.abs(here.force_n - force_n)
            here = here.take(away == away.min())
            measured = port.curve(force_n, here.location_mm) + port.residuals(here)
            axis.plot(here.location_mm, measured, ls="", ms=3, **style)
