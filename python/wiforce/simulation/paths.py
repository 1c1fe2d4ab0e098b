# SPDX-License-Identifier: GPL-3.0-or-later
"""Propagation paths: static ones, those by way of tags, and those by way of what moves."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from ..scene import Scene
from ..scene.effects import Fan, Hand, Lamps, OtherTag, Walker
from ..signal.carrier import SPEED_OF_LIGHT_M_S
from .random_sources import Ramp, RandomSources, RandomWalk, Seeds
from .tag import SWITCHES, SwitchedTag, SwitchingClock, switch_states

# Delay of the first path in samples, which leaves room for the interpolator, and of the last.
BASE_DELAY = 2
LAST_DELAY = 5
STATIC_ECHOES = 8
MOVING_PATHS = 4


def delay_taps(delay: float) -> np.ndarray:
    """Taps of a Kaiser-windowed sinc (beta = 5) over four samples, for a delay of 1 or more."""
    n = int(delay) + np.arange(-1, 3)
    u = (n - delay) / 2
    window = np.i0(5.0 * np.sqrt(np.maximum(1 - u**2, 0))) / np.i0(5.0)
    taps = np.zeros(n[-1] + 1)
    taps[n] = np.sinc(n - delay) * window
    return taps


def random_taps(rng: np.random.Generator) -> np.ndarray:
    """FIR taps of a path with a random delay, as that of anything that reflects in a room."""
    return delay_taps(rng.uniform(BASE_DELAY + 0.5, LAST_DELAY))


def static_taps(rng: np.random.Generator, sample_rate_hz: float) -> np.ndarray:
    """Complex taps of a direct path and echoes delayed by 60 ns, as in rooms; not normalised."""
    late = np.r_[0, 0.1 + rng.exponential(60e-9 * sample_rate_hz, STATIC_ECHOES)]
    delays = np.minimum(BASE_DELAY + 0.2 + late, LAST_DELAY)
    levels = np.r_[1.0, 0.2 * rng.rayleigh(0.7, STATIC_ECHOES)]
    taps = np.zeros(LAST_DELAY + 3, complex)
    for delay, level in zip(delays, levels, strict=True):
        path = delay_taps(delay)
        taps[: len(path)] += level * np.exp(2j * np.pi * rng.random()) * path
    return np.trim_zeros(taps, "b")


def tag_taps(
    rng: np.random.Generator, sample_rate_hz: float, coherence_hz: float | None
) -> np.ndarray:
    """Taps of a tag's path, not normalised: one, or Rayleigh fading of a coherence bandwidth."""
    if coherence_hz is None:
        return np.r_[np.zeros(BASE_DELAY), 1.0]
    spread = sample_rate_hz / (2 * np.pi * coherence_hz)
    count = int(np.clip(np.ceil(6 * spread), 1, 32))
    profile = np.exp(-np.arange(count) / max(spread, 1e-3) / 2)
    fading = rng.standard_normal(count) + 1j * rng.standard_normal(count)
    return np.r_[np.zeros(BASE_DELAY), profile * fading]


class MovingPath:
    """A path with gain exp(j phi(t)), whose Doppler shift oscillates.

    The shift is f_c + f_d cos(2 pi nu t + alpha). |f_c| + |f_d| is 0.8 ``doppler_hz`` at most, so
    that what lies beyond ``doppler_hz`` is below -60 dB. A path that ``sweeps`` covers the whole
    range, like an arm (f_c = 0); another oscillates about a constant shift, like a person.
    """

    def __init__(self, rng: np.random.Generator, doppler_hz: float, sweeps: bool) -> None:
        share = 0.0 if sweeps else rng.uniform(0.3, 0.9)
        reach = 0.8 * doppler_hz * (1.0 if sweeps else rng.uniform(0.4, 1.0))
        self._steady_hz = reach * share * rng.choice([-1, 1])
        self._swing_hz = reach * (1 - share)
        self._swing_rate_hz = min(1.0, doppler_hz / 60) * rng.uniform(0.4, 0.9)
        self._phases = 2 * np.pi * rng.random(2)
        self.taps = random_taps(rng)

    def gain(self, time_s: np.ndarray) -> np.ndarray:
        """exp(j phi) at the given times."""
        swing = 2 * np.pi * self._swing_rate_hz * time_s + self._phases[0]
        index = self._swing_hz / self._swing_rate_hz
        phi = 2 * np.pi * self._steady_hz * time_s + index * np.sin(swing) + self._phases[1]
        return np.exp(1j * phi)


# Standard deviations of a noise component that count as its peak.
NOISE_PEAK = 4.5


