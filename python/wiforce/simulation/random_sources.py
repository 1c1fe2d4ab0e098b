# SPDX-License-Identifier: GPL-3.0-or-later
"""Random quantities of a simulated scene: one generator per kind, so that kinds are independent."""

from collections.abc import Callable, Iterator

import numpy as np

_MOST_PATHS = 64
# First part of the seeds of effects; 0 to 5 are those of the generators of RandomSources.
_EFFECT_KEY = 6
# Their order determines the seeds: append only.
EFFECTS = (
    "bursts",
    "hopper",
    "front_end",
    "lamps",
    "ripple",
    "fan",
    "walker",
    "other_tags",
    "clock",
    "drift",
    "hand",
    "packets",
    "radio_noise",
)


class Seeds:
    """Generators of an effect by counter, independent of what was drawn before: start anywhere."""

    def __init__(self, seed: int, effect: str) -> None:
        self._seed, self._key = seed, (_EFFECT_KEY, EFFECTS.index(effect))

    def generator(self, *counters: int) -> np.random.Generator:
        """The generator of these counters, which are not negative."""
        key = (*self._key, *counters)
        return np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=key))


class RandomSources:
    """Generators of a scene, one per kind; antennas have paths, noise and phases of their own."""

    def __init__(self, seed: int, antenna: int) -> None:
        seeds = np.random.SeedSequence(seed).spawn(5)
        generators = map(np.random.default_rng, seeds)
        self.paths, self.clocks, self.movers, self.noise, self.oscillators = generators
        self._seed = seed
        self._rotations: Iterator[complex] = iter(np.ones(_MOST_PATHS))
        if antenna:
            own = np.random.SeedSequence(seed, spawn_key=(len(seeds), antenna)).spawn(2)
            self.paths, self.noise = map(np.random.default_rng, own)
            self._rotations = iter(np.exp(2j * np.pi * self.paths.random(_MOST_PATHS)))

    def rotated(self, taps: np.ndarray) -> np.ndarray:
        """The taps of the next path, as this antenna has them."""
        return taps * next(self._rotations)

    def effect(self, name: str) -> Seeds:
        """The generators of an effect, which all antennas share."""
        return Seeds(self._seed, name)


# Knots of slow values. Between knots this far apart, a gain with a Doppler shift of 250 Hz
# deviates from linear by 3e-5 of itself.
_KNOT_SPACING_S = 10e-6


class Fir:
    """FIR filter (n,) for a stream with a history of ``memory``; real taps take half the work."""

    def __init__(self, taps: np.ndarray) -> None:
        self._complex = np.iscomplexobj(taps)
        kind = np.complex64 if self._complex else np.float32
        self._taps = [(delay, kind(tap)) for delay, tap in enumerate(taps) if tap != 0]
        self.memory = len(taps) - 1

    def apply(self, extended: np.ndarray, count: int, out: np.ndarray, scratch: np.ndarray) -> None:
        """Filter the ``count`` newest samples of ``extended``, behind the history, into ``out``."""
        start, size = len(extended) - count, 1
        if not self._complex:  # both components alike, at half the work
            extended, out, scratch = (x.view(np.float32) for x in (extended, out, scratch))
            size = 2
        if not self._taps:
            out[:] = 0
        for i, (delay, tap) in enumerate(self._taps):
            first = size * (start - delay)
            part = extended[first : first + size * count]
            np.multiply(part, tap, out=scratch if i else out)
            if i:
                np.add(out, scratch, out=out)


class Ramp:
    """Linear interpolation of slow values between knots on the sample grid."""

    def __init__(self, sample_rate_hz: float) -> None:
        self._step = max(16, 2 ** round(np.log2(_KNOT_SPACING_S * sample_rate_hz)))
        self._weights = (np.arange(self._step) / self._step).astype(np.float32)
        self._rate = sample_rate_hz

    def knots(self, first_sample: int, count: int) -> np.ndarray:
        """Times in s of the knots around some samples, one before and one behind included."""
        first = first_sample // self._step
        last = -(-(first_sample + count) // self._step)
        return np.arange(first, last + 1) * (self._step / self._rate)

    def interpolate(self, values: np.ndarray, first_sample: int, count: int) -> np.ndarray:
        """Interpolate values at the :meth:`knots` of some samples to complex64 (count,)."""
        values = np.asarray(values, np.complex64)
        steps = np.diff(values)
        lines = steps[:, None] * self._weights
        lines += values[:-1, None]
        skip = first_sample % self._step
        return lines.reshape(-1)[skip : skip + count]

    def sampled(
        self, gain: Callable[[np.ndarray], np.ndarray], first_sample: int, count: int
    ) -> np.ndarray:
        """A function of time at some samples, complex64 (count,), from its values at knots."""
        return self.interpolate(gain(self.knots(first_sample, count)), first_sample, count)


# Knots that are drawn at once.
_DRAWN = 4096


class RandomWalk:
    """A random walk from 0, reflected at +-``limit``, and its integral, at times in any order."""

    def __init__(
        self,
        std_per_sqrt_s: float,
        rng: np.random.Generator,
        limit: float = np.inf,
        spacing_s: float = 10e-3,
    ) -> None:
        self._step, self._rng, self._limit = std_per_sqrt_s * np.sqrt(spacing_s), rng, limit
        self._spacing_s = spacing_s
        self._last = 0.0  # before reflection
        self._values, self._integrals = np.zeros(1), np.zeros(1)

    def at(self, time_s: np.ndarray | float) -> np.ndarray:
        """The walk at given times; negative times count as 0."""
        knot, inside = self._knots(time_s)
        return self._values[knot] + inside * (self._values[knot + 1] - self._values[knot])

    def integral(self, time_s: np.ndarray | float) -> np.ndarray:
        """Its integral over time, from time 0."""
        knot, inside = self._knots(time_s)
        start = self._values[knot]
        rise = self._values[knot + 1] - start
        return self._integrals[knot] + self._spacing_s * (start * inside + rise * inside**2 / 2)

    def _knots(self, time_s: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """The knot before each time, and the part of the interval after it."""
        position = np.maximum(np.asarray(time_s, float) / self._spacing_s, 0.0)
        knot = position.astype(np.int64)
        if knot.size:
            self._extend(int(knot.max()) + 2)
        return knot, position - knot

    def _extend(self, count: int) -> None:
        """Draw whole lots of knots until there are at least ``count``."""
        missing = count - len(self._values)
        if missing <= 0:
            return
        steps = self._rng.standard_normal(-(-missing // _DRAWN) * _DRAWN) * self._step
        walk = self._last + np.cumsum(steps)
        self._last = float(walk[-1])
        new = np.r_[self._values[-1], reflected(walk, self._limit)]
        areas = np.cumsum((new[1:] + new[:-1]) / 2) * self._spacing_s
        self._integrals = np.r_[self._integrals, self._integrals[-1] + areas]
        self._values = np.r_[self._values, new[1:]]


def reflected(walk: np.ndarray, limit: float) -> np.ndarray:
    """A course of any shape, folded into +-``limit``."""
    if not np.isfinite(limit):
        return walk
    folded = (walk + limit) % (4 * limit)
    return np.where(folded < 2 * limit, folded - limit, 3 * limit - folded)
