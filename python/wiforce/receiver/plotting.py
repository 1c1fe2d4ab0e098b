# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of readings over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..io.readings import Flag, Reading

if TYPE_CHECKING:
    import pandas

PANELS = 4
_LABELS = ("force (N)", "location\n(mm from port 1)", "phases psi 1, 2\n(deg)", "SNR (dB)")
_NEEDED = ("time_s", "sensor", "touch", "force_n", "location_mm")
_Rows = Sequence[Mapping[str, Any]]


def plot(
    readings: pandas.DataFrame | Iterable[Reading],
    *,
    truth: pandas.DataFrame | Iterable[Mapping[str, Any]] | None = None,
    axes: Sequence[Any] | None = None,
) -> Sequence[Any]:
    """Plot force, location, phases and SNR over time, one colour per sensor.

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

    Returns
    -------
    sequence of matplotlib Axes
        Of force, location, phases and SNR.

    Raises
    ------
    InputError
        When a column is missing, or there are not four axes.

    Examples
    --------
    >>> from matplotlib.figure import Figure
    >>> pressed = Reading(0.2, "arm", 1, 4.0, 0.1, 40.0, 0.5)
    >>> axes = plot([Reading(0.1, "arm", 0), pressed], axes=Figure().subplots(4, 1))
    >>> axes[0].containers[0].lines[0].get_ydata().tolist()
    [0.0, 4.0]
    """
    rows = _rows("readings", readings)
    if axes is None:
        from matplotlib import pyplot

        _, axes = pyplot.subplots(PANELS, 1, sharex=True, figsize=(9, 9), layout="constrained")
        axes[-1].set_xlabel("time (s)")
        for axis in axes:
            axis.grid(alpha=0.3)
    elif len(axes) != PANELS:
        raise InputError("axes", f"must be {PANELS}", len(axes))
    runs = list(dict.fromkeys((row.get("capture"), row["sensor"]) for row in rows))
    for i, (capture, sensor) in enumerate(runs):
        own = [row for row in rows if (row.get("capture"), row["sensor"]) == (capture, sensor)]
        name = sensor if capture is None else f"{capture}, {sensor}"
        _plot_sensor(axes, own, f"C{2 * i}", name if len(runs) > 1 else "reading")
        if truth is not None:
            real = [row for row in _rows("truth", truth) if row["sensor"] == sensor]
            _plot_truth(axes, real, i == 0)
    _plot_flagged(axes, rows)
    for axis, label in zip(axes, _LABELS, strict=True):
        axis.set_ylabel(label)
    axes[2].set_ylim(-185, 185)
    axes[2].set_yticks([-180, -90, 0, 90, 180])
    for axis in (axes[0], axes[2]):
        if axis.get_legend_handles_labels()[0]:
            axis.legend(loc="upper right", fontsize=8)
    return axes


def _rows(name: str, table: Any) -> _Rows:
    """Rows by the names of their columns, unknown values None or NaN, flags as one text."""
    if hasattr(table, "to_dict"):
        rows = table.to_dict("records")
    else:
        rows = [
            {**vars(row), "flags": " ".join(row.flags)} if isinstance(row, Reading) else row
            for row in table
        ]
    for column in _NEEDED if rows else ():
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


def _plot_sensor(axes: Sequence[Any], rows: _Rows, color: str, label: str) -> None:
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
            fmt=".",
            ms=4,
            lw=0.7,
            color=color,
            label=f"{label} (bars: 2 std)",
        )
    axes[2].plot(time, _column(rows, "phase1_deg"), ".", ms=3, color=color, label="psi 1")
    axes[2].plot(time, _column(rows, "phase2_deg"), "+", ms=4, color=color, label="psi 2")
    axes[3].plot(time, _column(rows, "snr_db"), ".", ms=3, color=color)


def _plot_truth(axes: Sequence[Any], rows: _Rows, labelled: bool) -> None:
    time, touched = _column(rows, "time_s"), _column(rows, "touch") == 1
    for axis, name, untouched in ((axes[0], "force_n", 0.0), (axes[1], "location_mm", np.nan)):
        values = np.where(touched, _column(rows, name), untouched)
        axis.plot(time, values, color="0.6", lw=2.5, zorder=0, label="truth" if labelled else None)


def _plot_flagged(axes: Sequence[Any], rows: _Rows) -> None:
    """Cross out flagged readings, at the edge where they lie outside the axis of all others."""
    flagged = [row for row in rows if _flagged(row)]
    time = _column(flagged, "time_s")
    for axis, values in ((axes[0], _force(flagged)), (axes[1], _column(flagged, "location_mm"))):
        known = np.isfinite(values)
        if np.any(np.isfinite(axis.dataLim.get_points())) or not np.any(known):
            limits = axis.get_ylim()
        else:  # there is no other
            limits = np.min(values[known]) - 1, np.max(values[known]) + 1
        lowest = -0.05 * limits[1] if axis is axes[0] else limits[0]
        limits = lowest, limits[1]
        if np.any(known):  # Matplotlib gives markers outside the axis no size without any
            axis.plot(
                time[known],
                np.clip(values[known], *limits),
                "x",
                ms=6,
                color="C3",
                clip_on=False,
                label="flagged",
            )
        axis.set_ylim(limits)
