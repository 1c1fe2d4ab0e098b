# SPDX-License-Identifier: GPL-3.0-or-later
"""Qt widget: force and location of all sensors over the last seconds, reliable or not."""

from collections import deque

import numpy as np
import pyqtgraph as pg
from PyQt5.QtCore import QSize
from PyQt5.QtGui import QFontMetrics
from PyQt5.QtWidgets import QSizePolicy, QVBoxLayout, QWidget

from ..io.readings import Reading
from .style import time_plot
from .words import warning_flags

# Most groups kept, however long the history: short groups arrive at some hundreds per second.
_MOST = 20_000


class Track:
    """One sensor's readings over the last ``history_s`` of signal, and the ``latest``."""

    def __init__(self, history_s: float) -> None:
        self._history_s = history_s
        self._past: deque[Reading] = deque(maxlen=_MOST)
        self.latest: Reading | None = None

    def add(self, reading: Reading) -> None:
        """Add a reading; one earlier than the latest means that a new run has begun."""
        if self.latest is not None and reading.time_s < self.latest.time_s:
            self._past.clear()
        self.latest = reading
        self._past.append(reading)
        while self._past[0].time_s < reading.time_s - self._history_s:
            self._past.popleft()

    def series(self, name: str, flagged: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Times and values (n,) of a column, of readings that are reliable or of those that are
        flagged.

        Times are those of all readings; values are NaN for the other readings and where they are
        unknown. The force of an untouched sensor is 0 N. A flag is one other than ``reference``.
        """
        times = [reading.time_s for reading in self._past]
        values = [
            _shown(reading, name) if bool(warning_flags(reading)) == flagged else None
            for reading in self._past
        ]
        return np.array(times), np.array(values, float)


def _shown(reading: Reading, name: str) -> float | None:
    if name == "force_n" and reading.touch == 0:
        return 0.0
    value: float | None = getattr(reading, name)
    return value


# The force axis shows at least this much, so that it does not magnify noise around 0 N.
_LEAST_FORCE_N = 1.0
_MARK_PX = 6
# Widest spacing of labels first.
_LOCATION_STEPS = (1, 2, 4)


class History(QWidget):
    """Force and location of all sensors in two plots over the same ``history_s``.

    Readings with a flag other than ``reference`` are crosses in the colour of the line. They do not
    stretch the force axis, whose limit is ``force_span_n`` without any other: a value beyond it is
    marked at its edge.
    """

    def __init__(self, history_s: float, length_mm: float, force_span_n: float) -> None:
        super().__init__()
        self._history_s = history_s
        self._length_mm = length_mm
        self._force_span_n = force_span_n
        self._force = time_plot("force (N)")
        self._force.getAxis("bottom").setStyle(showValues=False)
        self._location = time_plot("location (mm)")
        self._location.setLabel("bottom", "time (s), \u00d7 flagged")
        self._location.setYRange(0, length_mm, padding=0.05)
        self._force.setXLink(self._location)
        self._curves: dict[str, list[tuple[pg.PlotDataItem, pg.PlotDataItem]]] = {}
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(0)
        layout.addWidget(self._force, 3)
        layout.addWidget(self._location, 4)
        # The window may be made as low as the sensors allow.
        self.setSizePolicy(QSizePolicy.Expanding, QSizePolicy.Ignored)

    def minimumSizeHint(self) -> QSize:
        return QSize(0, 0)

    def draw(self, tracks: dict[str, Track], colors: dict[str, str]) -> None:
        """Draw the history of all tracks."""
        for name in set(self._curves) - set(tracks):
            for plot, items in zip(self._plots(), self._curves.pop(name), strict=True):
                for item in items:
                    plot.removeItem(item)
        newest, largest = 0.0, _LEAST_FORCE_N
        for track in tracks.values():
            largest = max(largest, self._largest_force(track))
            if track.latest is not None:
                newest = max(newest, track.latest.time_s)
        for name, track in tracks.items():
            if name not in self._curves:
                self._curves[name] = [_items(plot, colors[name]) for plot in self._plots()]
            for (line, marks), (column, limit) in zip(
                self._curves[name],
                (("force_n", largest), ("location_mm", self._length_mm)),
                strict=True,
            ):
                line.setData(*track.series(column))
                times, flagged = track.series(column, flagged=True)
                known = np.isfinite(flagged)
                # An unreliable value outside the axis is marked at its edge.
                marks.setData(times[known], np.clip(flagged[known], 0.0, limit))
        self._force.setYRange(0, largest, padding=0.08)
        start = max(0.0, newest - self._history_s)
        self._location.setXRange(start, max(newest, start + 1.0), padding=0)
        self._label_locations()

    def _label_locations(self) -> None:
        """Label as many locations as there is room for."""
        axis = self._location.getAxis("left")
        px_per_mm = axis.height() / (axis.range[1] - axis.range[0])
        spacings = [self._length_mm / steps for steps in _LOCATION_STEPS]
        room = QFontMetrics(axis.font()).ascent() / px_per_mm if px_per_mm else np.inf
        spacing = min([spacing for spacing in spacings if spacing >= room], default=spacings[0])
        axis.setTickSpacing(spacing, spacing)

    def _largest_force(self, track: Track) -> float:
        """The largest reliable force; without one, the span if there are unreliable ones."""
        if largest := np.fmax.reduce(track.series("force_n")[1], initial=0.0):
            return float(largest)
        return self._force_span_n if np.any(track.series("force_n", flagged=True)[1] > 0) else 0.0

    def _plots(self) -> tuple[pg.PlotWidget, pg.PlotWidget]:
        return self._force, self._location


def _items(plot: pg.PlotWidget, color: str) -> tuple[pg.PlotDataItem, pg.PlotDataItem]:
    """The line of a sensor's reliable readings and the marks of the others."""
    pen = pg.mkPen(color)
    marks = plot.plot(
        pen=None, symbol="x", symbolSize=_MARK_PX, symbolPen=pen, symbolBrush=pg.mkBrush(color)
    )
    return plot.plot(pen=pen, connect="finite"), marks
