# SPDX-License-Identifier: GPL-3.0-or-later
"""Qt widget: one sensor, what it reads in words, and the line with the press where it is."""

import numpy as np
from PyQt5.QtCore import QPointF, QRectF, Qt
from PyQt5.QtGui import QColor, QPainter, QPainterPath, QPen, QPolygonF
from PyQt5.QtWidgets import QWidget

from .style import BEAM, DOUBT, FAINT, GROUND, INK
from .words import doubts, notes, values

_MARGIN = 16
_GAP = 14


class SensorView(QWidget):
    """Draws one sensor.

    Parameters
    ----------
    name, color : str
    length_mm : float
        Length of the line.
    force_span_n : float
        Force of the longest arrow.
    """

    def __init__(self, name, color, length_mm, force_span_n):
        super().__init__()
        self._name = name
        self._color = QColor(color)
        self._length_mm = length_mm
        self._force_span_n = force_span_n
        self._reading = None
        self._stale = False
        self.setMinimumHeight(44)

    def show_reading(self, reading, stale):
        """Draws another reading, or the same one as out of date."""
        if (reading, stale) != (self._reading, self._stale):
            self._reading, self._stale = reading, stale
            self.update()

    def paintEvent(self, event):
        if self._reading is None:
            return
        painter = QPainter(self)
        painter.setRenderHint(QPainter.Antialiasing)
        line = painter.fontMetrics().height()
        top = self._draw_text(painter, line)
        area = QRectF(_MARGIN, top, self.width() - 2 * _MARGIN, self.height() - top)
        if area.height() > line:
            self._draw_line(painter, area, line)
        painter.end()

    def _draw_text(self, painter, line):
        """Name, values, SNR and flags; returns the height taken."""
        width = self.width() - 8
        used = 4 + self._draw_heading(painter, line, width)
        note = notes(self._reading)
        metrics = painter.fontMetrics()
        painter.setPen(DOUBT if doubts(self._reading) else FAINT)
        if used + metrics.horizontalAdvance(note) <= width:
            place = QRectF(used, 0, width - used, 1.3 * line)
            painter.drawText(place, Qt.AlignRight | Qt.AlignVCenter, note)
            return 1.4 * line
        painter.drawText(4, 2 * line, metrics.elidedText(note, Qt.ElideRight, width))
        return 2.3 * line

    def _draw_heading(self, painter, line, width):
        """Name and values in bold; returns the width taken."""
        plain = painter.font()
        bold = painter.font()
        bold.setBold(True)
        painter.setFont(bold)
        metrics = painter.fontMetrics()
        name = metrics.elidedText(self._name, Qt.ElideRight, width // 3)
        painter.setPen(FAINT if self._stale else self._color)
        painter.drawText(4, line, name)
        used = metrics.horizontalAdvance(name) + _GAP
        text = "no readings" if self._stale else values(self._reading)
        if used + metrics.horizontalAdvance(text) > width and not self._stale:
            text = values(self._reading, bounds=False)
        text = metrics.elidedText(text, Qt.ElideRight, max(0, width - used))
        painter.setPen(FAINT if self._stale or self._reading.touch != 1 else INK)
        painter.drawText(4 + used, line, text)
        painter.setFont(plain)
        return used + metrics.horizontalAdvance(text) + _GAP

    def _x(self, area, location_mm):
        part = min(max(location_mm / self._length_mm, 0.0), 1.0)
        return area.left() + part * area.width()

    def _draw_line(self, painter, area, line):
        """The line with its scale, the beam above it, and the press."""
        labelled = area.height() > 3 * line
        ground = area.bottom() - (1.5 * line if labelled else 0.3 * line)
        reading = self._reading
        pressed = reading.touch == 1 and reading.location_mm is not None and not self._stale
        at = self._x(area, reading.location_mm) if pressed else None
        self._draw_beam(painter, area, ground, at)
        if labelled:
            self._draw_scale(painter, area, ground, line)
        if pressed:
            self._draw_spread(painter, area, ground)
            self._draw_arrow(painter, area, at, ground)

    def _draw_beam(self, painter, area, ground, at):
        painter.fillRect(QRectF(area.left(), ground - 3, area.width(), 3), GROUND)
        thickness = min(8.0, 0.12 * area.height())
        top = ground - min(3 * thickness, 0.4 * area.height())
        beam = QPainterPath(QPointF(area.left(), top))
        if at is not None:
            # A picture of a bent beam, not its mechanics.
            reach, low = 0.18 * area.width(), ground - 3 - thickness / 2
            for start, end, y in ((at - reach, at, low), (at, at + reach, top)):
                start, end = max(area.left(), start), min(area.right(), end)
                middle, before = (start + end) / 2, beam.currentPosition().y()
                beam.lineTo(start, before)
                beam.cubicTo(middle, before, middle, y, end, y)
        beam.lineTo(area.right(), beam.currentPosition().y())
        pen = QPen(BEAM, thickness)
        pen.setCapStyle(Qt.FlatCap)
        painter.setBrush(Qt.NoBrush)
        painter.setPen(pen)
        painter.drawPath(beam)

    def _draw_scale(self, painter, area, ground, line):
        metrics = painter.fontMetrics()
        painter.setPen(FAINT)
        step = 10.0 if area.width() > 9 * metrics.horizontalAdvance("00 mm") else 20.0
        step *= max(1.0, np.ceil(self._length_mm / 100.0))
        marks = np.arange(0.0, self._length_mm * (1 + 1e-9), step)
        for mark in marks:
            x = self._x(area, mark)
            painter.drawLine(QPointF(x, ground), QPointF(x, ground + 4))
            text = f"{mark:g} mm" if mark == marks[-1] else f"{mark:g}"
            width = metrics.horizontalAdvance(text)
            left = min(max(x - width / 2, 0.0), self.width() - width)
            painter.drawText(QPointF(left, ground + 4 + 0.9 * line), text)

    def _press_color(self):
        return DOUBT if doubts(self._reading) else self._color

    def _draw_spread(self, painter, area, ground):
        """Two standard deviations of the location to either side."""
        reading = self._reading
        if reading.location_std_mm is None:
            return
        spread = 2 * reading.location_std_mm
        left = self._x(area, reading.location_mm - spread)
        right = self._x(area, reading.location_mm + spread)
        color = QColor(self._press_color())
        color.setAlpha(50)
        painter.fillRect(QRectF(left, area.top(), right - left, ground - area.top()), color)

    def _draw_arrow(self, painter, area, at, ground):
        """The press: length is force; dotted when touched with a force that is not known."""
        force_n = self._reading.force_n
        tip = ground - 4
        part = 1.0 if force_n is None else min(max(force_n / self._force_span_n, 0.0), 1.0)
        length = max(8.0, part * (tip - area.top() - 2))
        pen = QPen(self._press_color(), 3)
        if force_n is None:
            pen.setStyle(Qt.DotLine)
        painter.setPen(pen)
        painter.drawLine(QPointF(at, tip - length), QPointF(at, tip - 6))
        painter.setPen(Qt.NoPen)
        painter.setBrush(self._press_color())
        head = [QPointF(at + dx, tip + dy) for dx, dy in ((0, 0), (-5, -9), (5, -9))]
        painter.drawPolygon(QPolygonF(head))
