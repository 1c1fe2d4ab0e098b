# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the line is touched, whether the tag moves, and the slow tare while it is not touched."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from ..io.readings import WEAK_PHASE_DEG
from ..signal.carrier import wrap_deg

# Spread of phases that counts as the same state however good the SNR, in degrees.
_STATE_SPREAD_DEG = 1.5
# By how much (in squared standard deviations) another state must be better to be entered.
_EVIDENCE = 12.0
# The same for a group of the untouched reference that is no such group: rarer, as it spoils a run.
_DISTURBED = 25.0
# Both ends moved alike when their difference is below this many standard deviations.
_COMMON = 3.5
# The tare looks back so far, leaves out the newest groups, and follows a drift common to both ends
# that is so many standard deviations from none over so many groups.
_TARE_S = 1.0
_TARE_DELAY_GROUPS = 2
_SIGNIFICANT_DRIFT = 4.0
_DRIFT_GROUPS = 8
# A group whose ends part by more than this, in standard deviations and degrees, stays out ...
_OUTLIER = 4.0
_OUTLIER_DEG = 0.3
# ... unless so many in a row say that the tare is wrong.
_OUTLIERS = 5
# Motion while touched: both ends turn alike, to so many per cent and by so many degrees at least,
# within so many groups, and what is read jumps to another place by so many mm or std.
_ALIKE, _LEAST_MOTION_DEG, _MOTION_GROUPS = 0.25, 1.0, 8
_JUMP_MM, _JUMP = 0.4, 4.0


@dataclass(frozen=True)
class TouchDecision:
    """One group of one sensor.

    ``touch`` is None when it can't be told; ``drift_deg`` (2,) is what the tare takes off;
    ``disturbed`` says that the reference, up to the next tare, is not that of an untouched sensor.
    """

    touch: int | None
    moved: bool
    drift_deg: np.ndarray
    disturbed: bool = False


