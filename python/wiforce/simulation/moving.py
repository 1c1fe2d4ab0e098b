# SPDX-License-Identifier: GPL-3.0-or-later
"""What moves in a room: a fan, mains lamps, a person, a hand at a tag, tags of others."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..signal.carrier import SPEED_OF_LIGHT_M_S
from .paths import (
    BASE_DELAY,
    LAST_DELAY,
    MOVING_PATHS,
    Levels,
    MovingPath,
    delay_taps,
    random_taps,
    tag_taps,
)
from .random_sources import Ramp, RandomSources, RandomWalk, Seeds
from .switching import SWITCHES, SwitchingClock, switch_states
from .tag import SwitchedTag

if TYPE_CHECKING:
    from ..scene import Scene
    from ..scene.effects import Fan, Hand, Lamps, OtherTag, Walker


BLADES = 3
# Part of a blade's amplitude that depends on how it faces the antennas.
_FLASH = 0.7
# Points of a revolution in which the mean power is computed.
_POINTS = 4096


class FanBlades:
    """The path by way of a fan's blades.

    Each of three blades at the angle a has the gain (1 + 0.7 cos 2a) exp(j b cos a): it reflects
    best while it faces the antennas, and its distance oscillates. With b = f_d / f_r, for the
    revolutions per second f_r, its Doppler frequency reaches f_d. Blades are alike, so that only
    multiples of 3 f_r remain in their sum, the lines at multiples of the blade frequency.
    """

    def __init__(self, stated: "Fan", seeds: Seeds) -> None:
        rng = seeds.generator()
        self._turns_hz = stated.blade_hz / BLADES
        self._index = stated.highest_hz / self._turns_hz
        self._start = rng.random()
        self.taps = random_taps(rng)
        period = self._sum(np.arange(_POINTS) / _POINTS)
        self._scale = np.exp(2j * np.pi * rng.random()) / np.sqrt(np.mean(np.abs(period) ** 2))

    def gain(self, time_s: np.ndarray) -> np.ndarray:
        """The path's gain, of unit mean power."""
        return self._scale * self._sum((self._turns_hz * time_s + self._start) % 1)

    def _sum(self, turns: np.ndarray) -> np.ndarray:
        angles = 2 * np.pi * np.add.outer(np.arange(BLADES) / BLADES, turns)
        facing = 1 + _FLASH * np.cos(2 * angles)
        return (facing * np.exp(1j * self._index * np.cos(angles))).sum(axis=0)


# Harmonics up to here; the gain is interpolated between knots about 10 us apart.
_HIGHEST_HZ = 10_000
# Most that the mains frequency deviates, relative to itself. European grids stay within 0.4 %
# but for emergencies (EN 50160: 1 % in 99.5 % of a year).
_MOST_DEVIATION = 0.01
# Points of the waveform over a period.
_LAMP_POINTS = 16384


class MainsLamps:
    """A path by way of lamps, with lines at all harmonics of twice the mains frequency."""

    def __init__(self, stated: "Lamps", seeds: Seeds) -> None:
        rng = seeds.generator()
        self._line_hz = 2 * stated.mains_hz
        harmonics = np.arange(1, max(1, int(_HIGHEST_HZ / self._line_hz)) + 1)
        phases = 2 * np.pi * rng.random(len(harmonics))
        spectrum = np.zeros(_LAMP_POINTS, complex)
        spectrum[harmonics] = 2 / harmonics * np.exp(1j * phases)
        waveform = _LAMP_POINTS * np.fft.ifft(spectrum).real
        self._waveform = np.r_[waveform, waveform[0]] * np.exp(2j * np.pi * rng.random())
        self.taps = random_taps(rng)
        most = _MOST_DEVIATION * stated.mains_hz
        self._wander = RandomWalk(stated.wander_hz_per_sqrt_s, rng, most)

    def gain(self, time_s: np.ndarray) -> np.ndarray:
        """The path's gain; the amplitude of each of the lines +-1 is 1."""
        cycles = self._line_hz * time_s + 2 * self._wander.integral(time_s)
        return self._waveform[np.rint(cycles % 1 * _LAMP_POINTS).astype(int)]


