# SPDX-License-Identifier: GPL-3.0-or-later
"""How a skin spreads a press over its strips: the law, in scene files and in files of its own."""

from __future__ import annotations

from functools import cached_property
from itertools import accumulate, pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..io.text.schema import ListOf, declared, key, plain, read
from ..io.text.textfile import read_yaml, write_yaml
from ..io.text.values import Choice, KeyPath, Number, Scope, Text

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

Array = NDArray[np.float64]

_MOST_POINTS = 200
_MOST_STRIPS = 16
LEAST_STEP_MM = 0.01
_POSITION_MM = 10_000
# Shares of a table that was calibrated by earlier versions may rise by their noise.
_MOST_RISE = 0.05
# Points of a Gaussian, and its reach in widths: beyond, 1.1 % of the largest share are left.
_POINTS, _REACH = 25, 3.0
# What is assumed of a law that was not calibrated: two laws with the same share beneath the press
# and the same width differ by so much (docs/sensors.md).
_SHARE_STD, _LOCATION_STD_MM = 0.04, 0.5


def _numbers(low: float, high: float, optional: bool = True) -> ListOf:
    limits = f"numbers from {low:g} to {high:g}"
    of = Number(low=low, high=high)
    return ListOf(of=of, least=2, most=_MOST_POINTS, items=limits, optional=optional)


_SHARES = _numbers(0, 1, optional=False)


def _unused(law: str) -> str:
    """The rule that a key breaks which this law does not have."""
    return f"must be left out, the law '{law}' does not have it"


def _check_gaussian(value: float | None, scope: Scope) -> str | None:
    if scope["law"] != "gaussian":
        return None if value is None else _unused(scope["law"])
    return "is missing, a gaussian law needs share and width_mm" if value is None else None


def _check_distances(value: tuple[float, ...] | None, scope: Scope) -> str | None:
    if scope["law"] == "gaussian":
        return None if value is None else _unused("gaussian")
    if value is None:
        return "is missing, a table needs distance_mm and shares or strip_shares"
    if scope["law"] == "strips":
        rising = all(b - a >= LEAST_STEP_MM for a, b in pairwise(value))
        return None if rising else f"must rise, by {LEAST_STEP_MM:g} mm or more"
    if value[0] != 0 or any(b - a < LEAST_STEP_MM for a, b in pairwise(value)):
        return f"must begin with 0 and rise, by {LEAST_STEP_MM:g} mm or more"
    return None


def _check_shares(value: tuple[float, ...] | None, scope: Scope) -> str | None:
    if scope["law"] != "table":
        return None if value is None else _unused(scope["law"])
    if value is None:
        return "is missing, a table needs distance_mm and shares"
    if len(value) != len(scope["distance_mm"]):
        return f"must have as many numbers as distance_mm, {len(scope['distance_mm'])}"
    if not value[0] > 0:
        return "must begin with a share above 0"
    if any(b > a + _MOST_RISE for a, b in zip(accumulate(value, min), value, strict=True)):
        return f"must not rise with the distance, by more than {_MOST_RISE:g}"
    return None


def _check_curves(value: tuple[tuple[float, ...], ...] | None, scope: Scope) -> str | None:
    if scope["law"] != "strips":
        return None if value is None else _unused(scope["law"])
    if value is None:
        return "is missing, the law of single strips needs distance_mm and strip_shares"
    points = len(scope["distance_mm"])
    if any(len(row) != points or not max(row) > 0 for row in value):
        return f"must have as many numbers as distance_mm for each strip, {points}, not all 0"
    return None


