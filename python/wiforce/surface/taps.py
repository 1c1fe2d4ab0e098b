# SPDX-License-Identifier: GPL-3.0-or-later
"""Presses at known points: their table, and what strips showed of them in a file of readings."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..io.text.textfile import cell_number, read_csv, require_columns
from .calibration import REACH_SPACINGS, SurfaceTaps
from .skin import Skin

_COLUMNS = ("start_s", "end_s", "force_n", "x_mm", "y_mm")
_MOST_TAPS = 10_000


@dataclass(frozen=True)
class KnownPress:
    """A press at a known point.

    Attributes
    ----------
    start_s, end_s : float
        A time in which it was held, in s.
    force_n, x_mm, y_mm : float
    """

    start_s: float
    end_s: float
    force_n: float
    x_mm: float
    y_mm: float


def read_known_presses(path: str | Path, skin: Skin | None = None) -> list[KnownPress]:
    """Read a table of known presses.

    Parameters
    ----------
    path : str or Path
        CSV with the columns ``start_s``, ``end_s``, ``force_n``, ``x_mm`` and ``y_mm``.
    skin : Skin, optional
        The surface, on which the presses must lie.

    Raises
    ------
    InputError
        Naming file, row, rule and value.
    """
    header, rows = read_csv(path)
    require_columns(path, header, _COLUMNS)
    if len(rows) > _MOST_TAPS:
        raise InputError(path, f"must hold at most {_MOST_TAPS} presses", len(rows))
    found = []
    for line, row in rows:
        where = f"{path}: row {line}"
        press = KnownPress(**{name: cell_number(row, name, where) for name in _COLUMNS})
        if not 0 <= press.start_s < press.end_s:
            rule = "end_s must be later than start_s, and both not negative"
            raise InputError(where, rule, row["end_s"])
        if not press.force_n > 0:
            raise InputError(where, "force_n must be above 0", row["force_n"])
        if skin is not None:
            _check_place(skin, press, where)
        found.append(press)
    return found


def _check_place(skin: Skin, press: KnownPress, where: str) -> None:
    """Refuse a press that no strip can show."""
    ends = [strip.ends_mm for strip in skin.strips]
    if not any(low <= press.x_mm <= high for low, high in ends):
        low, high = min(end[0] for end in ends), max(end[1] for end in ends)
        rule = f"x_mm must lie on a strip, {low:g} to {high:g} mm"
        raise InputError(where, rule, press.x_mm)
    beyond = REACH_SPACINGS * skin.spacing_mm
    low, high = skin.y_mm[0] - beyond, skin.y_mm[-1] + beyond
    if not low <= press.y_mm <= high:
        rule = (
            f"y_mm must lie within {REACH_SPACINGS} strip distances of the strips, {low:g} to "
            f"{high:g} mm"
        )
        raise InputError(where, rule, press.y_mm)


def taps_of(
    skin: Skin, presses: Sequence[KnownPress], rows: Iterable[Mapping[str, Any]]
) -> SurfaceTaps:
    """What the strips showed of known presses.

    Returns SurfaceTaps: means over the readings of each press.

    Parameters
    ----------
    rows : iterable of mapping
        Rows of readings (``io.readings_files.ReadingsFile``). Those with a flag other than
        ``extrapolated`` and ``force-unobservable`` are left out.
    """
    names = [strip.sensor for strip in skin.strips]
    shape = len(presses), len(names)
    touched: list[list[list[tuple[float, ...]]]] = [[[] for _ in names] for _ in presses]
    untouched = np.zeros(shape, int)
    starts_s, ends_s = np.array([(press.start_s, press.end_s) for press in presses]).T
    for row in rows:
        if row["sensor"] not in names or _disturbed(row):
            continue
        strip = names.index(row["sensor"])
        for i in np.flatnonzero((starts_s <= row["time_s"]) & (row["time_s"] <= ends_s)):
            if row["touch"] == 0:
                untouched[i, strip] += 1
            shown = [row[k] for k in ("force_n", "force_std_n", "location_mm", "location_std_mm")]
            if row["touch"] == 1 and None not in shown:
                touched[i][strip].append(tuple(shown))
    mean = np.full((*shape, 4), math.nan)
    for i, of_press in enumerate(touched):
        for strip, own in enumerate(of_press):
            if len(own) > untouched[i, strip]:
                mean[i, strip] = np.mean(own, axis=0)
    x = np.empty(shape)
    for i, each in enumerate(skin.strips):
        x[:, i] = each.x_of(mean[:, i, 2])
    only = (untouched > 0) & np.isnan(mean[..., 0])
    force, along, across = np.array([(p.force_n, p.x_mm, p.y_mm) for p in presses]).T
    return SurfaceTaps(force, along, across, mean[..., 0], mean[..., 1], x, mean[..., 3], only)


def _disturbed(row: Mapping[str, Any]) -> bool:
    return bool(set(str(row["flags"] or "").split()) - {"extrapolated", "force-unobservable"})