# Two steps, in metres of way.
STRIDE_M = 1.4
# Power of trunk, two legs and two arms, and how far each swings about the trunk: a foot stands
# still at one end of its swing and is about three times as fast as the trunk at the other
# (P. van Dorp, F. Groen, "Human walking estimation with radar", IEE Proc. 150 (2003)).
LIMBS = ((0.7, 0.0, 0.0), (0.1, 2.0, 0.0), (0.1, 2.0, 0.5), (0.05, 1.0, 0.5), (0.05, 1.0, 0.0))
_FASTEST_LIMB = 3.0
# Time in which a walk begins and ends, at most; the speed follows a raised cosine.
_START_S = 0.4
# Breathing while standing: 5 mm at 0.25 Hz.
_BREATHING_M, _BREATHING_HZ = 5e-3, 0.25
# Walks that are drawn at once.
_DRAWN = 64


class Person:
    """Trunk, legs and arms of a person, as paths with a common way.

    Walks and pauses alternate. The direction of each walk is opposite to that of the one before,
    and its speed is 0.6 to 1 of the highest. Limbs swing by the way that was walked, so that they
    stop with the person; only breathing remains.
    """

    def __init__(self, stated: "Walker", center_frequency_hz: float, seeds: Seeds) -> None:
        rng = seeds.generator()
        self._rng = seeds.generator(0)
        self._walk_s, self._trunk_hz = stated.walk_s, stated.highest_hz / _FASTEST_LIMB
        self._pause_s = stated.walk_s * (1 - stated.walking_share) / stated.walking_share
        self._wavelength_m = SPEED_OF_LIGHT_M_S / center_frequency_hz
        self._breath = rng.random()
        delay = rng.uniform(BASE_DELAY + 0.5, LAST_DELAY - 0.1)
        # Start, end, Doppler frequency of the trunk, and way in cycles before each walk.
        self._walks = np.zeros((1, 4))
        stride = 2 * STRIDE_M / self._wavelength_m  # in cycles of the carrier, two ways
        self.limbs = [
            Limb(
                self, np.sqrt(power), swing, stride, phase, delay + 0.1 * rng.random(), rng.random()
            )
            for power, swing, phase in LIMBS
        ]

    def way(self, time_s: np.ndarray) -> np.ndarray:
        """Way of the trunk towards the antennas, in cycles of the carrier, counted both ways."""
        self._extend(float(np.max(time_s, initial=0.0)))
        latest = np.searchsorted(self._walks[:, 0], time_s, "right") - 1
        start, end, hertz, before = np.moveaxis(self._walks[latest], -1, 0)
        ramp = np.minimum(_START_S, (end - start) / 2)
        inside = np.clip(time_s - start, 0, end - start)
        rising, falling = (_ramped(x, ramp) for x in (inside, end - start - inside))
        # Rising at the start, full speed, falling at the end: what is left to walk is symmetric.
        full = np.clip(inside - ramp, 0, end - start - 2 * ramp)
        walked = rising + full + ramp / 2 - falling
        return before + hertz * walked

    def breath(self, time_s: np.ndarray) -> np.ndarray:
        """Movement of the chest, in cycles of the carrier, counted both ways."""
        swing = np.sin(2 * np.pi * (_BREATHING_HZ * time_s + self._breath))
        return 2 * _BREATHING_M / self._wavelength_m * swing

    def walking(self, time_s: np.ndarray) -> np.ndarray:
        """Whether the person walks, at given times; shape of ``time_s``."""
        self._extend(float(np.max(time_s, initial=0.0)))
        walk = self._walks[np.searchsorted(self._walks[:, 0], time_s, "right") - 1]
        return time_s < walk[..., 1]

    def _extend(self, until_s: float) -> None:
        """Draw walks until one begins after ``until_s``."""
        while self._walks[-1, 0] <= until_s:
            durations = self._walk_s * self._rng.uniform(0.5, 1.5, _DRAWN)
            pauses = self._pause_s * self._rng.uniform(0.5, 1.5, _DRAWN)
            starts = self._walks[-1, 1] + np.cumsum(pauses + np.r_[0, durations[:-1]])
            hertz = self._trunk_hz * self._rng.uniform(0.6, 1.0, _DRAWN)
            hertz[::2] *= -1
            lengths = hertz * (durations - np.minimum(_START_S, durations / 2))
            start, end, last_hertz, before = self._walks[-1]
            last = last_hertz * (end - start - min(_START_S, (end - start) / 2))
            ways = before + last + np.cumsum(np.r_[0, lengths[:-1]])
            new = np.column_stack([starts, starts + durations, hertz, ways])
            self._walks = np.concatenate([self._walks, new])


