# SPDX-License-Identifier: GPL-3.0-or-later
"""A tag's free-running clock and the two switches that it drives, at sample level.

This is the simulator's own model of the tag, edge by edge. The estimator's model of what a
snapshot sees of the switches (:mod:`..signal.switching`) deliberately shares no code with it, so
that a mistake in either shows in the readings.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

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
    """Phase of a crystal clock over time.

    u(t) = u_0 + f (t + integral of o), in cycles. The offset o starts at ``offset_ppm``, positive
    when the tag is fast, and drifts linearly; where it would leave ``+-limit_ppm`` the drift
    reverses, so that a run of any length stays within the crystal's tolerance. Before that, u is
    theta/2 pi of the signal model: f (t (1 + o) + d t^2 / 2).
    """

    def __init__(
        self,
        clock_hz: float,
        offset_ppm: float,
        drift_ppm_per_s: float,
        limit_ppm: float,
        phase_cycles: float,
    ) -> None:
        self.clock_hz = clock_hz
        self._drift = drift_ppm_per_s * 1e-6
        self._limit = limit_ppm * 1e-6
        self._offset = offset_ppm * 1e-6
        self._start_s, self._start_cycles = 0.0, phase_cycles

    # Whether edges follow from u alone, and u is linear over a few milliseconds.
    regular = True

    def cycles(self, time_s: ArrayLike) -> np.ndarray:
        """u at the given times, in cycles."""
        return self._steady_cycles(np.asarray(time_s, float))

    def early_s(self, periods: np.ndarray) -> np.ndarray:
        """Time by which the edges of given periods come before u says so."""
        return np.zeros(len(periods))

    def offset_ppm(self, time_s: ArrayLike) -> np.ndarray:
        """o at the given times, in ppm."""
        elapsed = np.asarray(time_s, float) - self._start_s
        return 1e6 * self._offset_at(elapsed)

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
        if self._drift == 0 or self._limit == 0:
            return np.full_like(elapsed, self._offset)
        wander = (self._offset + self._drift * elapsed + self._limit) % (4 * self._limit)
        return np.where(wander < 2 * self._limit, wander - self._limit, 3 * self._limit - wander)

    def _gained_s(self, elapsed: np.ndarray) -> np.ndarray:
        if self._drift == 0 or self._limit == 0:
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

    Sample n covers the time (n - 1/2 .. n + 1/2) / sample_rate; an edge inside it counts by its
    exact time. Switch 2 lags behind the clock by ``delay_s``; a switch goes from off to on and back
    in ``rise_s``, centred on the edge. A few milliseconds of samples at most.
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
