# SPDX-License-Identifier: GPL-3.0-or-later
"""Qt widget: slowly sampled values over the last seconds, rolling."""

from collections import deque
from collections.abc import Sequence
from html import escape

import numpy as np
import pyqtgraph as pg
from PyQt5.QtCore import QSize, QTimer
from PyQt5.QtWidgets import QApplication, QVBoxLayout, QWidget

from ..errors import InputError
from ..io.palette import SERIES
from .style import INK, Display, time_plot

_REFRESH_MS = 200
_MOST = 20_000


class Trend(Display):
    """Rolling plot of values that arrive at a steady rate, up to some hundreds per second and line.

    The vertical axis is that of the values unless ``y_range`` is given.
    """

    def __init__(
        self,
        labels: Sequence[str],
        y_label: str,
        rate: float,
        history_s: float = 10.0,
        title: str = "",
        y_range: tuple[float, float] | None = None,
        parent: QWidget | None = None,
    ) -> None:
        for name, value in (("rate", rate), ("history_s", history_s)):
            if not 0 < value < np.inf:
                raise InputError(name, "must be positive", value)
        if not labels:
            raise InputError("labels", "must name at least one line", labels)
        if y_range is not None and not y_range[0] < y_range[1]:
            raise InputError("y_range", "must rise", y_range)
        if QApplication.instance() is None:  # Qt itself ends the process
            raise RuntimeError("Trend: a QApplication must exist")
        super().__init__(parent)
        self._rate = rate
        self._history_s = history_s
        length = min(_MOST, int(np.ceil(rate * history_s)) + 1)
        self._values: list[deque[float]] = [deque(maxlen=length) for _ in labels]
        self._count = [0] * len(labels)
        self._plot = time_plot(y_label)
        self._plot.setLabel("bottom", "time (s)")
        # Above the plot, where the legend hides no values.
        names = [
            f'<b style="color: {SERIES[n % len(SERIES)]}">\u2014</b> {escape(label)}'
            for n, label in enumerate(labels)
        ]
        heading = "&nbsp;&nbsp; ".join(filter(None, [escape(title), *names]))
        self._plot.setTitle(heading, color=INK, size="10pt")
        self._plot.setMinimumHeight(120)
        if y_range is not None:
            self._plot.setYRange(*y_range)
        self._curves = [
            self._plot.plot(pen=pg.mkPen(SERIES[n % len(SERIES)]), connect="finite")
            for n in range(len(labels))
        ]
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self._plot)
        self._timer = QTimer(self)
        self._timer.timeout.connect(self.refresh)
        self._timer.start(_REFRESH_MS)

    def add(self, line: int, values: Sequence[float]) -> None:
        """Add the next values of a line; NaN leaves a gap. May be called from any thread."""
        self._values[line].extend(map(float, values))
        self._count[line] += len(values)

    def series(self, line: int) -> tuple[np.ndarray, np.ndarray]:
        """Times in s since the first value, and the values shown of a line."""
        values = np.array(self._values[line])
        return (self._count[line] - len(values) + np.arange(len(values))) / self._rate, values

    def refresh(self) -> None:
        """Redraw; the widget's own timer calls this five times per second."""
        newest = max(self._count) / self._rate
        for line, curve in enumerate(self._curves):
            curve.setData(*self.series(line))
        start = max(0.0, newest - self._history_s)
        self._plot.setXRange(start, max(newest, start + 1.0), padding=0)

    def sizeHint(self) -> QSize:
        return QSize(640, 200)
