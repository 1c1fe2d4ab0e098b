# SPDX-License-Identifier: GPL-3.0-or-later
"""Qt widgets with one plot: the Doppler spectrum of the latest group, and slowly sampled values."""

from collections import deque
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
import pyqtgraph as pg
from PyQt5.QtCore import QSize, Qt
from PyQt5.QtWidgets import QVBoxLayout

from ..errors import InputError
from ..io.palette import SERIES
from .style import INK, Display, time_plot

_REFRESH_MS = 200
_MOST = 20_000
_LEAST_POWER = 1e-20


class _OnePlot(Display):
    """A plot that is drawn again five times per second."""

    def __init__(self, left: str, bottom: str, title: str | None, size: QSize) -> None:
        super().__init__(_REFRESH_MS)
        self._size = size
        self._plot = time_plot(left)
        self._plot.setLabel("bottom", bottom)
        self._plot.setTitle(title, color=INK, size="10pt")
        self._plot.setMinimumHeight(120)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self._plot)

    def sizeHint(self) -> QSize:
        return self._size


class Spectrum(_OnePlot):
    """Power over Doppler frequency up to half the snapshot rate, with labelled lines."""

    def __init__(
        self,
        snapshot_rate_hz: float,
        lines_hz: Mapping[str, float],
        title: str = "",
    ) -> None:
        if not 0 < snapshot_rate_hz < np.inf:
            raise InputError("snapshot_rate_hz", "must be positive", snapshot_rate_hz)
        size = QSize(640, 220)
        super().__init__("power (dB)", "Doppler frequency (Hz)", title or None, size)
        self.lines_hz = dict(lines_hz)
        self._rate_hz = snapshot_rate_hz
        self._power = np.zeros(0)
        self._plot.setXRange(0, snapshot_rate_hz / 2, padding=0)
        for number, (label, hertz) in enumerate(self.lines_hz.items()):
            pen = pg.mkPen(SERIES[(number + 1) % len(SERIES)], style=Qt.DashLine)
            options = {"color": INK, "position": 0.92, "fill": (255, 255, 255, 200)}
            self._plot.addItem(
                pg.InfiniteLine(hertz, angle=90, pen=pen, label=label, labelOpts=options)
            )
        self._curve = self._plot.plot(pen=pg.mkPen(SERIES[0]))

    def show_power(self, power: np.ndarray) -> None:
        """Show the power in each bin of a Fourier transform, in natural order; from any thread."""
        self._power = np.asarray(power, float)

    def series(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies in Hz from 0 on and the levels shown, in dB; empty before the first group."""
        power = self._power
        count = len(power) // 2 + 1 if len(power) else 0
        hertz = np.arange(count) * self._rate_hz / max(1, len(power))
        return hertz, 10 * np.log10(np.maximum(power[:count], _LEAST_POWER))

    def refresh(self) -> None:
        self._curve.setData(*self.series())


class Trend(_OnePlot):
    """Rolling plot of values at a steady rate; its vertical axis is theirs without ``y_range``."""

    def __init__(
        self,
        labels: Sequence[str],
        y_label: str,
        rate: float,
        history_s: float = 10.0,
        title: str = "",
        y_range: tuple[float, float] | None = None,
    ) -> None:
        for name, value in (("rate", rate), ("history_s", history_s)):
            if not 0 < value < np.inf:
                raise InputError(name, "must be positive", value)
        if not labels:
            raise InputError("labels", "must name at least one line", labels)
        if y_range is not None and not y_range[0] < y_range[1]:
            raise InputError("y_range", "must rise", y_range)
        # Above the plot, where the legend hides no values.
        names = [
            f'<b style="color: {SERIES[n % len(SERIES)]}">\u2014</b> {escape(label)}'
            for n, label in enumerate(labels)
        ]
        heading = "&nbsp;&nbsp; ".join(filter(None, [escape(title), *names]))
        super().__init__(y_label, "time (s)", heading, QSize(640, 200))
        self._rate = rate
        self._history_s = history_s
        length = min(_MOST, int(np.ceil(rate * history_s)) + 1)
        self._values: list[deque[float]] = [deque(maxlen=length) for _ in labels]
        self._count = [0] * len(labels)
        if y_range is not None:
            self._plot.setYRange(*y_range)
        self._curves = [
            self._plot.plot(pen=pg.mkPen(SERIES[n % len(SERIES)]), connect="finite")
            for n in range(len(labels))
        ]

    def add(self, line: int, values: Sequence[float]) -> None:
        """Add the next values of a line; NaN leaves a gap. May be called from any thread."""
        self._values[line].extend(map(float, values))
        self._count[line] += len(values)

    def series(self, line: int) -> tuple[np.ndarray, np.ndarray]:
        """Times in s since the first value, and the values shown of a line."""
        values = np.array(self._values[line])
        return (self._count[line] - len(values) + np.arange(len(values))) / self._rate, values

    def refresh(self) -> None:
        newest = max(self._count) / self._rate
        for line, curve in enumerate(self._curves):
            curve.setData(*self.series(line))
        start = max(0.0, newest - self._history_s)
        self._plot.setXRange(start, max(newest, start + 1.0), padding=0)
