# SPDX-License-Identifier: GPL-3.0-or-later
"""A map of the errors that a plan expects, over force and location."""

import numpy as np
from gnuradio.wiforce.io.palette import INK, shades
from gnuradio.wiforce.planning.expected import error_map

from ..shell.plots import save_picture

_STEPS = 61
# Levels divide a decade in three, so that each shade is about twice the one before.
_MANTISSAS = (1.0, 2.0, 5.0)
_PANEL_IN = 2.6


def plot_errors(settings, path):
    """Draw the standard deviations of force and location of every sensor, side by side."""
    from matplotlib.figure import Figure

    count = len(settings.sensors)
    canvas = Figure(figsize=(10, 0.7 + _PANEL_IN * count), layout="constrained")
    rows = canvas.subplots(count, 2, squeeze=False, sharex="row", sharey="row")
    canvas.suptitle("expected standard deviations of a steady reading", fontsize=11)
    for index, (axes, sensor) in enumerate(zip(rows, settings.sensors, strict=True)):
        force, location = (
            np.linspace(*span, _STEPS)
            for span in (sensor.model.force_span_n, sensor.model.location_span_mm)
        )
        spread = error_map(settings, index, force, location)
        for axis, values, name in zip(
            axes, np.moveaxis(spread, -1, 0), ("force (N)", "location (mm)"), strict=True
        ):
            levels = _levels(values)
            drawn = axis.contourf(location, force, values, levels, colors=shades(len(levels) - 1))
            axis.contour(location, force, values, levels, colors=INK, linewidths=0.6)
            canvas.colorbar(drawn, ax=axis, format="%g", aspect=12)
            axis.set_title(f"{sensor.name}: std of {name}", fontsize=10)
        axes[0].set_ylabel("force (N)")
    for axis in rows[-1]:
        axis.set_xlabel("location (mm from port 1)")
    save_picture(canvas, path)


def _levels(values):
    """Levels 1, 2, 5 of each decade around the values, two or more."""
    low, high = np.log10([values.min(), values.max()])
    decades = np.arange(np.floor(low), np.ceil(high) + 1)
    levels = np.outer(10.0**decades, _MANTISSAS).ravel()
    first = max(0, np.searchsorted(levels, values.min(), "right") - 1)
    last = min(len(levels) - 1, np.searchsorted(levels, values.max()))
    return levels[first : max(last, first + 1) + 1]
