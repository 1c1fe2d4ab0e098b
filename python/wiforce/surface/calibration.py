# SPDX-License-Identifier: GPL-3.0-or-later
"""Surface calibration from taps: their table, the fit, and checks of the file against the scene."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..io.readings import ESTIMATES
from ..io.text.textfile import cell_number, read_csv, require_columns
from .skin import Array, Skin, Spreading

# Points of a table per distance of the strips, and how far beyond the presses it may reach.
_PER_SPACING = 3
# A law of least complexity: second differences of the shares have this standard deviation. Those
# of a plate on a foundation, at a third of a spacing, are 0.01 to 0.05.
_BEND = 0.05
# Where the noise of the strips hides what the law errs by: 2 cN of a press of 10 N, and a fifth of
# a scale division of 0.1 mm.
_LEAST_STD, _LEAST_LOCATION_MM = 0.002, 0.02
# Behind its last point a table is 0, so its end must be.
_END_STD = 0.003
_LEAST_SHARES = 6
# Two places determine a line through them, and leave none that could contradict it.
_LEAST_PLACES = 3
# A curve of its own needs the strip's share on it and on both sides, or on one side in two places.
_LEAST_PER_STRIP = 3
_FOLDS = 10
# Rounds after which untouched strips that the law contradicts have been found; three suffice.
_ROUNDS = 3
_HALVINGS = 20
# Spacings beyond which strips are not loaded; standard deviation of shares that no tap determines.
REACH_SPACINGS, _UNKNOWN = 3, 0.5


@dataclass(frozen=True)
class SurfaceTaps:
    """n presses at known points, and what S strips showed of them."""

    force_n: Array  # (n,), of each press, as ``x_mm`` and ``y_mm``
    x_mm: Array
    y_mm: Array
    # (n, S), that each strip showed; NaN where it was untouched or not received
    strip_force_n: Array
    strip_force_std_n: Array
    strip_x_mm: Array  # (n, S), location along x that it showed
    strip_x_std_mm: Array
    untouched: NDArray[np.bool_]
    # (n, S), from which half of a strip's readings during the press differ by more than this
    strip_change_n: Array

    def __len__(self) -> int:
        return len(self.force_n)


def fit_spreading(skin: Skin, taps: SurfaceTaps, law: str = "strips") -> tuple[Spreading, float]:
    """Fit a law ``strips``, ``table`` or ``gaussian``; its keys, and the rms residual of shares.

    Its standard deviations are those of taps left out in turn, less the noise of the strips; that
    of shares is not below what the readings of a tap differ by.
    """
    share = taps.strip_force_n / taps.force_n[:, None]
    noise = taps.strip_force_std_n / taps.force_n[:, None]
    shown = np.isfinite(share) & np.isfinite(noise)
    distance, count = taps.y_mm[:, None] - skin.y_mm, int(shown.sum())
    if not count:
        rule = (
            "no strip shows a press for more than half of the time from start_s to end_s: check "
            "these times, and that the readings are those of this recording"
        )
        raise InputError("taps", rule)
    if count < _LEAST_SHARES:
        rule = (
            f"must press strips {_LEAST_SHARES} times or more; a press counts once for each strip "
            "that shows it"
        )
        raise InputError("taps", rule, count)
    places = {
        "distances across from the strips": np.abs(distance[shown]),
        "values of y_mm": taps.y_mm[shown.any(axis=1)],
    }
    for name, values in places.items():
        different = len(np.unique(values.round(1)))
        if different < _LEAST_PLACES:
            rule = (
                f"must have presses at {_LEAST_PLACES} {name} or more, on strips and between them"
            )
            raise InputError("taps", rule, different)
    for strip, own in zip(skin.strips, shown.T, strict=True):
        if law == "strips" and own.sum() < _LEAST_PER_STRIP:
            rule = f"must press each strip {_LEAST_PER_STRIP} times or more, or --law table be used"
            raise InputError("taps", f"{rule}; strip '{strip.sensor}'", int(own.sum()))
    most = skin.untouched_below_n / taps.force_n[:, None]
    data = _Data(distance, np.nan_to_num(share), np.nan_to_num(noise), shown, taps.untouched, most)
    make, std = partial(_FAMILIES[law], _knots(skin.spacing_mm, data)), 0.02
    for _ in range(3):
        std = _left_out_std(make, data, std)
    keys = make(data, std)
    residual = (_expected(Spreading(**keys), data) - data.share)[shown]
    # Of the outer taps, which are never left out, only the residual is known.
    std = max(std, _excess_std(residual, data.noise[shown]))
    # Forces that change during taps err alike in all of them, which no residual shows.
    change = (taps.strip_change_n / taps.force_n[:, None])[shown]
    std = min(max(std, float(np.sqrt(np.mean(change**2)))), 1.0)
    # Of locations, which are counted from port 1.
    offsets, along = _along(taps, shown)
    offsets *= [-1.0 if strip.reversed else 1.0 for strip in skin.strips]
    found = Spreading(
        share_std=round(std, 4),
        location_std_mm=round(along, 3),
        location_offsets_mm=tuple(offsets.round(3).tolist()),
        strip_y_mm=tuple(skin.y_mm.tolist()),
        strip_sensors=tuple(strip.sensor for strip in skin.strips),
        **keys,
    )
    return found, float(np.sqrt(np.mean(residual**2)))


def _along(taps: SurfaceTaps, shown: NDArray[np.bool_]) -> tuple[Array, float]:
    """By how much each strip shows too large an x, and the standard deviation of the rest."""
    off = np.where(shown, taps.strip_x_mm - taps.x_mm[:, None], 0.0)
    count = shown.sum(axis=0)
    offsets = off.sum(axis=0) / np.maximum(count, 1)
    # Of a tap that is left out of the mean.
    rest = np.where(shown, off - offsets, 0.0) * (count / np.maximum(count - 1, 1))
    own_mm2 = np.where(shown, taps.strip_x_std_mm, 0.0) ** 2
    excess = float((rest**2 - own_mm2)[shown].mean())
    return offsets, max(excess, _LEAST_LOCATION_MM**2) ** 0.5


@dataclass(frozen=True)
class _Data:
    """Shares of n taps and S strips, (n, S), ``most`` of untouched ones; distances have a sign."""

    distance_mm: Array
    share: Array
    noise: Array
    shown: NDArray[np.bool_]
    untouched: NDArray[np.bool_]
    most: Array

    def __getitem__(self, which: Any) -> "_Data":
        """Those of some taps, and strips, as of each array."""
        return _Data(*(values[which] for values in vars(self).values()))


# Data and the standard deviation of a share, to the keys of a law.
_Make = Callable[[_Data, float], dict[str, Any]]


def _expected(law: Spreading, data: _Data) -> Array:
    strips = range(data.distance_mm.shape[1])
    return np.stack([law.share_of(i, data.distance_mm[:, i]) for i in strips], axis=-1)


def _knots(spacing_mm: float, data: _Data) -> Array:
    """Distances of a table's points, from 0 to beyond what the taps reach."""
    step = spacing_mm / _PER_SPACING
    known = np.abs(data.distance_mm)[data.shown | data.untouched]
    reach = min(float(known.max()), REACH_SPACINGS * spacing_mm) + step
    knots: Array = step * np.arange(int(np.ceil(reach / step)) + 1)
    return knots