class Limb:
    """A part of a person that reflects, and that swings about the trunk.

    ``swing`` is its highest speed relative to that of the trunk, ``stride_cycles`` the length of
    two steps, both ways, in cycles of the carrier, ``phase`` that of the swing in strides,
    ``delay`` in samples, ``start`` the phase of the path at time 0 in cycles.
    """

    def __init__(
        self,
        person: Person,
        amplitude: float,
        swing: float,
        stride_cycles: float,
        phase: float,
        delay: float,
        start: float,
    ) -> None:
        self._person, self.amplitude = person, float(amplitude)
        self._swing, self._stride, self._phase = swing, stride_cycles, phase
        self._start = start
        self.taps = delay_taps(delay, 4)

    def gain(self, time_s: np.ndarray) -> np.ndarray:
        """The path's gain, of magnitude 1."""
        way = self._person.way(time_s)
        strides = way / self._stride + self._phase
        swing = self._swing * self._stride / (2 * np.pi) * np.sin(2 * np.pi * strides)
        cycles = way + swing + self._person.breath(time_s) + self._start
        return np.exp(2j * np.pi * (cycles % 1))


def _ramped(elapsed: np.ndarray, ramp: np.ndarray) -> np.ndarray:
    """Integral of a raised-cosine rise from 0 to 1 over ``ramp``, up to its end."""
    x = np.clip(elapsed / np.maximum(ramp, 1e-12), 0, 1)
    return ramp / 2 * (x - np.sin(np.pi * x) / np.pi)


_SWAY_HZ = 0.7


class NearHand:
    """Gain of the path between tag and reader that goes by way of the hand.

    p exp(-j 4 pi d / lambda). p rises from 0 to 1 while the hand comes, and its distance d falls to
    what it sways by.
    """

    def __init__(
        self, stated: "Hand", tag: "SwitchedTag", scene: "Scene", rng: np.random.Generator
    ) -> None:
        self._stated, self._pressed = stated, tag.pressed
        self._wavelength_mm = 1e3 * SPEED_OF_LIGHT_M_S / scene.radio.center_frequency_hz
        self._start, self._sway = rng.random(2)
        delay = stated.delay_s * scene.radio.sample_rate_hz
        self.taps = delay_taps(BASE_DELAY + delay, 4)

    def gain(self, time_s: np.ndarray) -> np.ndarray:
        """The path's gain relative to that with the hand on the sensor."""
        near = self._pressed.near(time_s, self._stated.reach_s)
        swing = np.sin(2 * np.pi * (_SWAY_HZ * time_s + self._sway))
        distance_mm = self._stated.travel_mm * (1 - near) + self._stated.sway_mm * swing
        cycles = self._start - 2 * distance_mm / self._wavelength_mm
        return near * np.exp(2j * np.pi * cycles)


class UnlistedTag:
    """A tag whose sensor nobody presses: both ends reflect with constant phases."""

    def __init__(self, stated: "OtherTag", scene: "Scene", rng: np.random.Generator) -> None:
        self._rate = scene.radio.sample_rate_hz
        offset = stated.clock_offset_ppm
        self.clock = SwitchingClock(stated.clock_hz, offset, 0.0, abs(offset), rng.random())
        self._ends = np.exp(2j * np.pi * rng.random(2)).astype(np.complex64)
        delay = BASE_DELAY + stated.delay_s * self._rate
        self.taps = np.r_[np.zeros(BASE_DELAY), 1.0]
        if stated.delay_s:
            self.taps = delay_taps(delay, 4)

    def reflection(self, first: int, count: int) -> np.ndarray:
        """Reflection r / rho during ``count`` samples."""
        states = switch_states(self.clock, SWITCHES["pulses"], 0.0, first, count, self._rate)
        return self._ends[0] * states[0] + self._ends[1] * states[1]


