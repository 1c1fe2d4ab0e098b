# SPDX-License-Identifier: GPL-3.0-or-later
"""Qt widgets: a sensor or a surface, its reading as text, and the press at its location."""

from collections.abc import Sequence

import numpy as np
from PyQt5.QtCore import QPointF, QRectF, Qt
from PyQt5.QtGui import QColor, QPainter, QPainterPath, QPaintEvent, QPen, QPolygonF
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
        self.setMinimumHeight(44)

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
        top = self._draw_text(painter, reading, line)
        area = QRectF(_MARGIN, top, self.width() - 2 * _MARGIN, self.height() - top)
        if area.height() > line:
            self._draw_line(painter, reading, area, line)
        painter.end()

    def _draw_text(self, painter: QPainter, reading: Reading, line: int) -> float:
        """Name, values, SNR and flags; returns the height used."""
        width = self.width() - 8
        used = 4 + self._draw_heading(painter, reading, line, width)
        note = notes(reading)
        metrics = painter.fontMetrics()
        painter.setPen(WARNING if warning_flags(reading) else FAINT)
        if used + metrics.horizontalAdvance(note) <= width:
            area = QRectF(used, 0, width - used, 1.3 * line)
            painter.drawText(area, Qt.AlignRight | Qt.AlignVCenter, note)
            return 1.4 * line
        painter.drawText(4, 2 * line, metrics.elidedText(note, Qt.ElideRight, width))
        return 2.3 * line

    def _draw_heading(self, painter: QPainter, reading: Reading, line: int, width: int) -> int:
        """Name and values in bold; returns the width used."""
        plain = painter.font()
        bold = painter.font()
        bold.setBold(True)
        painter.setFont(bold)
        metrics = painter.fontMetrics()
        name = metrics.elidedText(self._name, Qt.ElideRight, width // 3)
        painter.setPen(FAINT if self._stale else self._color)
        painter.drawText(4, line, name)
        used = metrics.horizontalAdvance(name) + _GAP
        text = "no readings" if self._stale else reading.press()
        if used + metrics.horizontalAdvance(text) > width and not self._stale:
            text = reading.press(bounds=False)
        text = metrics.elidedText(text, Qt.ElideRight, max(0, width - used))
        painter.setPen(FAINT if self._stale or reading.touch != 1 else INK)
        painter.drawText(4 + used, line, text)
        painter.setFont(plain)
        return used + metrics.horizontalAdvance(text) + _GAP

    def _x(self, area: QRectF, location_mm: float) -> float:
        part = min(max(location_mm / self._length_mm, 0.0), 1.0)
        return area.left() + part * area.width()

    def _draw_line(self, painter: QPainter, reading: Reading, area: QRectF, line: int) -> None:
        """The line with its scale, the beam above it, and the press."""
        labelled = area.height() > 3 * line
        ground = area.bottom() - (1.5 * line if labelled else 0.3 * line)
        pressed = reading.touch == 1 and not self._stale
        at = None
        if pressed and reading.location_mm is not None:
            at = self._x(area, reading.location_mm)
        self._draw_beam(painter, area, ground, at)
        if labelled:
            self._draw_scale(painter, area, ground, line)
        if at is not None:
            self._draw_spread(painter, reading, area, ground)
            self._draw_arrow(painter, reading, area, at, ground)

    def _draw_beam(self, painter: QPainter, area: QRectF, ground: float, at: float | None) -> None:
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

    def _draw_scale(self, painter: QPainter, area: QRectF, ground: float, line: int) -> None:
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

    def _press_color(self, reading: Reading) -> QColor:
        return WARNING if warning_flags(reading) else self._color

    def _draw_spread(
        self, painter: QPainter, reading: Reading, area: QRectF, ground: float
    ) -> None:
        """Two standard deviations of the location to either side."""
        if reading.location_mm is None or reading.location_std_mm is None:
            return
        spread = 2 * reading.location_std_mm
        left = self._x(area, reading.location_mm - spread)
        right = self._x(area, reading.location_mm + spread)
        color = QColor(self._press_color(reading))
        color.setAlpha(50)
        painter.fillRect(QRectF(left, area.top(), right - left, ground - area.top()), color)

    def _draw_arrow(
        self, painter: QPainter, reading: Reading, area: QRectF, at: float, ground: float
    ) -> None:
        """The press: the length is the force; dotted while the force is not known."""
        force_n = reading.force_n
        tip = ground - 4
        part = 1.0 if force_n is None else min(max(force_n / self._force_span_n, 0.0), 1.0)
        length = max(8.0, part * (tip - area.top() - 2))
        pen = QPen(self._press_color(reading), 3)
        if force_n is None:
            pen.setStyle(Qt.DotLine)
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
_LABELLED_LINES = 6


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

    def _draw_line(self, painter: QPainter, reading: Reading, area: QRectF, line: int) -> None:
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
        if plane.height() > _LABELLED_LINES * line:
            painter.setPen(FAINT)
            size = f"{self._length_mm:g} x {high - low:g} mm"
            painter.drawText(plane.bottomLeft() + QPointF(4, -3), size)
        if not isinstance(reading, SurfaceReading) or reading.touch != 1 or self._stale:
            return
        if reading.location_mm is not None and reading.y_mm is not None:
            painter.setClipRect(area)
            self._draw_press(painter, reading, at(reading.location_mm, reading.y_mm), scale)
            painter.setClipping(False)

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
        color = QColor(self._press_color(reading))
        doubtful = self._press_color(reading) is not self._color
        part = 1.0 if reading.force_n is None else max(reading.force_n, 0.0) / self._force_span_n
        radius = max(_LEAST_PX, _LARGEST_PX * min(part, 4.0) ** 0.5)
        filled = QColor(color)
        filled.setAlpha(130)
        pen = QPen(color, 2)
        if doubtful:
            pen.setStyle(Qt.DashLine)
        painter.setPen(pen)
        painter.setBrush(Qt.NoBrush if doubtful else filled)
        painter.drawEllipse(at, radius, radius)
        semi, angle = ellipse(reading)
        if semi is None:
            return
        painter.translate(at)
        painter.rotate(-angle)
        painter.setPen(QPen(INK, 1.5))
        painter.setBrush(Qt.NoBrush)
        painter.drawEllipse(QPointF(0, 0), scale * semi[0], scale * semi[1])
        painter.resetTransform()


def ellipse(reading: SurfaceReading) -> tuple[tuple[float, float] | None, float]:
    """Half axes (mm, or None) of two standard deviations of x and y, and their angle (deg)."""
    x_std, y_std = reading.location_std_mm, reading.y_std_mm
    if x_std is None or y_std is None:
        return None, 0.0
    across = reading.cov_x_y or 0.0
    variance, axes = np.linalg.eigh([[x_std**2, across], [across, y_std**2]])
    first, second = _SIGMAS * np.sqrt(np.maximum(variance, 0.0))
    return (float(first), float(second)), float(np.degrees(np.arctan2(axes[1, 0], axes[0, 0])))
