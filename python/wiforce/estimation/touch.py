# SPDX-License-Identifier: GPL-3.0-or-later
"""Detection of touch, and of a tag that moves while the line is not touched.

The performance of the thresholds below is measured in tests/qa_estimation_touch.py: with standard
deviations of the phases from 0.02 to 5 deg the rate of false alarms is at most 1 %, and presses
from 1.2 N are detected from their first group to their last. docs/estimation.md, section
"Thresholds", states what other values cost.
"""

from __future__ import annotations

import copy
import math
from collections import deque
from typing import NamedTuple

from ..io.readings import WEAK_PHASE_DEG
from ..signal.carrier import wrapped
from .drift import DriftRate
from .groups import Array
from .tare import SlowTare
from .touch_image import TouchImage
from .unverified_reference import UnverifiedReference, distance_squared

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
# Groups before another one within a reference with which it is compared: half of the shortest
# acquisition (0.4 s), so that slow drift is not taken for a jump.
_JUMP_GROUPS = 4
# A tag that was not received for this long may have been moved or pressed meanwhile. Half of it is
# the time after which a clock is acquired again, which does not disturb the phases.
# In groups longer than this, it must have been absent from one of them.
SILENT_S = 1.0
_SILENT_GROUPS = 1.5
FORCED = "its reference was forced while it seemed to be touched"


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
        Whether the phases of the untouched sensor are uncertain: they jumped during the reference,
        which holds until the next tare; or there is an ``UnverifiedReference``.
    released : bool
        Whether the phases have returned to those of the former reference, after a tare that was
        forced during a touch. ``drift_deg`` refers to the former reference from here on.

    Examples
    --------
    >>> TouchDecision(1, False, (0.0, 0.0)).disturbed
    False
    """

    touch: int | None
    moved: bool
    drift_deg: tuple[float, float]
    disturbed: bool = False
    released: bool = False


class _ReferenceCheck:
    """Whether the phases jumped while the reference was measured."""

    def __init__(self) -> None:
        self.disturbed = False
        self._recent: deque[tuple[float, float, float, float]] = deque(maxlen=_JUMP_GROUPS)

    def add(self, phases_deg: tuple[float, float], std_deg: tuple[float, float]) -> None:
        """Compare a group of the reference with those right before it."""
        recent = list(self._recent)
        self._recent.append((*phases_deg, *std_deg))
        if not recent:
            return
        change, spreads = [], []
        for end in (0, 1):
            changes = [wrapped(phases_deg[end] - group[end]) for group in recent]
            noise = math.sqrt(sum(group[2 + end] ** 2 for group in recent)) / len(recent)
            change.append(sum(changes) / len(changes))
            spreads.append(math.hypot(std_deg[end], noise, _STATE_SPREAD_DEG))
        distance = distance_squared((change[0], change[1]), (spreads[0], spreads[1]))
        self.disturbed |= distance > _DISTURBED


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
    >>> import numpy as np
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
        self._image = TouchImage(image_deg)
        self._tare = SlowTare(group_period_s)
        self._silent_s = max(SILENT_S, _SILENT_GROUPS * group_period_s)
        self._drift = DriftRate(group_period_s, drift_deg_per_sqrt_s)
        self._untouched_s = 0.0
        self._moving = False
        # The tare before what seems to be a motion, until an untouched group confirms it.
        self._former: SlowTare | None = None
        self._reference = _ReferenceCheck()
        self._unverified: UnverifiedReference | None = None
        self._touch = 0
        self._seen_s = math.nan
        self._last_deg = (0.0, 0.0)

    def tare(self, unverified: UnverifiedReference | None = None) -> None:
        """Restart with a drift of 0, for a new reference.

        Parameters
        ----------
        unverified : UnverifiedReference, optional
            Where the sensor may have been touched during the reference.
        """
        self._tare.reset()
        self._reference = _ReferenceCheck()
        self._unverified = unverified
        self._touch, self._former = 0, None

    @property
    def touch(self) -> int:
        """Decision of the last group that could be decided."""
        return self._touch

    @property
    def reference_problem(self) -> str:
        """Why it is not known which phases are those of the untouched sensor; empty if they are."""
        if self._reference.disturbed:
            return "its phases jumped during the reference"
        return "" if self._unverified is None else self._unverified.reason

    def forced_reference(self, untouched_deg: tuple[float, float] | None) -> UnverifiedReference:
        """The reference of a tare that was forced while the sensor seemed to be touched.

        Parameters
        ----------
        untouched_deg : (float, float) or None
            Phases, against the new reference, that were untouched before; None when unknown.

        Returns
        -------
        UnverifiedReference
        """
        return UnverifiedReference(FORCED, self._image.distance, untouched_deg)

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
        if not (math.isfinite(std_deg[0]) and math.isfinite(std_deg[1])):
            return TouchDecision(None, False, self._tare.drift_deg, self.reference_problem != "")
        self._note_silence(time_s, in_reference)
        spreads = [math.hypot(std, _STATE_SPREAD_DEG) for std in std_deg]
        if max(std_deg) <= WEAK_PHASE_DEG:
            self._return_to_former(phases_deg, spreads)
        tare = self._tare
        drift = tare.drift_deg
        first, second = wrapped(phases_deg[0] - drift[0]), wrapped(phases_deg[1] - drift[1])
        untouched = (first / spreads[0]) ** 2 + (second / spreads[1]) ** 2
        # Squared standard deviations by which the changes of the ends differ.
        common = wrapped(first - second) ** 2 / (spreads[0] ** 2 + spreads[1] ** 2)
        moved = False
        if in_reference:
            self._touch = 0
            # A press within the reference shifts its mean, and with it every group of it.
            self._reference.disturbed |= untouched > _DISTURBED and common > COMMON_STDS**2
            self._reference.add(phases_deg, std_deg)
        else:
            self._touch, moved = self._decide((first, second), spreads, untouched, common)
        released = False
        if self._unverified is not None and not in_reference:
            former = self._unverified.untouched_deg
            released = self._verify(self._unverified, time_s, phases_deg, (first, second), std_deg)
            if released and former is not None and (self._touch or moved):
                # The phases of the group itself may hold the beginning of the next press.
                tare.shift((former[0] - drift[0], former[1] - drift[1]))
                self._touch, moved = 0, False
        self._last_deg = (phases_deg[0], phases_deg[1])
        if max(std_deg) > WEAK_PHASE_DEG:
            # Noise or interference: the group may be read, but is not used for the tare.
            self._moving = False
            if self._touch:
                tare.discard_newest()
            return self._decision(moved, released)
        if moved and self._moving:
            if self._former is None:
                tare.discard_newest()
                self._former = copy.deepcopy(tare)
            tare.shift((first, second))
        if self._touch or moved:
            self._drift.interrupt()
        else:
            self._former = None
            self._untouched_s = time_s
            self._drift.follow(time_s, phases_deg, std_deg)
        if self._touch:
            tare.discard_newest(touched=True)
        elif self._moving or not moved:
            tare.follow(time_s, phases_deg, std_deg)
        # A single group may be a press that began inside it; the tare moves with the second.
        self._moving = moved
        return self._decision(moved, released)

    def _decision(self, moved: bool, released: bool) -> TouchDecision:
        drift = self._tare.drift_deg
        # Two groups in which a touch ends and the next one begins look like a motion; what the tare
        # was shifted to is known only when an untouched group shows the same.
        moved |= self._touch == 1 and self._former is not None
        return TouchDecision(self._touch, moved, drift, self.reference_problem != "", released)

    def _return_to_former(self, phases_deg: tuple[float, float], spreads: list[float]) -> None:
        """Undo a motion that is not confirmed when the phases before it explain the group."""
        if self._former is None:
            return
        drift = self._former.drift_deg
        change = wrapped(phases_deg[0] - drift[0]), wrapped(phases_deg[1] - drift[1])
        untouched = distance_squared(change, (spreads[0], spreads[1])) < _EVIDENCE
        if untouched or self._image.is_within(_EVIDENCE, change, spreads):
            self._tare = copy.deepcopy(self._former)

    def _note_silence(self, time_s: float, in_reference: bool) -> None:
        """Require that the reference is verified when the tag returns after it was silent."""
        silent_s, self._seen_s = time_s - self._seen_s, time_s
        if not silent_s > self._silent_s or in_reference or self._unverified is not None:
            return
        self._unverified = UnverifiedReference(
            "it returned with other phases",
            self._image.distance,
            self._tare.drift_deg,
            groups=1,
            before_deg=self._last_deg if self._touch else None,
        )

    def _verify(
        self,
        unverified: UnverifiedReference,
        time_s: float,
        phases_deg: tuple[float, float],
        change_deg: tuple[float, float],
        std_deg: tuple[float, float],
    ) -> bool:
        """Verify the reference by a group; whether the sensor is at its former phases."""
        drift = self.drift_std_deg(time_s)
        spreads = (
            math.hypot(std_deg[0], _STATE_SPREAD_DEG, drift[0]),
            math.hypot(std_deg[1], _STATE_SPREAD_DEG, drift[1]),
        )
        if not unverified.verified_by(
            (phases_deg[0], phases_deg[1]), change_deg, spreads, self._touch
        ):
            return False
        self._unverified = None
        return unverified.released_to_former

    def drift_std_deg(self, time_s: float) -> tuple[float, float]:
        """Standard deviation of what the phases may have drifted since the last untouched group.

        It is at least the error of the tare there.

        Parameters
        ----------
        time_s : float
            Centre of a touched group.

        Returns
        -------
        (float, float)
            In degrees, for both ends.
        """
        drift = self._drift.std_deg(time_s - self._untouched_s + _TARE_AGE_S)
        error = self._tare.error_deg
        return max(drift[0], error[0]), max(drift[1], error[1])

    def _decide(
        self, change: tuple[float, float], spreads: list[float], untouched: float, common: float
    ) -> tuple[int, bool]:
        """Touch of a group, and whether the tag moved instead."""
        if self._touch:
            if untouched >= 1 and self._image.is_within(untouched + _EVIDENCE, change, spreads):
                return 1, False
        if untouched < _EVIDENCE:
            return 0, False
        if common < COMMON_STDS**2 and not self._image.is_within(
            common + _EVIDENCE, change, spreads
        ):
            return 0, True
        # Only a touch changes one phase without the other, even if the model does not contain it.
        return 1, False