@dataclass(frozen=True)
class ModulatedPath:
    """FIR taps, and a gain from first sample and count to complex64 (count,)."""

    taps: np.ndarray
    gain: Callable[[int, int], np.ndarray]


def modulated_paths(
    scene: "Scene", levels: Levels, sources: RandomSources, ramp: Ramp
) -> list[ModulatedPath]:
    """The paths by way of everything but the scene's tags; slow gains at the knots of ``ramp``."""
    simulation = scene.simulation

    def slow(taps: np.ndarray, amplitude: float, gain: Callable) -> ModulatedPath:
        """A path whose gain, a function of time, is interpolated between knots."""

        def at(first: int, count: int) -> np.ndarray:
            return ramp.interpolate(gain(ramp.knots(first, count)), first, count)

        return ModulatedPath(sources.rotated(levels.scaled(taps, amplitude)), at)

    paths = []
    if simulation.moving_clutter_db is not None:
        hertz = simulation.moving_clutter_hz
        level = levels.amplitude(simulation.moving_clutter_db) / np.sqrt(MOVING_PATHS)
        movers = [MovingPath(sources.movers, hertz, i == 0) for i in range(MOVING_PATHS)]
        paths += [slow(mover.taps, level, mover.gain) for mover in movers]
    if simulation.fan:
        fan = FanBlades(simulation.fan, sources.effect("fan"))
        paths.append(slow(fan.taps, levels.amplitude(simulation.fan.level_db), fan.gain))
    if simulation.walker:
        person = Person(
            simulation.walker, scene.radio.center_frequency_hz, sources.effect("walker")
        )
        level = levels.amplitude(simulation.walker.level_db)
        for limb in person.limbs:
            paths.append(slow(limb.taps, level * limb.amplitude, limb.gain))
    if simulation.lamps:
        lamps = MainsLamps(simulation.lamps, sources.effect("lamps"))
        paths.append(slow(lamps.taps, levels.amplitude(simulation.lamps.level_db), lamps.gain))
    for index, stated in enumerate(simulation.other_tags):
        other = UnlistedTag(stated, scene, sources.effect("other_tags").generator(index))
        taps = levels.scaled(other.taps, 10 ** (stated.level_db / 20))
        paths.append(ModulatedPath(sources.rotated(taps), other.reflection))
    return paths


def tag_paths(
    scene: "Scene", levels: Levels, sources: RandomSources, ramp: Ramp
) -> tuple[dict[str, SwitchedTag], list[ModulatedPath]]:
    """The scene's tags by sensor name, and the paths by way of them."""
    simulation = scene.simulation
    tags, paths = {}, []
    for index, tag in enumerate(simulation.tags):
        switched = SwitchedTag(scene, index, sources, ramp)
        fade = tag_taps(sources.paths, scene.waveform(), simulation.tag_coherence_hz)
        rotation = sources.rotated(np.ones(1))
        level = 10 ** (tag.level_db / 20)
        tags[switched.name] = switched
        paths.append(ModulatedPath(rotation * levels.scaled(fade, level), switched.reflection))
        if tag.hand:
            hand = NearHand(tag.hand, switched, scene, sources.effect("hand").generator(index))
            taps = levels.scaled(hand.taps, level * 10 ** (tag.hand.level_db / 20))
            paths.append(ModulatedPath(rotation * taps, _product(switched, hand, ramp)))
    return tags, paths


def _product(tag: SwitchedTag, hand: NearHand, ramp: Ramp) -> Callable[[int, int], np.ndarray]:
    """Gain of the path by way of tag and hand."""

    def at(first: int, count: int) -> np.ndarray:
        gain = ramp.interpolate(hand.gain(ramp.knots(first, count)), first, count)
        return gain * tag.reflection(first, count)

    return at
