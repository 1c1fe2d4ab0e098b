# SPDX-License-Identifier: GPL-3.0-or-later
"""The slow tare: where the phases of an untouched sensor stand now."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

# The tare looks back so far, leaves out the newest groups, and follows a drift common to both ends
# that is so many standard deviations from none over so many groups.
_MEMORY_S = 1.0
_DELAY_GROUPS = 2
_SIGNIFICANT_DRIFT = 4.0
_DRIFT_GROUPS = 8
# A group whose ends part by more than this, in standard deviations and degrees, stays out ...
_OUTLIER = 4.0
_OUTLIER_DEG = 0.3
# ... unless so many in a row say that the tare is wrong.
_OUTLIERS = 5

_Group = tuple[float, float, float, float]


class SlowTare:
    """Mean of the phases over the last second of untouched groups, with a drift that is certain.

    Groups enter some time after they came, when those behind them have proved untouched as well.

    Parameters
    ----------
    group_period_s : float

    Attributes
    ----------
    drift_deg : (float, float)
        Where both ends stand.
    """

    def __init__(self, group_period_s: float) -> None:
        length = max(_DRIFT_GROUPS, round(_MEMORY_S / group_period_s))
        # Columns time, both phases, weight; a ring, as no sum below depends on the order.
        self._untouched = np.zeros((4, length))
        self._count = self._next = 0
        self._recent: deque[_Group] = deque()
        self._outliers: list[_Group] = []
        self.drift_deg = (0.0, 0.0)

    def reset(self) -> None:
        """The phases that follow count from a new reference."""
        self.shift((-self.drift_deg[0], -self.drift_deg[1]))

    def shift(self, change_deg: tuple[float, float]) -> None:
        """The tag has moved: both ends stand elsewhere from now on."""
        self.drift_deg = (self.drift_deg[0] + change_deg[0], self.drift_deg[1] + change_deg[1])
        self._recent.clear()
        self._outliers.clear()
        self._count = self._next = 0

    def touch_begins(self, forget_outliers: bool = False) -> None:
        """Groups that have not yet proved untouched will not."""
        self._recent.clear()
        if forget_outliers:
            self._outliers.clear()

    def follow(
        self, time_s: float, phases_deg: tuple[float, float], std_deg: tuple[float, float]
    ) -> None:
        """Take an untouched group."""
        change = [
            180.0 - (180.0 - (phase - drift)) % 360.0
            for phase, drift in zip(phases_deg, self.drift_deg, strict=True)
        ]
        variance = max(std_deg[0] ** 2 + std_deg[1] ** 2, 1e-12)
        first, second = (d + c for d, c in zip(self.drift_deg, change, strict=True))
        group = (time_s, first, second, 1 / variance)
        if abs(change[0] - change[1]) > max(_OUTLIER * math.hypot(*std_deg), _OUTLIER_DEG):
            self._outliers.append(group)
            if len(self._outliers) < _OUTLIERS:
                return
            self._count = self._next = 0
            self._recent.extend(self._outliers)
        else:
            self._recent.append(group)
        self._outliers.clear()
        while len(self._recent) > _DELAY_GROUPS:
            self._untouched[:, self._next] = self._recent.popleft()
            self._next = (self._next + 1) % self._untouched.shape[1]
            self._count = min(self._count + 1, self._untouched.shape[1])
        if self._count:
            self.drift_deg = self._extrapolate(time_s)

    def _extrapolate(self, time_s: float) -> tuple[float, float]:
        """Where both ends stand now: their mean, with a drift that is beyond doubt."""
        groups = self._untouched[:, : self._count]
        weights = groups[3] / groups[3].sum()
        center, first, second = (groups[:3] @ weights).tolist()
        if self._count < _DRIFT_GROUPS:
            return first, second
        elapsed = groups[0] - center
        weighted = weights * elapsed
        moments = float(weighted @ elapsed)
        common = (groups[1] + groups[2]) / 2 - (first + second) / 2
        slope = float(weighted @ common) / moments
        residual = common - elapsed * slope
        error = math.sqrt(float(weights @ (residual * residual)) / (self._count - 2) / moments)
        if abs(slope) > _SIGNIFICANT_DRIFT * error:
            drift = slope * (time_s - center)
            return first + drift, second + drift
        return first, second
