# SPDX-License-Identifier: GPL-3.0-or-later
"""Qt widgets: force and location of all sensors with their uncertainty, now and before."""

import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any

import numpy as np
import pyqtgraph as pg
from PyQt5.QtCore import QSize, Qt, pyqtSignal
from PyQt5.QtGui import QPalette, QResizeEvent
from PyQt5.QtWidgets import (
    QHBoxLayout,
    QLabel,
    QPushButton,
    QScrollArea,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from ..errors import InputError
from ..io.palette import SERIES
from ..io.readings import Reading, SurfaceReading, as_reading
from .sensor_view import SensorView, SurfaceView
from .style import PAPER, Display, tare_outcome, time_plot, warning_flags

# Most groups kept, however long the history: short groups arrive at some hundreds per second.
_MOST = 20_000


class Track:
    """One sensor's readings over the last ``history_s`` of signal, and how they are shown."""

    view: SensorView

    def __init__(self, history_s: float, color: str = SERIES[0]) -> None:
        self._history_s, self.color = history_s, color
        self._past: deque[Reading] = deque(maxlen=_MOST)
        self.latest: Reading | None = None
        self.seen_s = 0.0  # when the latest one arrived
        self.curves: list[tuple[pg.PlotDataItem, pg.PlotDataItem]] = []  # in the histories

    def add(self, reading: Reading) -> None:
        """Add a reading; one earlier than the latest means that a new run has begun."""
        if self.latest is not None and reading.time_s < self.latest.time_s:
            self._past.clear()
        self.latest = reading
        self._past.append(reading)
        while self._past[0].time_s < reading.time_s - self._history_s:
            self._past.popleft()

    def series(self, name: str, flagged: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Times and values (n,) of a column, of readings that are reliable or flagged, NaN else."""
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


class History(QWidget):
    """Force and location of all sensors over ``history_s``; flagged readings are crosses.

    They do not stretch the force axis: a value beyond it is marked at its edge.
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
        self._location.setYRange(0, length_mm, padding=0.1)
        self._location.getAxis("left").setTickSpacing(length_mm / 2, length_mm / 4)
        self._force.setXLink(self._location)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(0)
        layout.addWidget(self._force, 3)
        layout.addWidget(self._location, 4)
        # The window may be made as low as the sensors allow.
        self.setSizePolicy(QSizePolicy.Expanding, QSizePolicy.Ignored)

    def minimumSizeHint(self) -> QSize:
        return QSize(0, 0)

    def remove(self, track: Track) -> None:
        """Remove the history of a track."""
        for plot, items in zip(self._plots(), track.curves, strict=False):
            for item in items:
                plot.removeItem(item)

    def draw(self, tracks: Collection[Track]) -> None:
        """Draw the history of all tracks."""
        newest = max((track.latest.time_s for track in tracks if track.latest), default=0.0)
        largest = max([_LEAST_FORCE_N, *map(self._largest_force, tracks)])
        columns = ("force_n", largest), ("location_mm", self._length_mm)
        for track in tracks:
            track.curves = track.curves or [_items(plot, track.color) for plot in self._plots()]
            for (line, marks), (column, limit) in zip(track.curves, columns, strict=True):
                line.setData(*track.series(column))
                times, flagged = track.series(column, flagged=True)
                known = np.isfinite(flagged)
                # An unreliable value outside the axis is marked at its edge.
                marks.setData(times[known], np.clip(flagged[known], 0.0, limit))
        self._force.setYRange(0, largest, padding=0.08)
        start = max(0.0, newest - self._history_s)
        self._location.setXRange(start, max(newest, start + 1.0), padding=0)

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


_REFRESH_MS = 40
# Histories are redrawn less often: they cost ten times the rest and change slowly.
_HISTORY_EVERY = 5
# Below this height the histories are hidden, to leave room for the sensors.
_HISTORY_FROM_PX = 400
_STALE_S = 1.0
_FORGET_S = 10.0
_MOST_WAITING = 10_000


class ForceDisplay(Display):
    """Live picture of readings: every sensor with its press, and the recent past.

    A sensor appears with its first reading, turns grey 1 s after its latest one, and is removed
    after 10 s. Force is shown as an arrow's length and as a number with two standard deviations.
    Readings with a flag other than ``reference`` have another colour and the flags beside them; in
    the histories they are crosses. The force of an untouched sensor is 0 N.

    The signal ``tare_requested`` is sent when the tare button is pressed. What becomes of the
    request is shown beside the button (``show_tare``).

    Parameters
    ----------
    length_mm : float
        Length of the sensors.
    force_span_n : float
        Force of the longest arrow.
    history_s : float
        Seconds of signal in the histories.
    parent : QWidget, optional
    strips_y_mm : sequence of float
        Positions of the strips of a surface, which is drawn from above.

    Raises
    ------
    InputError
        For a value that is not positive; the message names the parameter.
    RuntimeError
        When there is no QApplication.

    Examples
    --------
    >>> from PyQt5.QtWidgets import QApplication
    >>> application = QApplication.instance() or QApplication([])
    >>> display = ForceDisplay(length_mm=80.0)
    >>> display.add(Reading(0.018, "arm", 1, 4.0, 0.05, 45.0, 0.1))
    >>> display.refresh()
    >>> display.sensors()
    ['arm']
    """

    tare_requested = pyqtSignal()

    def __init__(
        self,
        length_mm: float = 80.0,
        force_span_n: float = 8.0,
        history_s: float = 20.0,
        parent: QWidget | None = None,
        strips_y_mm: Sequence[float] = (),
    ) -> None:
        sizes = {"length_mm": length_mm, "force_span_n": force_span_n, "history_s": history_s}
        for name, value in sizes.items():
            if not 0 < value < np.inf:
                raise InputError(name, "must be positive", value)
        super().__init__(_REFRESH_MS, parent)
        self._length_mm = float(length_mm)
        self._force_span_n = float(force_span_n)
        self._history_s = float(history_s)
        self._strips_y_mm = _positions(strips_y_mm)
        # Readings arrive from another thread and wait here for the next refresh.
        self._waiting: deque[Any] = deque(maxlen=_MOST_WAITING)
        self._tracks: dict[str, Track] = {}
        self._refreshes = 0
        self._tare_state: dict[str, Any] = {}
        self._warning_text = ""
        self._count = 0
        self._late: Callable[[], Iterable[Any]] | None = None
        self._build()

    def add(self, reading: Any) -> None:
        """Show a reading at the next refresh. May be called from any thread.

        Parameters
        ----------
        reading : Reading or dict
            As from the port ``readings``; unknown values may be absent, None or NaN.
        """
        self._waiting.append(reading)

    def show_tare(self, state: dict[str, Any]) -> None:
        """Show the state of a tare at the next refresh. May be called from any thread.

        Parameters
        ----------
        state : dict
            As from the port ``tare_state``: ``state``, ``reason`` and ``forced``.
        """
        self._tare_state = state

    def show_warning(self, text: str) -> None:
        """Show a sentence until a reading without flags arrives. May be called from any thread.

        Parameters
        ----------
        text : str
            As from the port ``warnings``.
        """
        self._warning_text = text

    def show_start(self) -> None:
        """Show that readings follow. May be called from any thread."""
        self._late = None

    def show_end(self, late: Callable[[], Iterable[Any]] = tuple) -> None:
        """Show that the recording has ended, and keep the last readings. Thread-safe as ``add``.

        Parameters
        ----------
        late : callable
            Gives readings that arrived since its last call; called at each refresh.
        """
        self._late = late

    def sensors(self) -> list[str]:
        """Names of the sensors shown, from top to bottom."""
        return list(self._tracks)

    def latest(self, sensor: str) -> Reading | None:
        """The reading shown for a sensor."""
        return self._tracks[sensor].latest

    def clear(self) -> None:
        """Remove everything shown."""
        self._waiting.clear()
        self._count = 0
        for name in self.sensors():
            self._forget(name)

    def refresh(self) -> None:
        """Redraw with the readings that wait; the widget's timer calls this 25 times per second."""
        now = time.monotonic()
        if self._late is not None:
            self._waiting.extend(self._late())
        while self._waiting:
            reading = as_reading(self._waiting.popleft())
            if reading is not None:
                self._count += 1
                track = self._track_of(reading)
                track.add(reading)
                track.seen_s = now
                if not reading.flags:
                    self._warning_text = ""
        for name, track in list(self._tracks.items()):
            # What a recording ends with stays.
            age = now - track.seen_s if self._late is None else 0.0
            if age > _FORGET_S:
                self._forget(name)
            else:
                track.view.show_reading(track.latest, age > _STALE_S)
        self._empty.setVisible(not self._tracks)
        self._warning.setText(self._warning_text)
        self._warning.setVisible(bool(self._warning_text))
        self._draw_tare(self._tare_state)
        self._refreshes += 1
        self._time.setText(self._progress())
        if self._refreshes % _HISTORY_EVERY == 0 and self._history.isVisible():
            self._history.draw(self._tracks.values())

    def sizeHint(self) -> QSize:
        return QSize(640, 520)

    def resizeEvent(self, event: QResizeEvent) -> None:
        self._history.setVisible(self.height() >= _HISTORY_FROM_PX)
        super().resizeEvent(event)

    def _build(self) -> None:
        palette = self.palette()
        palette.setColor(QPalette.Window, PAPER)
        self.setPalette(palette)
        self.setAutoFillBackground(True)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(6, 4, 6, 4)
        layout.setSpacing(2)
        layout.addWidget(self._build_rows(), 1)
        self._history = History(self._history_s, self._length_mm, self._force_span_n)
        layout.addWidget(self._history, 1)
        self._warning = QLabel()
        self._warning.setWordWrap(True)
        self._warning.hide()
        layout.addWidget(self._warning)
        layout.addLayout(self._build_foot())

    def _build_rows(self) -> QScrollArea:
        sensors = QWidget()
        self._rows = QVBoxLayout(sensors)
        self._rows.setContentsMargins(0, 0, 0, 0)
        self._empty = QLabel("no readings yet")
        self._empty.setAlignment(Qt.AlignCenter)
        self._rows.addWidget(self._empty)
        scroll = QScrollArea()
        scroll.setWidgetResizable(True)
        scroll.setFrameShape(QScrollArea.NoFrame)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarAlwaysOff)
        scroll.setWidget(sensors)
        return scroll

    def _build_foot(self) -> QHBoxLayout:
        self._time = QLabel()
        self._tare = QPushButton("Tare")
        self._tare.setToolTip("Measure the untouched reference again; nothing may press a sensor.")
        self._tare.clicked.connect(lambda: self.tare_requested.emit())
        foot = QHBoxLayout()
        foot.addWidget(self._time)
        foot.addStretch(1)
        self._outcome = QLabel()
        foot.addWidget(self._outcome)
        foot.addWidget(self._tare)
        return foot

    def _draw_tare(self, state: dict[str, Any]) -> None:
        measuring = state.get("state") == "measuring"
        self._tare.setText("Measuring..." if measuring else "Tare")
        self._tare.setEnabled(not measuring)
        text = tare_outcome(state)
        self._outcome.setToolTip(text)
        width = max(0, self.width() - self._time.width() - self._tare.width() - 30)
        self._outcome.setText(self._outcome.fontMetrics().elidedText(text, Qt.ElideRight, width))

    def _progress(self) -> str:
        if self._late is not None:
            return f"recording ended, {self._count} readings"
        times = [track.latest.time_s for track in self._tracks.values() if track.latest]
        return f"{max(times):.1f} s of signal" if times else ""

    def _track_of(self, reading: Reading) -> Track:
        """The track of a reading's sensor; a surface is drawn from above from its first press."""
        name, sizes = reading.sensor, (self._length_mm, self._force_span_n)
        track = self._tracks.get(name)
        if track is None:
            # The first colour that no sensor has, or the least used one.
            used = [each.color for each in self._tracks.values()]
            track = Track(self._history_s, min(SERIES, key=used.count))
            track.view = SensorView(name, track.color, *sizes)
            self._tracks[name] = track
            self._rows.addWidget(track.view)
        if isinstance(reading, SurfaceReading) and not isinstance(track.view, SurfaceView):
            view = SurfaceView(name, track.color, *sizes, self._strips_y_mm)
            self._rows.replaceWidget(track.view, view)
            track.view.deleteLater()
            track.view = view
        return track

    def _forget(self, name: str) -> None:
        track = self._tracks.pop(name)
        self._history.remove(track)
        self._rows.removeWidget(track.view)
        track.view.deleteLater()


def _positions(strips_y_mm: Sequence[float]) -> list[float]:
    """Finite numbers."""
    try:
        found = [float(y) for y in strips_y_mm]
    except (TypeError, ValueError):
        found = [np.nan]
    if not np.isfinite(found).all():
        raise InputError("strips_y_mm", "must be a list of finite numbers", strips_y_mm)
    return found
