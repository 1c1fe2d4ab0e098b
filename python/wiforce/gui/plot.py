# SPDX-License-Identifier: GPL-3.0-or-later
"""A plain plot over time, as the display's windows use it."""

import pyqtgraph as pg

from .style import FAINT, INK, PAPER

_LEFT_PX = 56


def time_plot(label):
    """A PlotWidget with a labelled left axis, which the mouse leaves alone."""
    plot = pg.PlotWidget(background=PAPER)
    plot.setLabel("left", label, **{"font-size": "8pt"})
    plot.showGrid(y=True, alpha=0.25)
    plot.setMenuEnabled(False)
    plot.hideButtons()
    plot.setMouseEnabled(False, False)
    plot.setMinimumHeight(0)
    for side in ("left", "bottom"):
        axis = plot.getAxis(side)
        axis.setPen(FAINT)
        axis.setTextPen(INK)
        axis.enableAutoSIPrefix(False)
    plot.getAxis("left").setWidth(_LEFT_PX)
    return plot
