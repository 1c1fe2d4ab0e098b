# SPDX-License-Identifier: GPL-3.0-or-later
"""Strips in a plane, the skin over them, and the law by which it spreads a press over them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
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

    from ..sensor.model import SensorModel

Array = NDArray[np.float64]

_MOST_POINTS = 200
_MOST_STRIPS = 16
_MOST_SUSPICIONS = 16  # texts in a file; `calibrate` writes four at most
_LEAST_STEP_MM = 0.01
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
    begin = "" if scope["law"] == "strips" else "begin with 0 and "
    if (begin and value[0] != 0) or any(b - a < _LEAST_STEP_MM for a, b in pairwise(value)):
        return f"must {begin}rise, by {_LEAST_STEP_MM:g} mm or more"
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
    suspicions: tuple[str, ...] | None = key(
        ListOf(of=Text(limit=1000), least=1, most=_MOST_SUSPICIONS, items="texts", optional=True),
        doc="Likely mistakes in the taps that whoever calibrated has accepted; `plan` and `read` "
        "repeat them.",
    )

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


# Share of the least calibrated force up to which an onset counts as assumed: `calibrate` assumes
# half.
_ASSUMED_ONSET = 0.501


@dataclass(frozen=True)
class Strip:
    """One strip of a surface, parallel to the x axis."""

    sensor: str
    model: SensorModel
    y_mm: float  # position across
    x_mm: float = 0.0  # where port 1 is
    reversed: bool = False  # the strip runs towards smaller x from port 1

    @property
    def ends_mm(self) -> tuple[float, float]:
        """Lower and upper end along x, in mm."""
        low, high = sorted(float(self.x_of(end)) for end in (0.0, self.model.length_mm))
        return low, high

    def x_of(self, location_mm: Array | float) -> Array | float:
        """Where a location on the strip lies along x."""
        return self.x_mm + (-location_mm if self.reversed else location_mm)

    def location_of(self, x_mm: Array | float) -> Array | float:
        """Location on the strip of a point along x."""
        return self.x_mm - x_mm if self.reversed else x_mm - self.x_mm


@dataclass(frozen=True)
class Skin:
    """Strips beneath one skin."""

    name: str
    strips: tuple[Strip, ...]  # in the order of y
    indices: tuple[int, ...]  # of each strip's sensor among those of the run
    spreading: Spreading
    frequency_hz: float  # carrier

    @property
    def y_mm(self) -> Array:
        """Positions of the strips."""
        return np.array([strip.y_mm for strip in self.strips])

    @property
    def onset_force_n(self) -> Array:
        """Force at which each strip is first shorted."""
        return np.array([strip.model.onset_force_n for strip in self.strips])

    @property
    def untouched_below_n(self) -> Array:
        """Force below which strips are untouched: onset, or least calibrated if assumed."""
        bounds = []
        for strip in self.strips:
            onset, least = strip.model.onset_force_n, strip.model.force_span_n[0]
            bounds.append(least if onset <= _ASSUMED_ONSET * least else onset)
        return np.array(bounds)

    @property
    def spacing_mm(self) -> float:
        """Median distance of neighbouring strips."""
        return float(np.median(np.diff(self.y_mm)))

    @property
    def y_span_mm(self) -> tuple[float, float]:
        """What the surface covers across: half a spacing beyond the outer strips."""
        beyond = 0.5 * self.spacing_mm
        return float(self.y_mm[0] - beyond), float(self.y_mm[-1] + beyond)

    @property
    def x_span_mm(self) -> tuple[float, float]:
        """What the surface covers along x: the calibrated span that all strips share."""
        spans = [
            sorted(float(strip.x_of(end)) for end in strip.model.location_span_mm)
            for strip in self.strips
        ]
        low, high = np.array(spans).T
        return float(low.max()), float(high.min())

    def shares(self, y_mm: Array | list[float]) -> Array:
        """Share of each strip of presses at some y; shape (..., S)."""
        y = np.asarray(y_mm, float)
        each = [self.spreading.share_of(i, y - own) for i, own in enumerate(self.y_mm)]
        return np.stack(each, axis=-1)


# Strips bear a press together, or less where it also rests on what is between them. Those of the
# tests' skin (tests/models/skin_law.py) bear 103 % at most, since it is bent upward elsewhere; the
# rest is for the errors of the strips' own calibrations.
_MOST_BORNE = 1.1
# Strips can be placed this accurately by hand; accuracy was judged with such errors
# (docs/sensors.md).
_PLACED_MM = 0.25
# Points per distance of the strips at which their shares are added up.
_PER_SPACING = 24


def borne_together(skin: Skin) -> tuple[Array, Array]:
    """y_mm and share (n,) of a press that all strips bear, from one outer strip to the other."""
    low, high = skin.y_mm[[0, -1]]
    # Steps are bounded, since strips may lie kilometres apart and two of them side by side.
    steps = min(_PER_SPACING * (high - low) / skin.spacing_mm, 1e4)
    y = np.union1d(np.linspace(low, high, int(steps) + 1), skin.y_mm)
    share: Array = skin.shares(y).sum(axis=-1)
    return y, share


def borne_too_much(skin: Skin) -> str | None:
    """The rule that a law breaks by which strips bear more than a press."""
    # Errors within two standard deviations are part of every reading's own.
    limit = _MOST_BORNE + 2 * skin.spreading.share_std
    y, share = borne_together(skin)
    most = int(share.argmax())
    if share[most] <= limit:
        return None
    return (
        f"must let all strips together bear at most {limit:.0%} of a press (110 %, and twice "
        f"share_std); at y = {y[most]:.1f} mm they bear {share[most]:.0%}"
    )


def law_violations(skin: Skin, law: Spreading) -> Iterator[str]:
    """What contradicts itself between a law and its strips: rules that are broken."""
    count = len(skin.strips)
    for of_strips in (law.strip_shares, law.location_offsets_mm, law.strip_y_mm, law.strip_sensors):
        if of_strips and len(of_strips) != count:
            rule = f"must be a law of as many strips as the surface has, {count}"
            yield f"{rule}, got {len(of_strips)}"
            return
    if law.strip_y_mm is not None:
        moved = skin.y_mm - law.strip_y_mm
        # Only distances count: where y is 0 is up to the scene.
        if np.ptp(moved) > _PLACED_MM:
            yield (
                f"must be a law of strips that lie as those of the surface do, within {_PLACED_MM} "
                f"mm (calibrate the skin again): it was calibrated with y_mm = "
                f"{_listed(law.strip_y_mm)}, got {_listed(skin.y_mm)}"
            )
    if law.strip_sensors is not None:
        names = [strip.sensor for strip in skin.strips]
        # Sensors may have got other names; those that have not must be in the same order.
        kept = [name for name in law.strip_sensors if name in names]
        if kept != [name for name in names if name in kept]:
            yield (
                "must be a law of strips in the order of those of the surface (correct y_mm, or "
                f"calibrate the skin again): along y it was calibrated with "
                f"{', '.join(law.strip_sensors)}, got {', '.join(names)}"
            )
    too_much = borne_too_much(replace(skin, spreading=law))
    if too_much:
        yield too_much


def _listed(values: Iterable[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)