def _table(knots: Array, data: _Data, std: float) -> dict[str, Any]:
    # The same on both sides, and so level beneath the press, and nothing at the end.
    basis = _basis(knots, np.abs(data.distance_mm), "clamped")
    bends = np.diff(np.eye(len(knots))[np.r_[1, : len(knots)]], 2, axis=0) / _BEND
    penalty = np.concatenate([bends, np.eye(len(knots))[-1:] / _END_STD])
    # What is fitted is by how much each share exceeds the next one, so that none rises.
    falls = np.triu(np.ones((len(knots), len(knots))))
    fitted = _least_squares(basis @ falls, data, std, penalty @ falls)
    points = tuple(knots.round(4).tolist())
    return {"law": "table", "distance_mm": points, "shares": _listed(falls @ fitted)}


def _strips(knots: Array, data: _Data, std: float) -> dict[str, Any]:
    knots = np.concatenate([-knots[:0:-1], knots])
    # Points that no tap determines are drawn to 0.
    bends = np.diff(np.eye(len(knots)), 2, axis=0) / _BEND
    penalty = np.concatenate([bends, np.eye(len(knots)) / _UNKNOWN])
    curves = []
    for strip in range(data.share.shape[1]):
        own = data[:, [strip]]
        basis = _basis(knots, own.distance_mm)
        curves.append(_listed(_least_squares(basis, own, std, penalty)))
    points = tuple(knots.round(4).tolist())
    return {"law": "strips", "distance_mm": points, "strip_shares": tuple(curves)}


