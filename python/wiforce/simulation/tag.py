# SPDX-License-Identifier: GPL-3.0-or-later
"""A tag that switches, at sample level: its clock, its pulses and its reflections.

The estimator's model of what a snapshot sees of the switches (:mod:`..signal.switching`)
deliberately shares no code with this one, so that a mistake in either shows in the readings.
"""

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..scene import Scene
from ..scene.schema import SceneSensor
from ..scene.simulated import Tag
from .presses import PressedSensor
from .random_sources import Ramp, RandomSources, RandomWalk, Seeds, reflected

# A switch: cycles of its clock per cycle of clock 1, and the interval of a cycle in which it is on.
Switch = tuple[float, tuple[float, float]]
# Clock 1 has 25 % duty about 0.
SWITCHES: dict[str, tuple[Switch, Switch]] = {
    # Clock 2 at twice the frequency: pulses about +-1/4 of clock 1's cycle, which are never high
    # together with clock 1.
    "pulses": ((1.0, (-1 / 8, 1 / 8)), (2.0, (3 / 8, 5 / 8))),
    # Clock 2 at 75 % duty about the same centres: both switches are on for Ts/16 at a time.
    "overlapping": ((1.0, (-1 / 8, 1 / 8)), (2.0, (1 / 8, 7 / 8))),
    # The naive scheme: two unrelated square waves, on together for a quarter of the time.
    "two_frequencies": ((1.0, (-1 / 4, 1 / 4)), (1.4, (-1 / 4, 1 / 4))),
}


# Steps of Newton's method for the edges of an irregular clock. The guess is a few samples off, and
# a step leaves the relative error of the clock's nominal frequency, at most 2 %, of that.
_REFINEMENTS = 3