class Levels:
    """Converts the levels of a scene to amplitudes; sent is the root of the mean preamble power."""

    def __init__(self, scene: Scene, amplitude: float) -> None:
        self._waveform, self._sent = scene.waveform(), amplitude
        averaging_cycles = scene.sensors[0].clock_hz * self._waveform.averaging_s
        self._tag_line = float(0.25 * np.sinc(0.25) * np.sinc(averaging_cycles))

    def amplitude(self, level_db: float | None) -> float:
        """Amplitude that is ``level_db`` above |c1[1] G1|; 0 for None."""
        return 0.0 if level_db is None else self._tag_line * 10 ** (level_db / 20)

    def scaled(self, taps: np.ndarray, amplitude: float) -> np.ndarray:
        """Taps scaled to an rms amplitude over the occupied subcarriers."""
        waveform = self._waveform
        cycles = np.outer(waveform.subcarriers, np.arange(len(taps))) / waveform.symbol_length
        response = np.exp(-2j * np.pi * cycles) @ taps
        return taps * (amplitude / np.sqrt(np.mean(np.abs(response) ** 2)))

    def noise(self, snr_db: float) -> float:
        """Standard deviation of the noise in a sample, from |c1[1] G1|^2 against that in H."""
        variance_h = self._tag_line**2 / 10 ** (snr_db / 10)
        return self._sent * float(np.sqrt(variance_h / self._waveform.channel_noise_gain))

    def frame_peak(self) -> float:
        """Largest magnitude of the transmitted frame."""
        return self._sent * float(np.abs(self._waveform.frame()).max())

    def peak(self, paths: Sequence[np.ndarray], noise_std: float) -> float:
        """Largest expected magnitude while frames are sent over paths of these taps, with noise."""
        frame = self._sent * np.tile(self._waveform.frame(), 2)
        longest = max(len(taps) for taps in paths)
        padded = [np.pad(taps, (0, longest - len(taps))) for taps in paths]
        total = np.sum([np.abs(np.convolve(frame, taps)) for taps in padded], axis=0)
        return float(total.max() + NOISE_PEAK * noise_std / np.sqrt(2))


BLADES = 3
# Part of a blade's amplitude that depends on how it faces the antennas.
_FLASH = 0.7
# Points of a revolution in which the mean power is computed.
_POINTS = 4096


class FanBlades:
    """The path by way of a fan's three blades, with lines at multiples of 3 f_r.

    At the angle a each has the gain (1 + 0.7 cos 2a) exp(j b cos a), b = f_d / f_r for the highest
    Doppler f_d and the revolutions f_r per second.
    """

    def __init__(self, stated: Fan, seeds: Seeds) -> None:
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

    def __init__(self, stated: Lamps, seeds: Seeds) -> None:
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

    Walks to and fro, at 0.6 to 1 of the highest speed, alternate with pauses; limbs swing by the
    way.
    """

    def __init__(self, stated: Walker, center_frequency_hz: float, seeds: Seeds) -> None:
        rng = seeds.generator()
        self._rng = seeds.generator(0)
        self._walk_s, self._trunk_hz = stated.walk_s, stated.highest_hz / _FASTEST_LIMB
        self._pause_s = stated.walk_s * (1 - stated.walking_share) / stated.walking_share
        self._wavelength_m = SPEED_OF_LIGHT_M_S / center_frequency_hz
        self._breath = rng.random()
        delay = rng.uniform(BASE_DELAY + 0.5, LAST_DELAY - 0.1)
        # Start, end, Doppler frequency of the trunk, and way in cycles before each walk.
        self._walks = np.zeros((1, 4))
        self._stride = 2 * STRIDE_M / self._wavelength_m  # in cycles of the carrier, two ways
        # Delay in samples, and start in cycles, of each limb.
        self._limbs = [(delay + 0.1 * rng.random(), rng.random()) for _ in LIMBS]

    def paths(self) -> list[tuple[np.ndarray, float, Callable]]:
        """Taps, amplitude and gain, a function of time, of each of :data:`LIMBS`."""
        return [
            (delay_taps(delay), float(np.sqrt(power)), partial(self._gain, swing, phase, start))
            for (power, swing, phase), (delay, start) in zip(LIMBS, self._limbs, strict=True)
        ]

    def _gain(self, swing: float, phase: float, start: float, time_s: np.ndarray) -> np.ndarray:
        """Gain of a limb, of magnitude 1, that swings by up to ``swing`` of the trunk's speed."""
        way = self._way(time_s)
        strides = way / self._stride + phase
        swung = swing * self._stride / (2 * np.pi) * np.sin(2 * np.pi * strides)
        breath = np.sin(2 * np.pi * (_BREATHING_HZ * time_s + self._breath))
        chest = 2 * _BREATHING_M / self._wavelength_m * breath
        return np.exp(2j * np.pi * ((way + swung + chest + start) % 1))

    def _way(self, time_s: np.ndarray) -> np.ndarray:
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


def _ramped(elapsed: np.ndarray, ramp: np.ndarray) -> np.ndarray:
    """Integral of a raised-cosine rise from 0 to 1 over ``ramp``, up to its end."""
    x = np.clip(elapsed / np.maximum(ramp, 1e-12), 0, 1)
    return ramp / 2 * (x - np.sin(np.pi * x) / np.pi)


