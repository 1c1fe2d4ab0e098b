# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the line is touched, whether the tag moves, and the slow tare while it is not touched.

What the limits below achieve is measured in tests/qa_estimation_touch.py: at standard deviations
of the phases from 0.02 to 5 deg at most one untouched group in a hundred is taken for a touch, and
presses from 1.2 N on are seen from their first group to their last.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..io.readings import WEAK_PHASE_DEG
from .groups import Array
from .tare import SlowTare

# Spread of phases that counts as the same state however good the SNR, in degrees.
_STATE_SPREAD_DEG = 1.5
# By how much (in squared standard deviations) another state must be better to be entered.
_EVIDENCE = 12.0
# The same for a group of the untouched reference that is no such group: rarer, as it spoils a run.
_DISTURBED = 25.0
# Both ends moved alike when their difference is below this many standard deviations.
COMMON = 3.5


def wrapped(angle: float) -> float:
    """A single angle in (-180, 180] deg; ``signal.carrier.wrap_deg`` does arrays."""
    return 180.0 - (180.0 - angle) % 360.0


class TouchDecision(NamedTuple):
    """One group of one sensor.

    ``touch`` is None when it is unknown; ``drift_deg`` (2,) is what the tare takes off;
    ``disturbed`` says that the reference, up to the next tare, is not that of an untouched sensor.
    """

    touch: int | None
    moved: bool
    drift_deg: tuple[float, float]
    disturbed: bool = False


class TouchDetector:
    """Tells touched, untouched and moved groups apart by where the phase changes lie.

    Untouched, both changes are zero up to a slow drift, which is tracked. Touched, they lie in the
    image of the sensor's model. When the tag or an antenna moves, both ends turn alike.

    Parameters
    ----------
    image_deg : ndarray, shape (n, 2)
        Phase changes of touched lines against the untouched one, densely over force and location.
    group_period_s : float

    Examples
    --------
    >>> detector = TouchDetector(np.array([[40.0, 10.0]]), 0.036)
    >>> detector.update(0.018, (0.1, -0.1), (0.05, 0.05)).touch
    0
    >>> detector.update(0.054, (39.0, 11.0), (0.05, 0.05)).touch
    1
    """

    def __init__(self, image_deg: Array, group_period_s: float) -> None:
        self._image = np.ascontiguousarray(np.asarray(image_deg, float).T)
        self._nearest = (float(self._image[0, 0]), float(self._image[1, 0]))
        self._tare = SlowTare(group_period_s)
        self._moving = False
        self._disturbed = False
        self._touch = 0

    def tare(self) -> None:
        """Forget the drift: the phases that follow count from a new reference."""
        self._tare.reset()
        self._disturbed = False
        self._touch = 0

    def update(
        self,
        time_s: float,
        phases_deg: tuple[float, float],
        std_deg: tuple[float, float],
        in_reference: bool = False,
    ) -> TouchDecision:
        """Decide one group.

        Parameters
        ----------
        time_s : float
        phases_deg : pair of float
            arg R of both ends.
        std_deg : pair of float
            Not finite when the tag is not there.
        in_reference : bool
            Part of the untouched reference.

        Returns
        -------
        TouchDecision
        """
        tare = self._tare
        if not (math.isfinite(std_deg[0]) and math.isfinite(std_deg[1])):
            return TouchDecision(None, False, tare.drift_deg, self._disturbed)
        first, second = (
            wrapped(phase - drift) for phase, drift in zip(phases_deg, tare.drift_deg, strict=True)
        )
        spreads = [math.hypot(std, _STATE_SPREAD_DEG) for std in std_deg]
        untouched = (first / spreads[0]) ** 2 + (second / spreads[1]) ** 2
        # Squared standard deviations by which the ends did not turn alike.
        common = wrapped(first - second) ** 2 / (spreads[0] ** 2 + spreads[1] ** 2)
        moved = False
        if in_reference:
            self._touch = 0
            # A press within the reference turns all its groups against their mean.
            self._disturbed |= untouched > _DISTURBED and common > COMMON**2
        else:
            self._touch, moved = self._decide((first, second), spreads, untouched, common)
        if max(std_deg) > WEAK_PHASE_DEG:
            # Noise or an accident: it may be read, but the tare learns nothing from it.
            self._moving = False
            if self._touch:
                tare.touch_begins()
            return TouchDecision(self._touch, moved, tare.drift_deg, self._disturbed)
        if moved and self._moving:
            tare.shift((first, second))
        if self._touch:
            tare.touch_begins(forget_outliers=True)
        elif self._moving or not moved:
            tare.follow(time_s, phases_deg, std_deg)
        # One group may be a press that began inside it; the tare moves from the second on.
        self._moving = moved
        return TouchDecision(self._touch, moved, tare.drift_deg, self._disturbed)

    def _decide(
        self, change: tuple[float, float], spreads: list[float], untouched: float, common: float
    ) -> tuple[int, bool]:
        """Touch of a group, and whether both ends turned alike instead."""
        if self._touch:
            if untouched >= 1 and self._is_within(untouched + _EVIDENCE, change, spreads):
                return 1, False
        if untouched < _EVIDENCE:
            return 0, False
        if common < COMMON**2 and not self._is_within(common + _EVIDENCE, change, spreads):
            return 0, True
        # Nothing but a touch turns one end without the other, even one that no model holds.
        return 1, False

    def _is_within(self, limit: float, change: tuple[float, float], spreads: list[float]) -> bool:
        """Whether a touch of the model lies within so many squared standard deviations."""
        distance = sum(
            (wrapped(place - value) / spread) ** 2
            for place, value, spread in zip(self._nearest, change, spreads, strict=True)
        )
        if distance <= limit:  # the nearest one of the group before is near enough, as it mostly is
            return True
        apart = self._image - np.array(change)[:, None]
        apart -= 360 * np.rint(apart / 360)
        apart /= np.array(spreads)[:, None]
        distances = (apart * apart).sum(axis=0)
        best = int(np.argmin(distances))
        self._nearest = (float(self._image[0, best]), float(self._image[1, best]))
        return float(distances[best]) <= limit
