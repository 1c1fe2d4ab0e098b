# SPDX-License-Identifier: GPL-3.0-or-later
"""Qt widget: a surface from above, with its strips, the press and where it may be."""

from collections.abc import Sequence

import numpy as np
from PyQt5.QtCore import QPointF, QRectF, Qt
from PyQt5.QtGui import QColor, QPainter, QPen

from ..io.readings import Reading, SurfaceReading
from .sensor_view import SensorView
from .style import BEAM, FAINT, GROUND, INK

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