class TouchDetector:
    """Tells touched, untouched and moved groups by where the phase changes lie.

    Untouched, both changes are zero up to a slow drift, which is tracked. Touched, they lie in the
    image of the sensor's model. When the tag or an antenna moves, both ends turn alike.

    Parameters
    ----------
    image_deg : ndarray, shape (n, 2)
        Phase changes of touched lines against the untouched one, densely over force and location.
    group_period_s : float
    """

    def __init__(self, image_deg, group_period_s):
        self._image = np.asarray(image_deg, float)
        self._recent = deque()
        self._untouched = deque(maxlen=max(_DRIFT_GROUPS, round(_TARE_S / group_period_s)))
        self._outliers = []
        self._drift = np.zeros(2)
        self._moving = False
        self._disturbed = False
        self._touch = 0

    def tare(self):
        """Forgets the drift: the phases that follow count from a new reference."""
        self._shift(-self._drift)
        self._disturbed = False
        self._touch = 0

    def update(self, time_s, phases_deg, std_deg, in_reference=False):
        """Decides one group.

        Parameters
        ----------
        time_s : float
        phases_deg : ndarray, shape (2,)
            arg R.
        std_deg : ndarray, shape (2,)
            Not finite when the tag is not there.
        in_reference : bool
            Part of the untouched reference.

        Returns
        -------
        TouchDecision
        """
        if not np.all(np.isfinite(std_deg)):
            return TouchDecision(None, False, self._drift.copy(), self._disturbed)
        change = wrap_deg(phases_deg - self._drift)
        spread = np.hypot(std_deg, _STATE_SPREAD_DEG)
        moved = False
        if in_reference:
            self._touch = 0
            # A press within the reference turns all its groups against their mean.
            apart = np.sum((change / spread) ** 2) > _DISTURBED
            self._disturbed |= bool(apart and self._common(change, spread) > _COMMON**2)
        else:
            self._touch, moved = self._decide(change, spread)
        if np.max(std_deg) > WEAK_PHASE_DEG:
            # Noise or an accident: it may be read, but the tare learns nothing from it.
            self._moving = False
            if self._touch:
                self._recent.clear()
            return TouchDecision(self._touch, moved, self._drift.copy(), self._disturbed)
        if moved and self._moving:
            self._shift(change)
        if self._touch:
            self._recent.clear()
            self._outliers.clear()
        elif self._moving or not moved:
            self._follow(time_s, phases_deg, np.asarray(std_deg))
        # One group may be a press that began inside it; the tare moves from the second on.
        self._moving = moved
        return TouchDecision(self._touch, moved, self._drift.copy(), self._disturbed)

    def _decide(self, change, spread):
        """Touch of a group, and whether both ends turned alike instead."""
        untouched = np.sum((change / spread) ** 2)
        touched = self._distance(change, spread)
        if self._touch and not (untouched + _EVIDENCE < touched or untouched < 1):
            return 1, False
        if untouched < _EVIDENCE:
            return 0, False
        common = self._common(change, spread)
        if common < _COMMON**2 and touched > common + _EVIDENCE:
            return 0, True
        # Nothing but a touch turns one end without the other, even one that no model holds.
        return 1, False

    def _common(self, change, spread):
        """Squared standard deviations by which the ends did not turn alike."""
        return wrap_deg(change[0] - change[1]) ** 2 / np.sum(spread**2)

    def _distance(self, change, spread):
        """Squared standard deviations to the nearest touch of the model."""
        turns = self._image - change
        turns -= 360 * np.rint(turns / 360)
        turns *= turns
        return (turns @ (1 / spread**2)).min()

    def _shift(self, change):
        self._drift = self._drift + change
        self._recent.clear()
        self._untouched.clear()
        self._outliers.clear()

    def _follow(self, time_s, phases_deg, std_deg):
        """Tare from groups that have proved untouched: those a little in the past."""
        change = wrap_deg(phases_deg - self._drift)
        group = (time_s, *(self._drift + change), 1 / max(std_deg @ std_deg, 1e-12))
        apart = abs(change[0] - change[1])
        if apart > max(_OUTLIER * np.hypot(*std_deg), _OUTLIER_DEG):
            self._outliers.append(group)
            if len(self._outliers) < _OUTLIERS:
                return
            self._untouched.clear()
            self._recent.extend(self._outliers)
        else:
            self._recent.append(group)
        self._outliers.clear()
        while len(self._recent) > _TARE_DELAY_GROUPS:
            self._untouched.append(self._recent.popleft())
        if self._untouched:
            self._drift = self._extrapolate(time_s)

    def _extrapolate(self, time_s):
        """Where both ends stand now: their mean, with a drift that is beyond doubt."""
        groups = np.array(self._untouched)
        times, phases, weights = groups[:, 0], groups[:, 1:3], groups[:, 3]
        weights = weights / weights.sum()
        mean = weights @ phases
        if len(times) < _DRIFT_GROUPS:
            return mean
        elapsed = times - weights @ times
        moments = weights @ elapsed**2
        common = phases.mean(axis=1) - mean.mean()
        slope = weights @ (elapsed * common) / moments
        left = common - elapsed * slope
        error = np.sqrt(weights @ left**2 / (len(times) - 2) / moments)
        if abs(slope) > _SIGNIFICANT_DRIFT * error:
            mean = mean + slope * (time_s - weights @ times)
        return mean


class TouchedMotion:
    """Tells a step of the tag while the line is touched from a change of force.

    Both turn both ends. A change of force turns the nearer end more, or in the middle of the line
    both alike where the press is; a step of the tag turns both alike, which the model takes for
    another force at another place. A press that slides turns them oppositely.
    """

    def __init__(self):
        self.forget()

    def forget(self):
        """The touch has ended."""
        self._recent = deque(maxlen=_MOTION_GROUPS)
        self._moved = self._begun = False

    def update(self, phases_deg, std_deg, location_mm, location_std_mm):
        """Takes a touched group's phases (2,) and location.

        Returns
        -------
        bool
            Whether the tag has moved since the touch began.
        """
        if not self._begun:  # the group in which a touch begins is a mixture
            self._begun = True
            return False
        group = np.array(phases_deg), np.array(std_deg), location_mm, location_std_mm
        self._moved = self._moved or any(_stepped(before, group) for before in self._recent)
        self._recent.append(group)
        return self._moved


def _stepped(before, after):
    """Whether both ends turned alike between two groups, and the press seems to jump."""
    spread = np.hypot(before[1], after[1])
    change = wrap_deg(after[0] - before[0])
    common = abs(np.mean(change))
    if common < max(_LEAST_MOTION_DEG, _COMMON * np.max(spread)):
        return False
    if abs(change[0] - change[1]) > max(_COMMON * np.hypot(*spread), _ALIKE * common):
        return False
    return abs(after[2] - before[2]) > max(_JUMP_MM, _JUMP * np.hypot(before[3], after[3]))
