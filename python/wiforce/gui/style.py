# SPDX-License-Identifier: GPL-3.0-or-later
"""Style of the displays, and what they have in common."""

import pyqtgraph as pg
from PyQt5.QtCore import QSize, Qt, QTimer
from PyQt5.QtGui import QColor, QShowEvent
from PyQt5.QtWidgets import QScrollArea, QWidget

from ..io import palette

INK, FAINT, PAPER, WARNING, BEAM, GROUND = map(
    QColor,
    (palette.INK, palette.FAINT, palette.PAPER, palette.WARNING, palette.BEAM, palette.GROUND),
)
# Width of the left axis: the same in all plots, so that their time axes are aligned.
_LEFT_PX = 56


def time_plot(label: str) -> pg.PlotWidget:
    """A plot over time that does not react to the mouse; the label is that of the left axis."""
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


class Display(QWidget):
    """A widget that is seen whole when its window opens, also in the scroll areas of Companion."""

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        if not event.spontaneous():
            QTimer.singleShot(0, self._enlarge_window)  # the layout is not complete before

    def _enlarge_window(self) -> None:
        """Enlarge a window that opened at its default size, as far as the screen allows."""
        window = self.window()
        if window.testAttribute(Qt.WA_Resized):
            return  # somebody chose the size, now or in an earlier run
        missing = QSize(0, 0)
        for area in window.findChildren(QScrollArea):
            if area.widget() is not None and area.widget().isAncestorOf(self):
                missing = missing.expandedTo(area.widget().sizeHint() - area.viewport().size())
        screen = window.screen().availableSize()
        decoration = window.frameGeometry().size() - window.size()
        window.resize((window.size() + missing).boundedTo(screen - decoration))
