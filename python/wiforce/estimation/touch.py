# SPDX-License-Identifier: GPL-3.0-or-later
"""Detection of touch, and of a tag that moves while the line is not touched.

The performance of the thresholds below is measured in tests/qa_estimation_touch.py: with standard
deviations of the phases from 0.02 to 5 deg the rate of false alarms is at most 1 %, and presses
from 1.2 N are detected from their first group to their last. docs/estimation.md, section
"Thresholds", states what other values cost.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..io.readings import WEAK_PHASE_DEG
from .drift import DriftRate
from .groups import Array
from .tare import SlowTare

# Systematic spread of the phases within a state, in degrees, added to the noise.
_STATE_SPREAD_DEG = 1.5
# Squared standard deviations by which another state must fit better to be entered. Noise exceeds
# chi-square 12 of two phases in 0.25 % of groups, and 25 in 4 of a million: a disturbed reference
# affects a whole run.
_EVIDENCE = 12.0
_DISTURBED = 25.0
# Both ends changed equally when their difference is below this many standard deviations, which
# noise alone exceeds in 0.05 % of groups.
COMMON_STDS = 3.5
# Mean age of the groups that the tare averages over, in s.
_TARE_AGE_S = 0.5


def wrapped(angle: float) -> float:
    """Wrap a single angle to (-180, 180] deg, faster than ``signal.carrier.wrap_deg`` for arrays.

    Parameters
    ----------
    angle : float
        In degrees.

    Returns
    -------
    float

    Examples
    --------
    >>> wrapped(190.0), wrapped(-180.0)
    (-170.0, 180.0)
    """
    return 180.0 - (180.0 - angle) % 360.0


class TouchDecision(NamedTuple):
    """Touch decision of one group and sensor.

    Attributes
    ----------
    touch : int or None
        1, 0, or None when it is unknown.
    moved : bool
        Whether the tag has moved.
    drift_deg : (float, float)
        Drift of both phases that the tare subtracts, in degrees.
    disturbed : bool
        Whether the sensor was touched during its reference; holds until the next tare.

    Examples
    --------
    >>> TouchDecision(1, False, (0.0, 0.0)).disturbed
    False
    """

    touch: int | None
    moved: bool
    drift_deg: tuple[float, float]
    disturbed: bool = False


class TouchDetector:
    """Classifies groups as touched, untouched or moved by the phase changes of both ends.

    Both changes of an untouched sensor are zero except for a slow drift, which is tracked. Those of
    a touched one lie in the image of the sensor's model. A motion of the tag or an antenna changes
    both phases equally.

    Parameters
    ----------
    image_deg : ndarray, shape (n, 2)
        Phase changes of touched lines against the untouched one, densely over force and location.
    group_period_s : float
        Length of a group, in s.
    drift_deg_per_sqrt_s : float, optional
        Stated random walk of the untouched phases; learned when not given.

    Examples
    --------
    >>> detector = TouchDetector(np.array([[40.0, 10.0]]), 0.036)
    >>> detector.update(0.018, (0.1, -0.1), (0.05, 0.05)).touch
    0
    >>> detector.update(0.054, (39.0, 11.0), (0.05, 0.05)).touch
    1
    """

    def __init__(
        self,
        image_deg: Array,
        group_period_s: float,
        drift_deg_per_sqrt_s: float | None = None,
    ) -> None:
        self._image = np.ascontiguousarray(np.asarray(image_deg, float).T)
        self._nearest = (float(self._image[0, 0]), float(self._image[1, 0]))
        self._tare = SlowTare(group_period_s)
        self._drift = DriftRate(group_period_s, drift_deg_per_sqrt_s)
        self._untouched_s = 0.0
        self._moving = False
        self._disturbed = False
        self._touch = 0

    def tare(self) -> None:
        """Restart with a drift of 0, for a new reference."""
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
            Centre of the group.
        phases_deg : pair of float
            arg R of both ends, in degrees.
        std_deg : pair of float
            Their standard deviations; not finite when the tag was not received.
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
        # Squared standard deviations by which the changes of the ends differ.
        common = wrapped(first - second) ** 2 / (spreads[0] ** 2 + spreads[1] ** 2)
        moved = False
        if in_reference:
            self._touch = 0
            # A press within the reference shifts its mean, and with it every group of it.
            self._disturbed |= untouched > _DISTURBED and common > COMMON_STDS**2
        else:
            self._touch, moved = self._decide((first, second), spreads, untouched, common)
        if max(std_deg) > WEAK_PHASE_DEG:
            # Noise or interference: the group may be read, but is not used for the tare.
            self._moving = False
            if self._touch:
                tare.touch_begins()
            return TouchDecision(self._touch, moved, tare.drift_deg, self._disturbed)
        if moved and self._moving:
            tare.shift((first, second))
        if self._touch or moved:
            self._drift.interrupt()
        else:
            self._untouched_s = time_s
            self._drift.follow(time_s, phases_deg, std_deg)
        if self._touch:
            tare.touch_begins(forget_outliers=True)
        elif self._moving or not moved:
            tare.follow(time_s, phases_deg, std_deg)
        # A single group may be a press that began inside it; the tare moves with the second.
        self._moving = moved
        return TouchDecision(self._touch, moved, tare.drift_deg, self._disturbed)

    def drift_std_deg(self, time_s: float) -> tuple[float, float]:
        """Standard deviation of what the phases may have drifted since the last untouched group.

        Parameters
        ----------
        time_s : float
            Centre of a touched group.

        Returns
        -------
        (float, float)
            In degrees, for both ends.
        """
        return self._drift.std_deg(time_s - self._untouched_s + _TARE_AGE_S)

    def _decide(
        self, change: tuple[float, float], spreads: list[float], untouched: float, common: float
    ) -> tuple[int, bool]:
        """Touch of a group, and whether the tag moved instead."""
        if self._touch:
            if untouched >= 1 and self._is_within(untouched + _EVIDENCE, change, spreads):
                return 1, False
        if untouched < _EVIDENCE:
            return 0, False
        if common < COMMON_STDS**2 and not self._is_within(common + _EVIDENCE, change, spreads):
            return 0, True
        # Only a touch changes one phase without the other, even if the model does not contain it.
        return 1, False

    def _is_within(self, limit: float, change: tuple[float, float], spreads: list[float]) -> bool:
        """Whether a touch of the model lies within ``limit`` squared standard deviations."""
        distance = sum(
            (wrapped(point - value) / spread) ** 2
            for point, value, spread in zip(self._nearest, change, spreads, strict=True)
        )
        if distance <= limit:  # usually the nearest point of the previous group suffices
            return True
        apart = self._image - np.array(change)[:, None]
        apart -= 360 * np.rint(apart / 360)
        apart /= np.array(spreads)[:, None]
        distances = (apart * apart).sum(axis=0)
        best = int(np.argmin(distances))
        self._nearest = (float(self._image[0, best]), float(self._image[1, best]))
        return float(distances[best]) <= limit
