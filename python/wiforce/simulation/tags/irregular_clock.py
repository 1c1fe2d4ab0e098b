# SPDX-License-Identifier: GPL-3.0-or-later
"""Clocks without a crystal: their frequency wanders, and their periods are not alike."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..random_sources import Seeds
from ..walk import RandomWalk
from .switching import SwitchingClock

if TYPE_CHECKING:
    from ...scene.simulated_tags import Tag

# Most that the frequency wanders from its stated course.
MOST_WANDER_PPM = 1000.0
_PERIODS_AT_ONCE = 1024


class IrregularClock(SwitchingClock):
    """A clock whose offset is a random walk, and whose periods come early or late.

    Parameters
    ----------
    clock_hz, offset_ppm, drift_ppm_per_s, limit_ppm, phase_cycles : float
        As for :class:`SwitchingClock`.
    tag : Tag
        Whose ``clock_wander_ppm_per_sqrt_s``, ``clock_period_jitter_s`` and ``clock_jitter_s``
        are the standard deviations of the offset's change in 1 s, of the length of a period,
        which accumulates, and of :meth:`early_s`, which does not.
    index : int
        Of the clock, for the seeds.
    """

    regular = False

    def __init__(
        self,
        clock_hz: float,
        offset_ppm: float,
        drift_ppm_per_s: float,
        limit_ppm: float,
        phase_cycles: float,
        tag: "Tag",
        seeds: Seeds,
        index: int,
    ) -> None:
        super().__init__(clock_hz, offset_ppm, drift_ppm_per_s, limit_ppm, phase_cycles)
        wander = tag.clock_wander_ppm_per_sqrt_s
        self._walk = RandomWalk(wander, seeds.generator(index), MOST_WANDER_PPM)
        self._late: RandomWalk | None = None
        if tag.clock_period_jitter_s:
            std = tag.clock_period_jitter_s * np.sqrt(clock_hz)
            rng = seeds.generator(index, 0, 0)
            self._late = RandomWalk(std, rng, spacing_s=1 / clock_hz)
        self._jitter_s, self._seeds, self._index = tag.clock_jitter_s, seeds, index
        self._lots: dict[int, np.ndarray] = {}

    def cycles(self, time_s: ArrayLike) -> np.ndarray:
        time_s = np.asarray(time_s, float)
        gained_s = 1e-6 * self._walk.integral(time_s)
        if self._late:
            gained_s = gained_s - self._late.at(time_s)
        return self._steady_cycles(time_s) + self.clock_hz * gained_s

    def offset_ppm(self, time_s: ArrayLike) -> np.ndarray:
        return super().offset_ppm(time_s) + self._walk.at(np.asarray(time_s, float))

    def early_s(self, periods: np.ndarray) -> np.ndarray:
        if not self._jitter_s:
            return super().early_s(periods)
        lots, inside = np.divmod(periods, _PERIODS_AT_ONCE)
        normal = [self._lot(int(lot))[i] for lot, i in zip(lots, inside, strict=True)]
        return self._jitter_s * np.array(normal)

    def _lot(self, lot: int) -> np.ndarray:
        """Standard normal numbers of a lot of periods; the first lot is number -1."""
        if lot not in self._lots:
            rng = self._seeds.generator(self._index, lot + 1)
            self._lots = {lot: rng.standard_normal(_PERIODS_AT_ONCE)} | dict(
                list(self._lots.items())[:1]
            )
        return self._lots[lot]
