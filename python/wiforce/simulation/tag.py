# SPDX-License-Identifier: GPL-3.0-or-later
"""A tag that switches: its clock, which may lack a crystal, its pulses and its reflections."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .random_sources import Ramp, RandomSources, RandomWalk, Seeds
from .skin import pressed_sensor
from .switching import SWITCHES, SwitchingClock, states_at, switch_states, with_duty_errors

if TYPE_CHECKING:
    from ..scene import Scene
    from ..scene.schema import SceneSensor
    from ..scene.simulated_tags import Tag


# Most that the frequency wanders from its stated course.
MOST_WANDER_PPM = 1000.0
_PERIODS_AT_ONCE = 1024


class IrregularClock(SwitchingClock):
    """A clock whose offset is a random walk, and whose periods come early or late.

    The tag's ``clock_wander_ppm_per_sqrt_s``, ``clock_period_jitter_s`` and ``clock_jitter_s`` are
    the standard deviations of the offset's change in 1 s, of the length of a period, which
    accumulates, and of :meth:`early_s`, which does not.
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


class SwitchedTag:
    """Reflection of a tag, sample by sample, while its clock runs and its sensor is pressed.

    Reflections are computed at the knots of ``ramp``; ``on`` set to False removes the tag.
    """

    def __init__(self, scene: "Scene", index: int, sources: RandomSources, ramp: Ramp) -> None:
        sensor, simulation = scene.sensors[index], scene.simulation
        tag = simulation.tags[index]
        self.name, self.on = sensor.name, True
        self._rate, self._ramp = scene.radio.sample_rate_hz, ramp
        self.clock = _clock(sensor, tag, simulation.duration_s, index, sources)
        errors = tag.clock1_duty_error, tag.clock2_duty_error
        self._switches = with_duty_errors(SWITCHES[tag.clock2_duty], errors)
        self._delay_s, self._rise_s = tag.clock2_delay_s, tag.switch_rise_s
        self._off = np.array(sensor.off_reflection)
        self._rotation = np.exp(2j * np.pi * sources.clocks.random())
        self._drifts: list[RandomWalk] = []
        if tag.drift_deg_per_sqrt_s:
            seeds, std = sources.effect("drift"), np.deg2rad(tag.drift_deg_per_sqrt_s)
            self._drifts = [RandomWalk(std, seeds.generator(index, end)) for end in (0, 1)]
        self.pressed = pressed_sensor(scene, index)

    def reflection(self, first: int, count: int) -> np.ndarray:
        """Reflection r / rho during ``count`` samples, complex64."""
        if not self.on:
            return np.zeros(count, np.complex64)
        first_on, second_on = switch_states(
            self.clock, self._switches, self._delay_s, first, count, self._rate, self._rise_s
        )
        both_on = first_on * second_on
        times = self._ramp.knots(first, count)
        ends = self.pressed.reflections(times)
        if self._drifts:
            ends = ends * np.exp(1j * np.stack([walk.at(times) for walk in self._drifts], axis=1))
        path = self._rotation * self.pressed.motion(times)
        # Relative to the off state, which is added for the whole time.
        states = [first_on, second_on]
        values = [ends[:, 0] - self._off[0], ends[:, 1] - self._off[1]]
        if both_on.any():
            states.append(both_on)
            values.append(self.pressed.through(times) + self._off.mean())
        if self._off.any():
            states.append(np.ones_like(first_on))
            values.append(self._off.mean())
        values = [np.atleast_1d(value * path).astype(np.complex64) for value in values]
        return self._sum(states, values, first, count)

    def reflection_at(self, times_s: np.ndarray, window_s: float) -> np.ndarray:
        """Reflection r / rho at rising times (n,), as of packets, averaged over ``window_s``."""
        first_on, second_on = (
            switch.T
            for switch in states_at(self.clock, self._switches, self._delay_s, times_s, window_s)
        )
        ends = self.pressed.reflections(times_s)
        if self._drifts:
            ends = ends * np.exp(1j * np.stack([walk.at(times_s) for walk in self._drifts], axis=1))
        both_on = first_on * second_on
        off = self._off.mean()
        total = first_on * (ends[:, 0] - self._off[0]) + second_on * (ends[:, 1] - self._off[1])
        total = total + off + both_on * (self.pressed.through(times_s) + off)
        reflected: np.ndarray = total * self._rotation * self.pressed.motion(times_s)
        return reflected

    def _sum(
        self, states: Sequence[np.ndarray], values: Sequence[np.ndarray], first: int, count: int
    ) -> np.ndarray:
        """Sum of the states times their values: constants, or values at the knots."""
        if all(len(value) == 1 for value in values):
            parts = np.concatenate(values).view(np.float32).reshape(-1, 2)
            return (np.stack(states).T @ parts).view(np.complex64).ravel()
        total = np.zeros(count, np.complex64)
        for state, value in zip(states, values, strict=True):
            constant = len(value) == 1
            total += state * (value if constant else self._ramp.interpolate(value, first, count))
        return total


def _clock(
    sensor: "SceneSensor", tag: "Tag", duration_s: float, index: int, sources: RandomSources
) -> SwitchingClock:
    """The clock of a tag as the scene states it."""
    last_ppm = tag.clock_offset_ppm + tag.clock_drift_ppm_per_s * duration_s
    phase = sources.clocks.random()
    if tag.clock_phase_deg is not None:
        phase = tag.clock_phase_deg / 360
    steady = (
        sensor.clock_hz,
        tag.clock_offset_ppm,
        tag.clock_drift_ppm_per_s,
        max(sensor.clock_tolerance_ppm, abs(tag.clock_offset_ppm), abs(last_ppm)),
        phase,
    )
    if not (tag.clock_wander_ppm_per_sqrt_s or tag.clock_period_jitter_s or tag.clock_jitter_s):
        return SwitchingClock(*steady)
    return IrregularClock(*steady, tag, sources.effect("clock"), index)