@declared
class Spreading:
    """How the skin spreads a press over the strips: the share of it that each of them bears.

    By y of the press less that of the strip, a monotone cubic through the points.
    """

    law: str = key(
        Choice(words=("gaussian", "table", "strips")),
        default="gaussian",
        doc="`gaussian`: the share falls with the distance across as a Gaussian. `table`: by the "
        "points in `distance_mm` and `shares`. `strips`: likewise, each strip by its own "
        "`strip_shares`. `calibrate --surface` writes all three.",
    )
    share: float | None = key(
        Number(low=0, above=True, high=1, optional=True),
        check=_check_gaussian,
        doc="Gaussian: share of a press that the strip right beneath it bears.",
    )
    width_mm: float | None = key(
        Number(unit="mm", low=0.1, high=1000, optional=True),
        check=_check_gaussian,
        doc="Gaussian: distance at which the share has fallen to 61 %.",
    )
    distance_mm: tuple[float, ...] | None = key(
        _numbers(-1000, 1000),
        check=_check_distances,
        doc="Table: distances across from the press, rising from 0; behind the last one a strip "
        "bears nothing. Strips: y of a press less that of the strip, rising.",
    )
    shares: tuple[float, ...] | None = key(
        _numbers(0, 1),
        check=_check_shares,
        doc="Table: share of the press at each distance.",
    )
    strip_shares: tuple[tuple[float, ...], ...] | None = key(
        ListOf(
            of=_SHARES,
            least=2,
            most=_MOST_STRIPS,
            items=f"lists, each {_SHARES.allowed}",
            optional=True,
        ),
        check=_check_curves,
        doc="Strips: for each, in the order of y, its share at each distance.",
    )
    share_std: float = key(
        Number(low=0.001, high=1),
        default=_SHARE_STD,
        doc="Standard deviation of the shares: the error of this law, which enters that of every "
        "reading.",
    )
    location_std_mm: float = key(
        Number(unit="mm", low=0.01, high=100),
        default=_LOCATION_STD_MM,
        doc="Standard deviation of the location that a strip shows, against that of the press.",
    )
    location_offsets_mm: tuple[float, ...] | None = key(
        _numbers(-100, 100),
        doc="For each strip, in the order of y, by how much farther from its port 1 it shows a "
        "press than this is: the error of where port 1 is.",
    )
    strip_y_mm: tuple[float, ...] | None = key(
        _numbers(-_POSITION_MM, _POSITION_MM),
        doc="Positions across of the strips that the law was calibrated with, rising. A scene with "
        "other distances of its strips is refused. Without it, nothing is compared.",
    )
    strip_sensors: tuple[str, ...] | None = key(
        ListOf(of=Text(limit=64), least=2, most=_MOST_STRIPS, items="names", optional=True),
        doc="Their sensors, in the order of y. Where the scene has them in another order, it is "
        "refused.",
    )
    source: str | None = key(Text(limit=1000, optional=True), doc="Where the law comes from.")

    @cached_property
    def _curves(self) -> list[PchipInterpolator]:
        """The curve of each strip, or the one of all."""
        from scipy.interpolate import PchipInterpolator

        if self.strip_shares is not None:
            return [PchipInterpolator(self.distance_mm, row) for row in self.strip_shares]
        if self.share is not None and self.width_mm is not None:
            across, floor = np.linspace(0.0, _REACH, _POINTS), np.exp(-0.5 * _REACH**2)
            shares = self.share * (np.exp(-0.5 * across**2) - floor) / (1 - floor)
            across = self.width_mm * across
        else:
            across, shares = np.array(self.distance_mm), np.array(self.shares)
        # Mirrored, so that the curve is level beneath the press.
        points = np.concatenate([-across[:0:-1], across]), np.concatenate([shares[:0:-1], shares])
        return [PchipInterpolator(*points)]

    def share_of(self, strip: int, distance_mm: ArrayLike) -> Array:
        """Share of a strip, by its index in the order of y, at y of the press less its own.

        Beyond the points 0, or that at the end for a law of single strips.
        """
        curve, distance = self._curves[strip % len(self._curves)], np.asarray(distance_mm, float)
        inside = np.clip(distance, curve.x[0], curve.x[-1])
        bears = (inside == distance) | (self.law == "strips")
        found: Array = np.where(bears, curve(inside), 0.0)
        return found

    def mean_share(self, distance_mm: ArrayLike) -> Array:
        """Mean share of the strips at a distance from the press."""
        each = [self.share_of(i, distance_mm) for i in range(len(self._curves))]
        return np.asarray(np.mean(each, axis=0))

    def offset_mm(self, strip: int) -> float:
        """Mean error of the location that a strip, by its index in the order of y, shows."""
        return self.location_offsets_mm[strip] if self.location_offsets_mm else 0.0


def read_spreading(path: str | Path) -> Spreading:
    """Read the file of a spreading law."""
    return read(Spreading, read_yaml(path), KeyPath(str(path)))


def write_spreading(law: Spreading, path: str | Path) -> None:
    """Write the file of a spreading law, or refuse it where it could not be read again."""
    values = {name: value for name, value in plain(Spreading, law).items() if value is not None}
    read(Spreading, values, KeyPath(str(path)))
    write_yaml(path, values)
