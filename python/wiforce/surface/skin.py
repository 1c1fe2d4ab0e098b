# SPDX-License-Identifier: GPL-3.0-or-later
"""Strips in a plane, and the skin over them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .spreading import Spreading

if TYPE_CHECKING:
    from ..sensor.model import SensorModel

Array = NDArray[np.float64]

# Share of the least calibrated force up to which an onset counts as assumed: `calibrate` assumes
# half.
_ASSUMED_ONSET = 0.501


@dataclass(frozen=True)
class Strip:
    """One strip of a surface, parallel to the x axis.

    Attributes
    ----------
    sensor : str
        Name of its sensor.
    model : SensorModel
    y_mm : float
        Position across.
    x_mm : float
        Where port 1 is.
    reversed : bool
        Whether the strip runs towards smaller x from port 1.
    """

    sensor: str
    model: SensorModel
    y_mm: float
    x_mm: float = 0.0
    reversed: bool = False

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
    """Strips beneath one skin.

    Attributes
    ----------
    name : str
        Of the surface.
    strips : tuple of Strip
        In the order of y.
    indices : tuple of int
        Index of each strip's sensor among those of the run.
    spreading : Spreading
    frequency_hz : float
        Carrier.
    """

    name: str
    strips: tuple[Strip, ...]
    indices: tuple[int, ...]
    spreading: Spreading
    frequency_hz: float

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
        """Force below which each strip lies where it is untouched.

        This is the onset. Where a calibration has no sweeps that start before the contact, the
        onset is assumed to be half the least calibrated force: then it is that force, since an
        onset which is too low would exclude presses that the strip does not show.
        """
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
        return float(top / max(self.spreading.share(0.0), 1e-3))

    def shares(self, y_mm: Array | list[float]) -> Array:
        """Share of each strip of presses at some y; shape (..., S)."""
        y = np.asarray(y_mm, float)
        each = [self.spreading.share_of(i, y - own) for i, own in enumerate(self.y_mm)]
        return np.stack(each, axis=-1)
