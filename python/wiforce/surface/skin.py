# SPDX-License-Identifier: GPL-3.0-or-later
"""Strips in a plane, and the skin over them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

    from ..sensor.model import SensorModel


Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spreading:
    """Share of a press that a strip bears by distance: a monotone cubic, 0 beyond its points."""

    distance_mm: tuple[float, ...]  # rising, from 0
    shares: tuple[float, ...]  # share of the force at each distance
    share_std: float  # of a share, which is the error of this law: it enters that of every reading
    location_std_mm: float  # of the location that a strip shows of a press, against the press's own
    # By how much too far from its port 1 each strip shows a press on average; empty for nothing.
    location_offsets_mm: tuple[float, ...] = ()

    @cached_property
    def _curve(self) -> PchipInterpolator:
        from scipy.interpolate import PchipInterpolator

        # Mirrored, so that the curve is level beneath the press.
        across, share = np.array(self.distance_mm), np.array(self.shares)
        return PchipInterpolator(
            np.concatenate([-across[:0:-1], across]), np.concatenate([share[:0:-1], share])
        )

    def share(self, distance_mm: ArrayLike) -> Array:
        """Share of the force at distances of either sign from the press."""
        distance = np.abs(np.asarray(distance_mm, float))
        last = self.distance_mm[-1]
        found: Array = np.where(distance <= last, self._curve(np.minimum(distance, last)), 0.0)
        return found

    def offset_mm(self, strip: int) -> float:
        """Mean error of the location that a strip, by its index in the order of y, shows."""
        return self.location_offsets_mm[strip] if self.location_offsets_mm else 0.0

    def share_of(self, strip: int, distance_mm: ArrayLike) -> Array:
        """Share of one strip at y of the press less that of the strip; here that of any."""
        return self.share(distance_mm)


@dataclass(frozen=True)
class StripSpreading(Spreading):
    """Curves of each strip by y of the press less its own, and ``shares``, their mean."""

    of_strips: tuple[tuple[float, ...], ...] = ()

    @cached_property
    def _curves(self) -> list[PchipInterpolator]:
        from scipy.interpolate import PchipInterpolator

        return [PchipInterpolator(self.distance_mm, row) for row in (*self.of_strips, self.shares)]

    def share(self, distance_mm: ArrayLike) -> Array:
        """Mean of the strips' shares."""
        return self.share_of(-1, distance_mm)

    def share_of(self, strip: int, distance_mm: ArrayLike) -> Array:
        """Share of one strip; beyond the curve's ends that at the end."""
        distance = np.clip(distance_mm, self.distance_mm[0], self.distance_mm[-1])
        found: Array = np.asarray(self._curves[strip](distance))
        return found


# Points of a Gaussian, and its reach in widths: beyond, 1.1 % of the largest share are left.
_POINTS, _REACH = 25, 3.0


def gaussian_spreading(
    share: float, width_mm: float, share_std: float, location_std_mm: float
) -> Spreading:
    """A law that falls with the distance d from ``share`` beneath as exp(-d^2 / (2 width^2))."""
    distance = np.linspace(0.0, _REACH * width_mm, _POINTS)
    floor = np.exp(-0.5 * _REACH**2)
    shares = share * (np.exp(-0.5 * (distance / width_mm) ** 2) - floor) / (1 - floor)
    return Spreading(tuple(distance.tolist()), tuple(shares.tolist()), share_std, location_std_mm)


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

    @property
    def top_force_n(self) -> float:
        """Force that the calibration of the strips reaches wherever it is applied."""
        top = min(strip.model.force_span_n[1] for strip in self.strips)
        return top / max(float(self.spreading.share(0.0)), 1e-3)

    def shares(self, y_mm: Array | list[float]) -> Array:
        """Share of each strip of presses at some y; shape (..., S)."""
        y = np.asarray(y_mm, float)
        each = [self.spreading.share_of(i, y - own) for i, own in enumerate(self.y_mm)]
        return np.stack(each, axis=-1)
