# SPDX-License-Identifier: GPL-3.0-or-later
"""Common look of the widgets: colours, and plots over time."""

import pyqtgraph as pg
from PyQt5.QtGui import QColor

from ..io import palette

INK, FAINT, PAPER, WARNING, BEAM, GROUND = map(
    QColor,
    (palette.INK, palette.FAINT, palette.PAPER, palette.WARNING, palette.BEAM, palette.GROUND),
)
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
