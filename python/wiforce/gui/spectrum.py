# SPDX-License-Identifier: GPL-3.0-or-later
"""Qt widget: the Doppler spectrum of the latest phase group, with marks at the tags' lines."""

from collections.abc import Mapping

import numpy as np
import pyqtgraph as pg
from PyQt5.QtCore import QSize, Qt, QTimer
from PyQt5.QtWidgets import QApplication, QVBoxLayout, QWidget

from ..errors import InputError
from ..io.palette import SERIES
from .style import INK, Display, time_plot

_REFRESH_MS = 200
_LEAST_POWER = 1e-20


class Spectrum(Display):
    """Power over Doppler frequency up to half the snapshot rate, with labelled lines."""

    def __init__(
        self,
        snapshot_rate_hz: float,
        lines_hz: Mapping[str, float],
        title: str = "",
        parent: QWidget | None = None,
    ) -> None:
        if not 0 < snapshot_rate_hz < np.inf:
            raise InputError("snapshot_rate_hz", "must be positive", snapshot_rate_hz)
        if QApplication.instance() is None:  # Qt itself ends the process
            raise RuntimeError("Spectrum: a QApplication must exist")
        super().__init__(parent)
        self.lines_hz = dict(lines_hz)
        self._rate_hz = snapshot_rate_hz
        self._power = np.zeros(0)
        self._plot = time_plot("power (dB)")
        self._plot.setLabel("bottom", "Doppler frequency (Hz)")
        self._plot.setTitle(title or None, color=INK, size="10pt")
        self._plot.setMinimumHeight(120)
        self._plot.setXRange(0, snapshot_rate_hz / 2, padding=0)
        for number, (label, hertz) in enumerate(self.lines_hz.items()):
            pen = pg.mkPen(SERIES[(number + 1) % len(SERIES)], style=Qt.DashLine)
            options = {"color": INK, "position": 0.92, "fill": (255, 255, 255, 200)}
            self._plot.addItem(
                pg.InfiniteLine(hertz, angle=90, pen=pen, label=label, labelOpts=options)
            )
        self._curve = self._plot.plot(pen=pg.mkPen(SERIES[0]))
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self._plot)
        self._timer = QTimer(self)
        self._timer.timeout.connect(self.refresh)
        self._timer.start(_REFRESH_MS)

    def show_power(self, power: np.ndarray) -> None:
        """Show the power in each bin of a discrete Fourier transform, in natural order.

        May be called from any thread.
        """
        self._power = np.asarray(power, float)

    def series(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies in Hz from 0 on and the levels shown, in dB; empty before the first group."""
        power = self._power
        count = len(power) // 2 + 1 if len(power) else 0
        hertz = np.arange(count) * self._rate_hz / max(1, len(power))
        return hertz, 10 * np.log10(np.maximum(power[:count], _LEAST_POWER))

    def refresh(self) -> None:
        """Redraw; the widget's own timer calls this five times per second."""
        self._curve.setData(*self.series())

    def sizeHint(self) -> QSize:
        return QSize(640, 220)
