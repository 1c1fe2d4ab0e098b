# SPDX-License-Identifier: GPL-3.0-or-later
"""Qt widget: force and location of all sensors over the last seconds."""

import numpy as np
import pyqtgraph as pg
from PyQt5.QtCore import QSize
from PyQt5.QtWidgets import QSizePolicy, QVBoxLayout, QWidget

from .style import time_plot
from .track import Track

_COLUMNS = ("force_n", "location_mm")


class History(QWidget):
    """Force and location of all sensors in two plots over the same time.

    Parameters
    ----------
    history_s : float
        Length of the time axis, in s.
    length_mm : float
        Upper limit of the location axis.
    """

    def __init__(self, history_s: float, length_mm: float) -> None:
        super().__init__()
        self._history_s = history_s
        self._force = time_plot("force (N)")
        self._force.getAxis("bottom").setStyle(showValues=False)
        self._location = time_plot("location (mm)")
        self._location.setLabel("bottom", "time (s)")
        self._location.setYRange(0, length_mm, padding=0.05)
        self._location.getAxis("left").setTickSpacing(length_mm / 4, length_mm / 4)
        self._force.setXLink(self._location)
        self._curves: dict[str, list[pg.PlotDataItem]] = {}
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
        """Draw the history of all tracks.

        Parameters
        ----------
        tracks : dict of str to Track
        colors : dict of str to str
        """
        for name in set(self._curves) - set(tracks):
            for plot, curve in zip(self._plots(), self._curves.pop(name), strict=True):
                plot.removeItem(curve)
        newest, largest = 0.0, 1.0
        for name, track in tracks.items():
            if name not in self._curves:
                pen = pg.mkPen(colors[name])
                self._curves[name] = [
                    plot.plot(pen=pen, connect="finite") for plot in self._plots()
                ]
            for curve, column in zip(self._curves[name], _COLUMNS, strict=True):
                curve.setData(*track.series(column))
            forces = track.series("force_n")[1]
            largest = max(largest, np.max(forces, initial=0.0, where=np.isfinite(forces)))
            if track.latest is not None:
                newest = max(newest, track.latest.time_s)
        self._force.setYRange(0, largest, padding=0.08)
        start = max(0.0, newest - self._history_s)
        self._location.setXRange(start, max(newest, start + 1.0), padding=0)

    def _plots(self) -> tuple[pg.PlotWidget, pg.PlotWidget]:
        return self._force, self._location
