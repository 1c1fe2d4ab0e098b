# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks of a surface against its spreading law, and against presses at known points."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .file import SpreadingKeys
from .skin import Skin

if TYPE_CHECKING:
    from .calibration import SurfaceTaps

Array = NDArray[np.float64]

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
    """Share of a press that all strips bear together.

    Returns y_mm and share, shape (n,): from one outer strip to the other. A press beyond
    them acts as on a lever, and may load the outer strip by more than itself.
    """
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


def law_violations(skin: Skin, law: SpreadingKeys) -> Iterator[str]:
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
    too_much = borne_too_much(replace(skin, spreading=law.spreading()))
    if too_much:
        yield too_much


def _listed(values: Iterable[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def surprising_taps(skin: Skin, taps: SurfaceTaps) -> list[tuple[int, int]]:
    """Presses, by index, that a strip farther away bears more of than the nearest one, and that
    strip.

    A skin spreads a press downward with the distance. Half a distance of the strips is allowed,
    since strips near an edge bear more. What is found is a wrong position or order of strips, or a
    wrong row of the table.
    """
    known = np.isfinite(taps.strip_force_n) | taps.untouched
    distance = np.where(known, np.abs(taps.y_mm[:, None] - skin.y_mm), np.inf)
    force = np.where(np.isfinite(taps.strip_force_n), taps.strip_force_n, 0.0)
    most, tap = force.argmax(axis=1), np.arange(len(taps))
    beyond = distance[tap, most] > distance.min(axis=1) + 0.5 * skin.spacing_mm
    found = np.flatnonzero(beyond & (force[tap, most] > 0))
    return [(int(i), int(most[i])) for i in found]
