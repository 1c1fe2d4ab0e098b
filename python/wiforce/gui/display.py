# SPDX-License-Identifier: GPL-3.0-or-later
"""Base of the widgets: their window opens at a size that shows all of them."""

from PyQt5.QtCore import QSize, Qt, QTimer
from PyQt5.QtGui import QShowEvent
from PyQt5.QtWidgets import QScrollArea, QWidget


class Display(QWidget):
    """A widget that is seen whole when its window opens.

    Flowgraphs of Companion put all widgets into a scroll area, whose size does not follow from
    what is in it.
    """

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
