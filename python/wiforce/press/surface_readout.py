# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of a surface from the phases and flags of its strips."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..estimation.groups import Array, Groups
from ..io.readings import DOUBTED, WEAK_FORCE_N, WEAK_PHASE_DEG, Flag, SurfaceReading, flag_words

if TYPE_CHECKING:
    from ..surface.estimator import SurfaceEstimator, SurfaceFound

# A strip with one of these flags shows phases that its force and location do not explain.
_LEFT_OUT = (DOUBTED & ~(Flag.REFERENCE | Flag.GAP | Flag.TRANSITION)).value
# What concerns a press on the surface, whichever strip it is found on.
_OF_ANY = DOUBTED.value
# What concerns it where the strip bears most of it.
_OF_MAIN = (Flag.EXTRAPOLATED | Flag.FORCE_UNOBSERVABLE).value


class SurfaceReadout:
    """Gives the readings of a surface, group by group; ``names`` has one per press."""

    def __init__(self, estimator: SurfaceEstimator, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._estimator = estimator
        self._strips = list(estimator.skin.indices)

    def read(self, groups: Groups, times_s: Sequence[float]) -> list[list[SurfaceReading]]:
        """Readings of a batch with all flags of the sensors: for each group one per name."""
        strips = self._strips
        of_strips, touch = groups.flags[:, strips], groups.touch[:, strips]
        std = groups.psi_std_deg[:, strips]
        usable = (touch >= 0) & ((of_strips & _LEFT_OUT) == 0)
        found = self._estimator.read(groups.phases_deg[:, strips], std, usable, touch == 1)
        common = _any(of_strips & _OF_ANY)
        poor = (usable & (std.max(axis=-1) > WEAK_PHASE_DEG)) | ~usable
        common |= _any(of_strips & Flag.WEAK.value & -poor.astype(int))
        flags = self._flags(found, of_strips, common)
        of_groups = zip(times_s, groups.index.tolist(), groups.interference.tolist(), strict=True)
        return [
            [
                self._reading(found, row, press, time_s, flags, index, share)
                for press in range(len(self.names))
            ]
            for row, (time_s, index, share) in enumerate(of_groups)
        ]

    @staticmethod
    def _flags(found: SurfaceFound, of_strips: Array, common: Array) -> Array:
        """Flags of each press; shape (G, P)."""
        flags = np.repeat(common[:, None], found.touch.shape[1], axis=1)
        flags[found.inconsistent] |= Flag.INCONSISTENT.value
        touched = found.touch == 1
        of_main = np.take_along_axis(of_strips, found.main, axis=1) & _OF_MAIN
        flags[touched] |= of_main[touched]
        flags[found.outside] |= Flag.EXTRAPOLATED.value
        with np.errstate(invalid="ignore"):
            rough = touched & ~(np.sqrt(found.covariance[..., 0, 0]) <= WEAK_FORCE_N)
        flags[rough] |= Flag.WEAK.value
        return flags

    def _reading(
        self,
        found: SurfaceFound,
        row: int,
        press: int,
        time_s: float,
        flags: Array,
        index: int,
        interference: float,
    ) -> SurfaceReading:
        touch, words = int(found.touch[row, press]), flag_words(int(flags[row, press]))
        known: dict[str, float | None] = {}
        if touch == 1:
            force, x, y = found.mean[row, press].tolist()
            c = found.covariance[row, press]
            values = {
                "force_n": force,
                "force_std_n": math.sqrt(c[0, 0]),
                "location_mm": x,
                "location_std_mm": math.sqrt(c[1, 1]),
                "y_mm": y,
                "y_std_mm": math.sqrt(c[2, 2]),
                "cov_force_x": float(c[0, 1]),
                "cov_force_y": float(c[0, 2]),
                "cov_x_y": float(c[1, 2]),
            }
            known = {key: v if math.isfinite(v) else None for key, v in values.items()}
        return SurfaceReading(
            time_s,
            self.names[press],
            None if touch < 0 else touch,
            flags=words,
            group=index,
            interference=interference,
            **known,
        )


def _any(flags: Array) -> Array:
    """Flags of any strip: (G, S) to (G,)."""
    found: Array = np.bitwise_or.reduce(flags, axis=1)
    return found
