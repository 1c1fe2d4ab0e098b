# SPDX-License-Identifier: GPL-3.0-or-later
"""Qt widgets: a sensor or a surface, its reading as text, and the press at its location."""

from collections.abc import Sequence

import numpy as np
from PyQt5.QtCore import QPointF, QRectF, Qt
from PyQt5.QtGui import QColor, QPainter, QPaintEvent, QPen, QPolygonF
from PyQt5.QtWidgets import QWidget

from ..io.readings import Reading, SurfaceReading
from .style import BEAM, FAINT, GROUND, INK, WARNING, notes, warning_flags

_MARGIN = 16
_GAP = 14


class SensorView(QWidget):
    """Draws one sensor; ``force_span_n`` is the force of the longest arrow."""

    def __init__(self, name: str, color: str, length_mm: float, force_span_n: float) -> None:
        super().__init__()
        self._name = name
        self._color = QColor(color)
        self._length_mm = length_mm
        self._force_span_n = force_span_n
        self._reading: Reading | None = None
        self._stale = False
        self.setMinimumHeight(70)

    def show_reading(self, reading: Reading | None, stale: bool) -> None:
        """Draw another reading, or the same one as out of date."""
        if (reading, stale) != (self._reading, self._stale):
            self._reading, self._stale = reading, stale
            self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        reading = self._reading
        if reading is None:
            return
        painter = QPainter(self)
        painter.setRenderHint(QPainter.Antialiasing)
        line = painter.fontMetrics().height()
        self._draw_text(painter, reading, line)
        top = 2.3 * line
        area = QRectF(_MARGIN, top, self.width() - 2 * _MARGIN, self.height() - top)
        if area.height() > line:
            self._draw_picture(painter, reading, area, line)
        painter.end()

    def _draw_text(self, painter: QPainter, reading: Reading, line: int) -> None:
        """Name and values, and below them SNR and flags."""
        metrics = painter.fontMetrics()
        name = metrics.elidedText(self._name, Qt.ElideRight, self.width() // 3)
        painter.setPen(FAINT if self._stale else self._color)
        painter.drawText(4, line, name)
        painter.setPen(FAINT if self._stale or reading.touch != 1 else INK)
        text = "no readings" if self._stale else reading.press()
        painter.drawText(4 + metrics.horizontalAdvance(name) + _GAP, line, text)
        painter.setPen(WARNING if warning_flags(reading) else FAINT)
        painter.drawText(4, 2 * line, notes(reading))

    def _x(self, area: QRectF, location_mm: float) -> float:
        part = min(max(location_mm / self._length_mm, 0.0), 1.0)
        return area.left() + part * area.width()

    def _draw_picture(self, painter: QPainter, reading: Reading, area: QRectF, line: int) -> None:
        """The line, its length, and the press with two standard deviations of its location."""
        ground = area.bottom() - 1.5 * line
        painter.fillRect(QRectF(area.left(), ground - 3, area.width(), 3), GROUND)
        painter.setPen(FAINT)
        below = QRectF(area.left(), ground, area.width(), 1.5 * line)
        painter.drawText(below, Qt.AlignLeft, "0")
        painter.drawText(below, Qt.AlignRight, f"{self._length_mm:g} mm")
        if reading.touch != 1 or self._stale or reading.location_mm is None:
            return
        color = self._press_color(reading)
        if reading.location_std_mm is not None:
            spread = 2 * reading.location_std_mm
            left = self._x(area, reading.location_mm - spread)
            right = self._x(area, reading.location_mm + spread)
            faint = QColor(color)
            faint.setAlpha(50)
            painter.fillRect(QRectF(left, area.top(), right - left, ground - area.top()), faint)
        self._draw_arrow(painter, reading, area, self._x(area, reading.location_mm), ground - 4)

    def _press_color(self, reading: Reading) -> QColor:
        return WARNING if warning_flags(reading) else self._color

    def _draw_arrow(
        self, painter: QPainter, reading: Reading, area: QRectF, at: float, tip: float
    ) -> None:
        """The press: the length is the force; dotted while the force is not known."""
        force_n = reading.force_n
        part = 1.0 if force_n is None else min(max(force_n / self._force_span_n, 0.0), 1.0)
        length = max(8.0, part * (tip - area.top() - 2))
        pen = QPen(self._press_color(reading), 3, Qt.DotLine if force_n is None else Qt.SolidLine)
        painter.setPen(pen)
        painter.drawLine(QPointF(at, tip - length), QPointF(at, tip - 6))
        painter.setPen(Qt.NoPen)
        painter.setBrush(self._press_color(reading))
        head = [QPointF(at + dx, tip + dy) for dx, dy in ((0, 0), (-5, -9), (5, -9))]
        painter.drawPolygon(QPolygonF(head))


# Radius of the dot of the largest force; its area is the force.
_LARGEST_PX, _LEAST_PX = 16.0, 2.5
# Where no strips are known, the plane is so wide about the press.
_UNKNOWN_MM = 20.0
_SIGMAS = 2.0


class SurfaceView(SensorView):
    """Draws one press on a surface, x from 0 to ``length_mm``; strips where their y is known."""

    def __init__(
        self,
        name: str,
        color: str,
        length_mm: float,
        force_span_n: float,
        strips_y_mm: Sequence[float] = (),
    ) -> None:
        super().__init__(name, color, length_mm, force_span_n)
        self._strips_y_mm = sorted(strips_y_mm)
        self.setMinimumHeight(140)

    def _draw_picture(self, painter: QPainter, reading: Reading, area: QRectF, line: int) -> None:
        """The plane, its strips and the press, seen from above."""
        low, high = self._span(reading)
        inner = area.adjusted(0, 2, 0, -0.4 * line)
        scale = min(inner.width() / self._length_mm, inner.height() / (high - low))
        left = inner.center().x() - 0.5 * scale * self._length_mm
        middle = inner.center().y()

        def at(x_mm: float, y_mm: float) -> QPointF:
            return QPointF(left + scale * x_mm, middle - scale * (y_mm - (low + high) / 2))

        plane = QRectF(at(0.0, high), at(self._length_mm, low))
        painter.setPen(QPen(GROUND, 1))
        painter.setBrush(Qt.NoBrush)
        painter.drawRect(plane)
        painter.setPen(QPen(BEAM, 5))
        for y in self._strips_y_mm:
            painter.drawLine(at(0.0, y), at(self._length_mm, y))
        painter.setPen(FAINT)
        size = f"{self._length_mm:g} x {high - low:g} mm"
        painter.drawText(plane.bottomLeft() + QPointF(4, -3), size)
        if not isinstance(reading, SurfaceReading) or reading.touch != 1 or self._stale:
            return
        if reading.location_mm is not None and reading.y_mm is not None:
            painter.setClipRect(area)
            self._draw_press(painter, reading, at(reading.location_mm, reading.y_mm), scale)

    def _span(self, reading: Reading) -> tuple[float, float]:
        """What is shown of y."""
        strips = self._strips_y_mm
        if len(strips) > 1:
            beyond = 0.5 * (strips[-1] - strips[0]) / (len(strips) - 1)
            return strips[0] - beyond, strips[-1] + beyond
        y = getattr(reading, "y_mm", None) or 0.0
        return min(0.0, y - _UNKNOWN_MM / 4), max(_UNKNOWN_MM, y + _UNKNOWN_MM / 4)

    def _draw_press(
        self, painter: QPainter, reading: SurfaceReading, at: QPointF, scale: float
    ) -> None:
        """An ellipse of two standard deviations, and a dot whose area is the force."""
        color = self._press_color(reading)
        part = 1.0 if reading.force_n is None else max(reading.force_n, 0.0) / self._force_span_n
        radius = max(_LEAST_PX, _LARGEST_PX * min(part, 4.0) ** 0.5)
        filled = QColor(color)
        filled.setAlpha(130)
        painter.setPen(QPen(color, 2))
        painter.setBrush(filled)
        painter.drawEllipse(at, radius, radius)
        semi, angle = ellipse(reading)
        if semi is None:
            return
        painter.translate(at)
        painter.rotate(-angle)
        painter.setPen(QPen(INK, 1.5))
        painter.setBrush(Qt.NoBrush)
        painter.drawEllipse(QPointF(0, 0), scale * semi[0], scale * semi[1])


def ellipse(reading: SurfaceReading) -> tuple[tuple[float, float] | None, float]:
    """Half axes (mm, or None) of two standard deviations of x and y, and their angle (deg)."""
    x_std, y_std = reading.location_std_mm, reading.y_std_mm
    if x_std is None or y_std is None:
        return None, 0.0
    across = reading.cov_x_y or 0.0
    variance, axes = np.linalg.eigh([[x_std**2, across], [across, y_std**2]])
    first, second = _SIGMAS * np.sqrt(np.maximum(variance, 0.0))
    return (float(first), float(second)), float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0])))
