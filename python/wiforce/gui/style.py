# SPDX-License-Identifier: GPL-3.0-or-later
"""Common look of the widgets: colours, and plots over time."""

import pyqtgraph as pg
from PyQt5.QtGui import QColor

# One per sensor, distinguishable with red-green colour blindness: M. Okabe and K. Ito, "Color
# Universal Design", 2008, but for the last one: theirs is too near to the second.
SENSORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e6c200")
INK, FAINT, PAPER, WARNING = map(QColor, ("#202428", "#737a82", "#ffffff", "#b45f00"))
BEAM, GROUND = map(QColor, ("#cdd4db", "#9aa3ac"))
# Width of the left axis: the same in all plots, so that their time axes are aligned.
_LEFT_PX = 56


def time_plot(label: str) -> pg.PlotWidget:
    """A plot over time that does not react to the mouse.

    Parameters
    ----------
    label : str
        Of the left axis, with its unit.
    """
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