def _gaussian(knots: Array, data: _Data, std: float) -> dict[str, Any]:
    from scipy.optimize import least_squares

    def keys(share: float, width_mm: float) -> dict[str, Any]:
        return {"law": "gaussian", "share": share, "width_mm": width_mm}

    def residuals(parameters: Array) -> Array:
        law = Spreading(**keys(*parameters))
        off = _expected(law, data) - np.where(data.shown, data.share, data.most)
        off = np.where(data.shown, off, np.maximum(off, 0) * data.untouched)
        weighted: Array = (off / np.hypot(data.noise, std)).ravel()
        return weighted

    start, bounds = [0.5, 0.8 * _PER_SPACING * knots[1]], ([0.01, 0.1], [1.0, 1000.0])
    share, width = least_squares(residuals, start, bounds=bounds).x
    # YAML holds Python's numbers, not NumPy's.
    return keys(round(float(share), 5), round(float(width), 4))


_FAMILIES = {"strips": _strips, "table": _table, "gaussian": _gaussian}


def _basis(knots: Array, distance_mm: Array, start: str = "natural") -> Array:
    """What each point of a table adds to the shares; shape (n, S, points)."""
    from scipy.interpolate import CubicSpline

    inside = np.clip(distance_mm, knots[0], knots[-1])
    found: Array = CubicSpline(knots, np.eye(len(knots)), bc_type=(start, "natural"))(inside)
    return found


def _least_squares(basis: Array, data: _Data, std: float, penalty: Array) -> Array:
    """Points of a table; untouched strips count where it would give them too much."""
    from scipy.optimize import nnls

    wanted, counts = np.where(data.shown, data.share, data.most), data.shown
    weight = 1 / np.hypot(data.noise, std)
    points: Array = np.zeros(basis.shape[-1])
    for _ in range(_ROUNDS):
        rows = np.concatenate([basis[counts] * weight[counts][:, None], penalty])
        values = np.concatenate([wanted[counts] * weight[counts], np.zeros(len(penalty))])
        points = nnls(rows, values)[0]
        counts = data.shown | (data.untouched & (basis @ points > data.most))
    return points


def _listed(shares: Array) -> tuple[float, ...]:
    return tuple(np.clip(shares, 0, 1).round(5).tolist())


def _left_out_std(make: _Make, data: _Data, std: float) -> float:
    """Error of shares whose taps are not fitted, without the noise of the strips."""
    # Taps at one y are left out together, since they determine the law there; not the outer ones,
    # beyond which nothing does.
    _, place = np.unique(data.distance_mm[:, 0].round(1), return_inverse=True)
    inner = (place > 0) & (place < place.max())
    folds = min(_FOLDS, int(place.max()) + 1)
    errors, noises = [np.zeros(0)], [np.zeros(0)]
    for fold in range(folds):
        out = inner & (place % folds == fold)
        used, left_out = data[~out], data[out]
        if used.shown.any() and left_out.shown.any():
            off = _expected(Spreading(**make(used, std)), left_out) - left_out.share
            errors.append(off[left_out.shown])
            noises.append(left_out.noise[left_out.shown])
    return _excess_std(np.concatenate(errors), np.concatenate(noises))


def _excess_std(errors: Array, noises: Array) -> float:
    """What errors lack of having their expected size, 1 in standard deviations, with this noise."""
    low, high = _LEAST_STD, 1.0
    for _ in range(_HALVINGS):
        middle = (low * high) ** 0.5
        larger = len(errors) and np.mean(errors**2 / (noises**2 + middle**2)) > 1
        low, high = (middle, high) if larger else (low, middle)
    return low


_COLUMNS = ("start_s", "end_s", "force_n", "x_mm", "y_mm")
_MOST_TAPS = 10_000


