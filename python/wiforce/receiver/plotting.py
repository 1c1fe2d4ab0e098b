# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of readings over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..io.files.readings_files import frame_rows
from ..io.palette import TRUTH, series_style
from ..io.readings import Flag, Reading

if TYPE_CHECKING:
    import pandas

PANELS = 4
_LABELS = ("force (N)", "location\n(mm from port 1)", "phases (deg)", "SNR (dB)")
_NEEDED = ("time_s", "sensor", "touch", "force_n", "location_mm")
_NEEDED_OF_READINGS = (*_NEEDED, "flags")
_Rows = Sequence[Mapping[str, Any]]


def plot(
    readings: pandas.DataFrame | Iterable[Reading],
    *,
    truth: pandas.DataFrame | Iterable[Mapping[str, Any]] | None = None,
    axes: Sequence[Any] | None = None,
    length_mm: float | None = None,
) -> Sequence[Any]:
    """Plot force, location, phases and SNR over time, one colour and marker per sensor.

    Readings with a flag other than ``reference`` are crossed out and do not widen the axes. The
    force of an untouched sensor is drawn as 0.

    Parameters
    ----------
    readings : DataFrame or iterable of Reading
        As :func:`read` returns them.
    truth : DataFrame or iterable of mapping, optional
        Rows of the truth file of a simulated capture, drawn as grey lines.
    axes : sequence of four matplotlib Axes, optional
        A new figure of pyplot by default.
    length_mm : float, optional
        Length of the sensors: the location axis shows all of it. By default that of the scene where
        :func:`read` made the readings, else the largest location.

    Returns
    -------
    sequence of matplotlib Axes
        Of force, location, phases and SNR.

    Raises
    ------
    InputError
        When there is no table, a column is missing, or there are not four axes.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> pressed = Reading(0.2, "arm", 1, 4.0, 0.1, 40.0, 0.5)
    >>> axes = plot([Reading(0.1, "arm", 0), pressed], axes=Figure().subplots(4, 1))
    >>> axes[0].containers[0].lines[0].get_ydata().tolist()
    [0.0, 4.0]
    """
    rows = _rows("readings", readings, _NEEDED_OF_READINGS)
    if axes is None:
        from matplotlib import pyplot

        _, axes = pyplot.subplots(PANELS, 1, sharex=True, figsize=(9, 9), layout="constrained")
        axes[-1].set_xlabel("time (s)")
        for axis in axes:
            axis.grid(alpha=0.3)
    elif len(axes) != PANELS:
        raise InputError("axes", f"must be {PANELS}", len(axes))
    if length_mm is None:
        length_mm = getattr(readings, "attrs", {}).get("length_mm")
    runs = list(dict.fromkeys((row.get("capture"), row["sensor"]) for row in rows))
    flagged = []
    for i, (capture, sensor) in enumerate(runs):
        own = [row for row in rows if (row.get("capture"), row["sensor"]) == (capture, sensor)]
        name = sensor if capture is None else f"{capture}, {sensor}"
        _plot_sensor(axes, own, series_style(i), name if len(runs) > 1 else "reading")
        label = f"{name}, flagged" if len(runs) > 1 else "flagged"
        flagged.append((label, [row for row in own if _flagged(row)]))
        if truth is not None:
            real = [row for row in _rows("truth", truth, _NEEDED) if row["sensor"] == sensor]
            _plot_truth(axes, real, i == 0)
    _plot_flagged(axes, flagged)
    axes[1].set_ylim(bottom=0, top=length_mm)
    for axis, label in zip(axes, _LABELS, strict=True):
        axis.set_ylabel(label)
    axes[2].set_ylim(-185, 185)
    axes[2].set_yticks([-180, -90, 0, 90, 180])
    for axis in (axes[0], axes[2]):
        if axis.get_legend_handles_labels()[0]:
            legend_beside(axis)
    return axes


def legend_beside(axis: Any) -> None:
    """Add a legend to the right of an axis, where it hides nothing."""
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), fontsize=10)


def _rows(name: str, table: Any, needed: Sequence[str]) -> _Rows:
    """Rows by the names of their columns, unknown values None or NaN, flags as one text."""
    if hasattr(table, "columns"):
        rows = frame_rows(table)
    else:
        rows = [
            {**vars(row), "flags": " ".join(row.flags)} if isinstance(row, Reading) else row
            for row in table
        ]
        if not all(isinstance(row, Mapping) for row in rows):
            raise InputError(
                name, "must be a pandas frame or a list of its rows", type(table).__name__
            )
    for column in needed if rows else ():
        if column not in rows[0]:
            raise InputError(name, f"must have the column {column}; found {', '.join(rows[0])}")
    return rows


def _flagged(row: Mapping[str, Any]) -> bool:
    return bool(set((row.get("flags") or "").split()) - {Flag.REFERENCE.word})


def _column(rows: _Rows, name: str) -> np.ndarray:
    values = [row.get(name) for row in rows]
    return np.array([np.nan if v is None else v for v in values], float)


def _force(rows: _Rows) -> np.ndarray:
    """Forces, 0 N while untouched."""
    return np.where(_column(rows, "touch") == 0, 0.0, _column(rows, "force_n"))


def _plot_sensor(axes: Sequence[Any], rows: _Rows, style: Mapping[str, str], label: str) -> None:
    """The values of readings without a warning, and the phases and SNR of all of them."""
    time = _column(rows, "time_s")
    reliable = [row for row in rows if not _flagged(row)]
    for axis, values, std in (
        (axes[0], _force(reliable), "force_std_n"),
        (axes[1], _column(reliable, "location_mm"), "location_std_mm"),
    ):
        known = np.isfinite(values)  # of rows without values Matplotlib warns
        axis.errorbar(
            _column(reliable, "time_s")[known],
            values[known],
            2 * np.nan_to_num(_column(reliable, std)[known]),
            ls="",
            ms=2.5,
            lw=0.7,
            label=f"{label} (bars: 2 std)",
            **style,
        )
    for end, face in ((1, style["color"]), (2, "none")):
        phases = _column(rows, f"phase{end}_deg")
        name = f"{label}, psi {end}"
        axes[2].plot(time, phases, ls="", ms=2.5, mfc=face, mew=0.6, label=name, **style)
    axes[3].plot(time, _column(rows, "snr_db"), ls="", ms=2.5, **style)


def _plot_truth(axes: Sequence[Any], rows: _Rows, labelled: bool) -> None:
    time, touched = _column(rows, "time_s"), _column(rows, "touch") == 1
    for axis, name, untouched in ((axes[0], "force_n", 0.0), (axes[1], "location_mm", np.nan)):
        values = np.where(touched, _column(rows, name), untouched)
        axis.plot(time, values, color=TRUTH, lw=3, zorder=0, label="truth" if labelled else None)


def _plot_flagged(axes: Sequence[Any], flagged: Sequence[tuple[str, _Rows]]) -> None:
    """Cross out flagged readings, on the axes of all others where there are others."""
    for axis, column in ((axes[0], _force), (axes[1], partial(_column, name="location_mm"))):
        limits = axis.get_ylim() if np.any(np.isfinite(axis.dataLim.get_points())) else None
        for number, (label, rows) in enumerate(flagged):
            own = column(rows)
            known = np.isfinite(own)
            if np.any(known):
                axis.plot(
                    _column(rows, "time_s")[known],
                    own[known],
                    "x",
                    ms=6,
                    color=series_style(number)["color"],
                    label=label,
                )
        axis.set_ylim(limits)
