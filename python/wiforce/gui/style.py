# SPDX-License-Identifier: GPL-3.0-or-later
"""Style and words of the displays, and what they have in common."""

from collections.abc import Sequence
from typing import Any

import pyqtgraph as pg
from PyQt5.QtCore import QSize, Qt, QTimer
from PyQt5.QtGui import QColor, QShowEvent
from PyQt5.QtWidgets import QApplication, QScrollArea, QWidget

from ..io import palette
from ..io.readings import Reading

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
    """A widget that is redrawn now and then, and seen whole when its window opens.

    Also in the scroll areas of Companion.
    """

    def __init__(self, every_ms: int, parent: QWidget | None = None) -> None:
        if QApplication.instance() is None:  # Qt itself ends the process
            raise RuntimeError(f"{type(self).__name__}: a QApplication must exist")
        super().__init__(parent)
        self._timer = QTimer(self)
        self._timer.timeout.connect(self.refresh)
        self._timer.start(every_ms)

    def refresh(self) -> None:
        """Redraw."""
        raise NotImplementedError

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


def warning_flags(reading: Reading) -> list[str]:
    """Words of the flags that warn of errors: all but ``reference``."""
    return [flag for flag in reading.flags if flag != "reference"]


def end_labels(sensors: Sequence[str]) -> list[str]:
    """Labels of both ends of every sensor; with its name where there are several."""
    prefixes = [f"{name} " if len(sensors) > 1 else "" for name in sensors]
    return [f"{prefix}end {end}" for prefix in prefixes for end in (1, 2)]


def notes(reading: Reading) -> str:
    """SNR and flags."""
    snr = [] if reading.snr_db is None else [f"SNR {reading.snr_db:.1f} dB"]
    return "  ".join([*snr, *reading.flags])


def tare_outcome(state: dict[str, Any]) -> str:
    """What became of a tare (port ``tare_state``); empty while measured, and without one."""
    outcome, reason = state.get("state", "none"), state.get("reason", "")
    if outcome in ("none", "measuring"):
        return ""
    forced = " (forced)" if state.get("forced") else ""
    return f"tare {outcome}{forced}" + (f": {reason}" if reason else "")
