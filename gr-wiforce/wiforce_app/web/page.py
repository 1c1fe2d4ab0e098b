# SPDX-License-Identifier: GPL-3.0-or-later
"""The plots of the page: force and location of all sensors, and a strip of doubtful readings.

Python describes them, and ``assets/plots.js`` fills their sources by name: `lines`, `bands` and
`points` with readings that have no flag, the strip with a mark for each one that has.
"""

import math
from functools import cache
from pathlib import Path
from typing import Any

from bokeh.embed import json_item
from bokeh.layouts import column
from bokeh.models import ColumnDataSource, Range1d
from bokeh.plotting import figure
from bokeh.resources import Resources
from gnuradio.wiforce.io.palette import FAINT, GRID, INK

_HEIGHT_PX = 210
# The same on both plots, so that their time axes are aligned.
_LEFT_PX, _RIGHT_PX = 52, 10
_UPRIGHT = math.pi / 2
_SOURCES = {
    "lines": ("xs", "ys", "color", "dash"),
    "bands": ("xs", "ys", "color"),
    "points": ("x", "y", "color"),
}
_STRIP_PX = 30
# Nothing takes touches, so that a phone can scroll over the plots.
_PLAIN = {
    "sizing_mode": "stretch_width",
    "tools": "",
    "toolbar_location": None,
    "outline_line_color": GRID,
    "min_border_left": _LEFT_PX,
    "min_border_right": _RIGHT_PX,
    "lod_threshold": None,
}


def bokeh_scripts() -> list[Path]:
    """The files of Bokeh that the page needs, as they are installed with it."""
    return [Path(path) for path in Resources(mode="absolute", components=["bokeh"]).js_files]


@cache
def figures() -> dict[str, Any]:
    """The plots, in the form that Bokeh's ``embed_item`` takes."""
    time_axis = Range1d(0, 30, name="time")
    force = _plot("force", "force (N)", time_axis)
    location = _plot("location", "location (mm)", time_axis)
    force.xaxis.major_label_text_font_size = "0px"
    location.xaxis.axis_label = "time (s)"
    plots = (_strip(time_axis), force, location)
    return json_item(column(*plots, sizing_mode="stretch_width", spacing=0))


def _strip(time_axis: Range1d) -> figure:
    """Times of readings with a flag, a row for each sensor: their values are not to be used."""
    ranges = {"x_range": time_axis, "y_range": Range1d(-1, 1, name="strip-range")}
    borders = {"min_border_top": 4, "min_border_bottom": 2}
    plot = figure(name="strip-plot", height=_STRIP_PX, **ranges, **borders, **_PLAIN)
    data = ColumnDataSource({key: [] for key in ("x", "y", "color")}, name="strip-marks")
    plot.scatter("x", "y", source=data, marker="dash", angle=_UPRIGHT, size=8, line_color="color")
    plot.axis.visible = False
    plot.grid.grid_line_color = None
    return plot


def _plot(name: str, label: str, time_axis: Range1d) -> figure:
    """One quantity over time."""
    ranges = {"x_range": time_axis, "y_range": Range1d(0, 1, name=f"{name}-range")}
    shape = {"height": _HEIGHT_PX, "min_border_top": 8}
    plot = figure(name=f"{name}-plot", y_axis_label=label, **ranges, **shape, **_PLAIN)
    data = {
        kind: ColumnDataSource({key: [] for key in keys}, name=f"{name}-{kind}")
        for kind, keys in _SOURCES.items()
    }
    color = {"line_color": "color"}
    plot.patches(
        "xs", "ys", source=data["bands"], fill_color="color", fill_alpha=0.2, line_color=None
    )
    plot.multi_line("xs", "ys", source=data["lines"], line_width=2, line_dash="dash", **color)
    plot.scatter("x", "y", source=data["points"], size=4, fill_color="color", line_color=None)
    plot.grid.grid_line_color = GRID
    plot.xgrid.grid_line_color = None
    for axis in (*plot.xaxis, *plot.yaxis):
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_color = axis.major_label_text_color = INK
        axis.axis_line_color = axis.major_tick_line_color = FAINT
        axis.minor_tick_line_color = None
    return plot
