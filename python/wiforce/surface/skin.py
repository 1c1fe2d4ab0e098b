# SPDX-License-Identifier: GPL-3.0-or-later
"""Strips in a plane, the skin over them, and whether its law suits them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .spreading import Array, Spreading

if TYPE_CHECKING:
    from ..sensor.model import SensorModel


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
        return top / max(float(self.spreading.mean_share(0.0)), 1e-3)

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