_SWAY_HZ = 0.7


class NearHand:
    """Gain p exp(-j 4 pi d / lambda) of a path by way of a hand that comes and sways."""

    def __init__(
        self, stated: Hand, tag: SwitchedTag, scene: Scene, rng: np.random.Generator
    ) -> None:
        self._stated, self._pressed = stated, tag.pressed
        self._wavelength_mm = 1e3 * SPEED_OF_LIGHT_M_S / scene.radio.center_frequency_hz
        self._start, self._sway = rng.random(2)
        delay = stated.delay_s * scene.radio.sample_rate_hz
        self.taps = delay_taps(BASE_DELAY + delay)

    def gain(self, time_s: np.ndarray) -> np.ndarray:
        """The path's gain relative to that with the hand on the sensor."""
        near = self._pressed.near(time_s, self._stated.reach_s)
        swing = np.sin(2 * np.pi * (_SWAY_HZ * time_s + self._sway))
        distance_mm = self._stated.travel_mm * (1 - near) + self._stated.sway_mm * swing
        cycles = self._start - 2 * distance_mm / self._wavelength_mm
        return near * np.exp(2j * np.pi * cycles)


class UnlistedTag:
    """A tag whose sensor nobody presses: both ends reflect with constant phases."""

    def __init__(self, stated: OtherTag, scene: Scene, rng: np.random.Generator) -> None:
        self._rate = scene.radio.sample_rate_hz
        offset = stated.clock_offset_ppm
        self.clock = SwitchingClock(stated.clock_hz, offset, 0.0, abs(offset), rng.random())
        self._ends = np.exp(2j * np.pi * rng.random(2)).astype(np.complex64)
        delay = BASE_DELAY + stated.delay_s * self._rate
        self.taps = np.r_[np.zeros(BASE_DELAY), 1.0]
        if stated.delay_s:
            self.taps = delay_taps(delay)

    def reflection(self, first: int, count: int) -> np.ndarray:
        """Reflection r / rho during ``count`` samples."""
        states = switch_states(self.clock, SWITCHES["pulses"], 0.0, first, count, self._rate)
        return self._ends[0] * states[0] + self._ends[1] * states[1]


# FIR taps, and a gain from first sample and count to complex64 (count,).
ModulatedPath = tuple[np.ndarray, Callable[[int, int], np.ndarray]]


def modulated_paths(
    scene: Scene, levels: Levels, sources: RandomSources, ramp: Ramp
) -> list[ModulatedPath]:
    """The paths by way of everything but the scene's tags; slow gains at the knots of ``ramp``."""
    simulation = scene.simulation

    def slow(taps: np.ndarray, amplitude: float, gain: Callable) -> ModulatedPath:
        """A path whose gain, a function of time, is interpolated between knots."""
        return sources.rotated(levels.scaled(taps, amplitude)), partial(ramp.sampled, gain)

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
        paths += [slow(taps, level * amplitude, gain) for taps, amplitude, gain in person.paths()]
    if simulation.lamps:
        lamps = MainsLamps(simulation.lamps, sources.effect("lamps"))
        paths.append(slow(lamps.taps, levels.amplitude(simulation.lamps.level_db), lamps.gain))
    for index, stated in enumerate(simulation.other_tags):
        other = UnlistedTag(stated, scene, sources.effect("other_tags").generator(index))
        taps = levels.scaled(other.taps, 10 ** (stated.level_db / 20))
        paths.append((sources.rotated(taps), other.reflection))
    return paths


def tag_paths(
    scene: Scene, levels: Levels, sources: RandomSources, ramp: Ramp
) -> tuple[dict[str, SwitchedTag], list[ModulatedPath]]:
    """The scene's tags by sensor name, and the paths by way of them."""
    simulation = scene.simulation
    tags: dict[str, SwitchedTag] = {}
    paths: list[ModulatedPath] = []
    for index, tag in enumerate(simulation.tags):
        switched = SwitchedTag(scene, index, sources, ramp)
        rate_hz = scene.radio.sample_rate_hz
        fade = tag_taps(sources.paths, rate_hz, simulation.tag_coherence_hz)
        rotation = sources.rotated(np.ones(1))
        level = 10 ** (tag.level_db / 20)
        tags[switched.name] = switched
        paths.append((rotation * levels.scaled(fade, level), switched.reflection))
        if tag.hand:
            hand = NearHand(tag.hand, switched, scene, sources.effect("hand").generator(index))
            taps = levels.scaled(hand.taps, level * 10 ** (tag.hand.level_db / 20))
            paths.append((rotation * taps, partial(_by_tag_and_hand, switched, hand, ramp)))
    return tags, paths


def _by_tag_and_hand(
    tag: SwitchedTag, hand: NearHand, ramp: Ramp, first: int, count: int
) -> np.ndarray:
    """Gain of the path by way of tag and hand."""
    return ramp.sampled(hand.gain, first, count) * tag.reflection(first, count)