def read_taps(path: str | Path, skin: Skin, rows: Iterable[Mapping[str, Any]]) -> SurfaceTaps:
    """Presses at known points of a CSV table, and median readings of the strips during each.

    Readings with flags that make them doubtful do not count. An InputError names file and row.
    """
    header, lines = read_csv(path)
    require_columns(path, header, _COLUMNS)
    if len(lines) > _MOST_TAPS:
        raise InputError(path, f"must hold at most {_MOST_TAPS} presses", len(lines))
    presses = [_known_press(skin, f"{path}: row {line}", row) for line, row in lines]
    starts_s, ends_s, force_n, x_mm, y_mm = np.array(presses).T
    columns = "time_s", "touch", *ESTIMATES
    clear: dict[str, list[list[Any]]] = defaultdict(list)
    for row in rows:
        if not set(str(row["flags"] or "").split()) - {"extrapolated", "force-unobservable"}:
            clear[row["sensor"]].append([row[name] for name in columns])
    shape = len(presses), len(skin.strips)
    median, change = np.full((*shape, len(ESTIMATES)), math.nan), np.full(shape, math.nan)
    only, x = np.zeros(shape, bool), np.empty(shape)
    for i, strip in enumerate(skin.strips):
        readings = np.reshape(clear[strip.sensor], (-1, len(columns))).astype(float)  # None: NaN
        time_s, touch, shown = readings[:, 0], readings[:, 1], readings[:, 2:]
        touched = (touch == 1) & np.isfinite(shown).all(axis=1)
        for tap, (start_s, end_s) in enumerate(zip(starts_s, ends_s, strict=True)):
            inside = (start_s <= time_s) & (time_s <= end_s)
            groups, untouched = shown[inside & touched], int(np.sum(inside & (touch == 0)))
            # A strip that is touched for a part of the time may bear more than its onset.
            only[tap, i] = untouched and not len(groups)
            if len(groups) > untouched:
                # Unlike a mean, not that of groups in which the force rises, which have no flag.
                median[tap, i] = np.median(groups, axis=0)
                change[tap, i] = np.median(np.abs(groups[:, 0] - median[tap, i, 0]))
        x[:, i] = strip.x_of(median[:, i, 2])
    force, force_std, _, x_std = np.moveaxis(median, -1, 0)
    return SurfaceTaps(force_n, x_mm, y_mm, force, force_std, x, x_std, only, change)


def _known_press(skin: Skin, where: str, row: Mapping[str, str]) -> list[float]:
    """The numbers of a row, of a press that some strip can show."""
    numbers = [cell_number(row, name, where) for name in _COLUMNS]
    start_s, end_s, force_n, x_mm, y_mm = numbers
    ends = [strip.ends_mm for strip in skin.strips]
    first, last = min(end[0] for end in ends), max(end[1] for end in ends)
    beyond = REACH_SPACINGS * skin.spacing_mm
    low, high = skin.y_mm[0] - beyond, skin.y_mm[-1] + beyond
    for column, holds, rule in (
        ("end_s", 0 <= start_s < end_s, "must be later than start_s, and both not negative"),
        ("force_n", force_n > 0, "must be above 0"),
        (
            "x_mm",
            any(end[0] <= x_mm <= end[1] for end in ends),
            f"must lie on a strip, {first:g} to {last:g} mm",
        ),
        (
            "y_mm",
            low <= y_mm <= high,
            f"must lie within {REACH_SPACINGS} strip distances of the strips, {low:g} to "
            f"{high:g} mm",
        ),
    ):
        if not holds:
            raise InputError(where, f"{column} {rule}", float(row[column]))
    return numbers


def forces_change(taps: SurfaceTaps) -> bool:
    """Whether readings of a tap differ by more than they do of a constant force."""
    # Half of normal errors are beyond 0.67 standard deviations.
    change = taps.strip_change_n / taps.strip_force_std_n
    return bool(np.nanmean(change**2) > 1)


def surprising_taps(skin: Skin, taps: SurfaceTaps) -> list[tuple[int, int]]:
    """(press, strip) that bears more than one nearer by half a spacing: wrong positions or rows."""
    known = np.isfinite(taps.strip_force_n) | taps.untouched
    distance = np.where(known, np.abs(taps.y_mm[:, None] - skin.y_mm), np.inf)
    force = np.where(np.isfinite(taps.strip_force_n), taps.strip_force_n, 0.0)
    most, tap = force.argmax(axis=1), np.arange(len(taps))
    beyond = distance[tap, most] > distance.min(axis=1) + 0.5 * skin.spacing_mm
    found = np.flatnonzero(beyond & (force[tap, most] > 0))
    return [(int(i), int(most[i])) for i in found]