class SwitchingClock:
    """Phase u(t) = u_0 + f (t + integral of o) of a crystal clock, in cycles.

    The offset o drifts from ``offset_ppm`` on, and reverses at +-``limit_ppm``; up to there u is
    theta/2 pi of the signal model: f (t (1 + o) + d t^2 / 2). o may ``wander`` beside, in ppm, all
    that follows be ``late``, and the edges of periods (n,) come early, in s.
    """

    def __init__(
        self,
        clock_hz: float,
        offset_ppm: float,
        drift_ppm_per_s: float,
        limit_ppm: float,
        phase_cycles: float,
        wander: RandomWalk | None = None,
        late: RandomWalk | None = None,
        early_s: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> None:
        self.clock_hz = clock_hz
        self._drift = drift_ppm_per_s * 1e-6
        self._limit = limit_ppm * 1e-6
        self._offset = offset_ppm * 1e-6
        self._start_s, self._start_cycles = 0.0, phase_cycles
        self._wander, self._late, self.early_s = wander, late, early_s

    @property
    def regular(self) -> bool:
        """Whether edges follow from u alone, and u is linear over a few milliseconds."""
        return not (self._wander or self._late or self.early_s)

    def cycles(self, time_s: ArrayLike) -> np.ndarray:
        """u at the given times, in cycles."""
        time_s = np.asarray(time_s, float)
        gained_s = 0.0 if self._wander is None else 1e-6 * self._wander.integral(time_s)
        if self._late:
            gained_s = gained_s - self._late.at(time_s)
        return self._steady_cycles(time_s) + self.clock_hz * gained_s

    def offset_ppm(self, time_s: ArrayLike) -> np.ndarray:
        """o at the given times, in ppm."""
        time_s = np.asarray(time_s, float)
        wander = 0.0 if self._wander is None else self._wander.at(time_s)
        return 1e6 * self._offset_at(time_s - self._start_s) + wander

    def retune(self, time_s: float, offset_ppm: float) -> None:
        """Change the offset at a time; the phase stays continuous."""
        self._start_cycles = float(self._steady_cycles(np.asarray(time_s, float)))
        self._start_s = float(time_s)
        self._offset = offset_ppm * 1e-6
        self._limit = max(self._limit, abs(self._offset))

    def _steady_cycles(self, time_s: np.ndarray) -> np.ndarray:
        elapsed = time_s - self._start_s
        return self._start_cycles + self.clock_hz * (elapsed + self._gained_s(elapsed))

    def _offset_at(self, elapsed: np.ndarray) -> np.ndarray:
        if self._drift == 0:
            return np.full_like(elapsed, self._offset)
        return reflected(self._offset + self._drift * elapsed, self._limit)

    def _gained_s(self, elapsed: np.ndarray) -> np.ndarray:
        if self._drift == 0:
            return self._offset * elapsed
        end = self._offset + self._drift * elapsed
        return (self._wander_integral(end) - self._wander_integral(self._offset)) / self._drift

    def _wander_integral(self, x: np.ndarray | float) -> np.ndarray:
        """Integral over x of the triangle wave that x is folded into; 0 at x = +-limit."""
        limit = self._limit
        s = (x + limit) % (4 * limit)
        down = s - 2 * limit
        return np.where(s < 2 * limit, s * s / 2 - limit * s, limit * down - down * down / 2)


def switch_states(
    clock: SwitchingClock,
    switches: tuple[Switch, Switch],
    delay_s: float,
    first_sample: int,
    count: int,
    sample_rate_hz: float,
    rise_s: float = 0.0,
) -> list[np.ndarray]:
    """Part of each of ``count`` samples in which each switch (:data:`SWITCHES`) is on, float32.

    Sample n covers n - 1/2 .. n + 1/2, edges count by their exact time; switch 2 lags by
    ``delay_s``, edges take ``rise_s``. For a few milliseconds at most.
    """
    edge_s = (first_sample - 0.5) / sample_rate_hz
    span_s = np.array([0, count / sample_rate_hz])
    states = []
    for (rate, (on, off)), lag_s in zip(switches, (0.0, delay_s), strict=True):
        start, stop = (rate * clock.cycles(edge_s + span_s - lag_s)).tolist()
        # The rate is taken as constant over these samples: at 10 ppm/s the error is 4e-4 samples
        # in the middle of 5 ms, and zero at either end.
        samples_per_cycle = count / (stop - start)
        periods = np.arange(math.floor(start) - 1, math.floor(stop) + 2)
        lows, highs = (samples_per_cycle * (periods + x - start) for x in (on, off))
        if not clock.regular:
            early_s = np.zeros(len(periods))
            if clock.early_s:
                early_s = clock.early_s(np.floor(periods / rate).astype(int))
            for edges, x in ((lows, on), (highs, off)):
                for _ in range(_REFINEMENTS):
                    time_s = edge_s + edges / sample_rate_hz - lag_s
                    missing = (periods + x) / rate - clock.cycles(time_s)
                    edges += missing / clock.clock_hz * sample_rate_hz
                edges -= early_s * sample_rate_hz
        state = np.zeros(count, np.float32)
        for low, high in zip(lows.tolist(), highs.tolist(), strict=True):
            if rise_s:
                _cover_slowly(state, low, high, rise_s * sample_rate_hz)
            else:
                _cover(state, max(low, 0.0), min(high, float(count)))
        states.append(state)
    return states


def states_at(
    clock: SwitchingClock,
    switches: tuple[Switch, Switch],
    delay_s: float,
    times_s: np.ndarray,
    window_s: float,
) -> list[np.ndarray]:
    """Part of ``window_s`` about each of some times in which each switch is on; 0: an instant."""
    states = []
    for (rate, (on, off)), lag_s in zip(switches, (0.0, delay_s), strict=True):
        start, stop = (
            rate * clock.cycles(times_s - lag_s + side * window_s / 2) for side in (-1, 1)
        )
        whole = np.floor(start)
        start, stop = start - whole, np.maximum(stop, start + 1e-12) - whole
        covered = sum(
            np.clip(np.minimum(stop, off + n) - np.maximum(start, on + n), 0, None)
            for n in (-1, 0, 1, 2)
        )
        states.append(np.clip(covered / (stop - start), 0, 1))
    return states


def with_duty_errors(
    switches: tuple[Switch, Switch], errors: tuple[float, float]
) -> tuple[Switch, Switch]:
    """Switches whose duty cycles deviate by ``errors``, one half on either side."""
    first, second = (
        (rate, (on - error / 2, off + error / 2))
        for (rate, (on, off)), error in zip(switches, errors, strict=True)
    )
    return first, second


def _cover(state: np.ndarray, low: float, high: float) -> None:
    """Add the overlap of [n, n + 1) with [low, high) to element n, for 0 <= low, high <= size."""
    if low >= high:
        return
    first, last = int(low), int(high)
    if first == last:
        state[first] += high - low
        return
    state[first] += first + 1 - low
    state[first + 1 : last] += 1
    if last < len(state):
        state[last] += high - last


def _cover_slowly(state: np.ndarray, low: float, high: float, rise: float) -> None:
    """Add a trapezoid that rises about ``low`` and falls about ``high``, averaged per sample."""
    first = max(math.floor(low - rise / 2), 0)
    last = min(math.ceil(high + rise / 2), len(state))
    if first >= last:
        return
    edges = np.arange(first, last + 1)
    area = _ramp_area(edges - low, rise) - _ramp_area(edges - high, rise)
    state[first:last] += np.diff(area).astype(np.float32)


def _ramp_area(x: np.ndarray, rise: float) -> np.ndarray:
    """Integral up to x of a step from 0 to 1 that takes ``rise`` about 0."""
    inside = np.clip(x + rise / 2, 0, rise)
    return inside**2 / (2 * rise) + np.maximum(x - rise / 2, 0)


class SwitchedTag:
    """Reflection of a tag, by knots of ``ramp``, while its clock runs; ``on`` False removes it."""

    def __init__(self, scene: Scene, index: int, sources: RandomSources, ramp: Ramp) -> None:
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
        self.pressed = PressedSensor(scene, index)

    def reflection(self, first: int, count: int) -> np.ndarray:
        """Reflection r / rho during ``count`` samples, complex64."""
        if not self.on:
            return np.zeros(count, np.complex64)
        states = switch_states(
            self.clock, self._switches, self._delay_s, first, count, self._rate, self._rise_s
        )
        total = np.zeros(count, np.complex64)
        for state, value in self._terms(states, self._ramp.knots(first, count)):
            if value.size > 1:
                value = self._ramp.interpolate(value, first, count)
            total += state * value.astype(np.complex64)
        return total

    def reflection_at(self, times_s: np.ndarray, window_s: float) -> np.ndarray:
        """Reflection r / rho at rising times (n,), as of packets, averaged over ``window_s``."""
        switches = states_at(self.clock, self._switches, self._delay_s, times_s, window_s)
        return np.sum([state * value for state, value in self._terms(switches, times_s)], axis=0)

    def _terms(
        self, switches: list[np.ndarray], times_s: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """State of each switch, and of both at once, and what it adds at some times, or always."""
        ends = self.pressed.reflections(times_s)
        if self._drifts:
            ends = ends * np.exp(1j * np.stack([walk.at(times_s) for walk in self._drifts], axis=1))
        # Relative to the off state, which is added for the whole time.
        terms = list(zip(switches, (ends - self._off).T, strict=True))
        both_on = switches[0] * switches[1]
        if both_on.any():
            terms.append((both_on, self.pressed.through(times_s) + self._off.mean()))
        if self._off.any():
            terms.append((np.ones_like(both_on), self._off.mean()))
        path = self._rotation * self.pressed.motion(times_s)
        return [(state, value * path) for state, value in terms]


# Most that the frequency wanders from its stated course.
MOST_WANDER_PPM = 1000.0
_PERIODS_AT_ONCE = 1024


def _clock(
    sensor: SceneSensor, tag: Tag, duration_s: float, index: int, sources: RandomSources
) -> SwitchingClock:
    """The clock of a tag as the scene states it."""
    last_ppm = tag.clock_offset_ppm + tag.clock_drift_ppm_per_s * duration_s
    phase = sources.clocks.random()
    if tag.clock_phase_deg is not None:
        phase = tag.clock_phase_deg / 360
    return SwitchingClock(
        sensor.clock_hz,
        tag.clock_offset_ppm,
        tag.clock_drift_ppm_per_s,
        max(sensor.clock_tolerance_ppm, abs(tag.clock_offset_ppm), abs(last_ppm)),
        phase,
        *irregularities(tag, sensor.clock_hz, sources.effect("clock"), index),
    )


def irregularities(
    tag: Tag, clock_hz: float, seeds: Seeds, index: int
) -> tuple[RandomWalk | None, RandomWalk | None, Callable[[np.ndarray], np.ndarray] | None]:
    """Wander, delay that accumulates, and jitter of a tag's clock; None of those not stated."""
    wander = late = early_s = None
    if tag.clock_wander_ppm_per_sqrt_s:
        rng = seeds.generator(index)
        wander = RandomWalk(tag.clock_wander_ppm_per_sqrt_s, rng, MOST_WANDER_PPM)
    if tag.clock_period_jitter_s:
        std, rng = tag.clock_period_jitter_s * np.sqrt(clock_hz), seeds.generator(index, 0, 0)
        late = RandomWalk(std, rng, spacing_s=1 / clock_hz)
    if tag.clock_jitter_s:

        @lru_cache(2)
        def normal(lot: int) -> np.ndarray:
            """Of a lot of periods; the first lot is number -1."""
            return seeds.generator(index, lot + 1).standard_normal(_PERIODS_AT_ONCE)

        def early_s(periods: np.ndarray) -> np.ndarray:
            lots, inside = np.divmod(periods, _PERIODS_AT_ONCE)
            drawn = [normal(int(lot))[i] for lot, i in zip(lots, inside, strict=True)]
            return tag.clock_jitter_s * np.array(drawn)

    return wander, late, early_s
