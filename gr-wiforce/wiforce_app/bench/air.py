# SPDX-License-Identifier: GPL-3.0-or-later
"""Channel snapshots of tags, static and moving clutter, and noise, from the signal model alone.

The benchmarks use it to assess the estimators, so it shares only the sounding frame with them;
clocks and switches are those of simulated captures.
"""

from dataclasses import dataclass

import numpy as np
from gnuradio.wiforce.signal.bound import phase_bound_deg
from gnuradio.wiforce.simulation.tag import SWITCHES, SwitchingClock, states_at

# Fourier coefficient of line 1 of switch 1, without averaging: sin(pi/4) / pi.
_FIRST_LINE = 0.22507907903927651
_DELAY_SPACING_S = 20e-9
_WIDEST_OFFSET_PPM = 100.0  # of a drifting clock, unless it begins beyond
_WALKER = (30.0, 0.31)  # highest Doppler shift (Hz), swings per second
_FAN = (200.0, 1.7)


@dataclass(frozen=True)
class TagOnAir:
    """One tag: its clock, level relative to gamma, and end phases before and during a touch."""

    clock_hz: float = 1000.0
    level_db: float = 0.0
    offset_ppm: float = 0.0
    drift_ppm_per_s: float = 0.0
    start_cycles: float = 0.0
    untouched_deg: tuple = (0.0, 0.0)
    touched_deg: tuple = (0.0, 0.0)
    off_reflection: complex = 0.0
    clock2_delay_cycles: float = 0.0


@dataclass(frozen=True)
class PathLevels:
    """Levels in dB: |a_k|^2 over the noise in H, clutter over line 1 of end 1; None for none."""

    gamma_db: float
    static_db: float | None = None
    movers_db: float | None = None
    coherence_hz: float | None = 2e6


def fading(rng, subcarrier_hz, coherence_hz):
    """A Rayleigh channel with exponential delay profile and unit mean power; shape (K,)."""
    if coherence_hz is None:
        return np.full(len(subcarrier_hz), np.exp(2j * np.pi * rng.random()))
    spread_s = 1 / (2 * np.pi * coherence_hz)
    delays = np.arange(0, 8 * spread_s, _DELAY_SPACING_S)
    taps = rng.standard_normal(len(delays)) + 1j * rng.standard_normal(len(delays))
    taps *= np.exp(-delays / spread_s / 2)
    channel = np.exp(-2j * np.pi * np.outer(subcarrier_hz, delays)) @ taps
    return channel / np.sqrt(np.mean(np.abs(channel) ** 2))


class Air:
    """Snapshots of the channel, group by group, with ``channels`` and ``noise`` (K,) known."""

    def __init__(self, waveform, group_length, tags, levels, seed, noise_profile=None):
        self._rng = np.random.default_rng(seed)
        self._length, self._tags = group_length, tuple(tags)
        self._period_s = waveform.snapshot_period_s
        self._window_s = waveform.averaging_s
        hertz = waveform.subcarriers * waveform.spacing_hz
        coherence = levels.coherence_hz
        self.channels = [
            fading(self._rng, hertz, coherence) * 10 ** (tag.level_db / 20) for tag in tags
        ]
        profile = np.ones(len(hertz)) if noise_profile is None else noise_profile
        self.noise = 10 ** (-levels.gamma_db / 10) * profile
        self._noise_scale = np.repeat(np.sqrt(self.noise / 2), 2).astype(np.float32)
        self._static = self._path(hertz, levels.static_db)
        self._movers = []
        if levels.movers_db is not None:
            shared = levels.movers_db - 10 * np.log10(2)
            self._movers = [
                (self._path(hertz, shared), *mover, *self._rng.random(2))
                for mover in (_WALKER, _FAN)
            ]
        self.clocks = [
            SwitchingClock(
                t.clock_hz,
                t.offset_ppm,
                t.drift_ppm_per_s,
                max(_WIDEST_OFFSET_PPM, abs(t.offset_ppm)),
                t.start_cycles,
            )
            for t in tags
        ]

    def _path(self, hertz, level_db):
        amplitude = 0.0 if level_db is None else _FIRST_LINE * 10 ** (level_db / 20)
        return amplitude * fading(self._rng, hertz, 2e6)

    def times_s(self, group):
        """Times of a group's snapshots; shape (N,)."""
        return (group * self._length + np.arange(self._length)) * self._period_s

    def ends(self, touched):
        """a_k D_i of every end, D_i = G_i - G_off; shape (2S, K)."""
        rows = []
        for tag, channel in zip(self._tags, self.channels, strict=True):
            for degrees in tag.touched_deg if touched else tag.untouched_deg:
                rows.append(channel * (np.exp(1j * np.radians(degrees)) - tag.off_reflection))
        return np.array(rows)

    def bound_deg(self, touched=True, **settings):
        """Bound (2S,) of the phases of a group that starts with the scene; in degrees."""
        clocks = [
            (clock.clock_hz * (1 + 1e-6 * clock.offset_ppm(0.0)), 2 * np.pi * clock.cycles(0.0))
            for clock in self.clocks
        ]
        ends, times = self.ends(touched), self.times_s(0)
        return phase_bound_deg(ends, self.noise, clocks, times, self._window_s, **settings)

    def group(self, index, touched=False, on=True):
        """H (N, K) of a group, in order; ``touched`` and ``on`` are bools, or (N,) from 0 to 1."""
        times = self.times_s(index)
        courses, paths = [np.ones(self._length)], [self._static]
        for path, highest_hz, swing_hz, start, swing_start in self._movers:
            swing = np.sin(2 * np.pi * (swing_hz * times + swing_start)) / swing_hz
            courses.append(np.exp(1j * (highest_hz * swing + 2 * np.pi * start)))
            paths.append(path)
        present = np.broadcast_to(on, len(self._tags))
        for tag, clock, channel, is_on in zip(
            self._tags, self.clocks, self.channels, present, strict=True
        ):
            if is_on:
                courses.append(self._reflection(tag, clock, times, touched))
                paths.append(channel)
        snapshots = np.stack(courses, axis=1) @ np.array(paths)
        snapshots += self._draw_noise()
        return snapshots

    def _draw_noise(self):
        shape = (self._length, 2 * len(self.noise))
        noise = self._rng.standard_normal(shape, dtype=np.float32)
        noise *= self._noise_scale
        return noise.view(np.complex64)

    def _reflection(self, tag, clock, times, touched):
        delay_s = tag.clock2_delay_cycles / tag.clock_hz
        states = states_at(clock, SWITCHES["pulses"], delay_s, times, self._window_s)
        share = np.asarray(touched, float)[..., None]
        before, after = np.array(tag.untouched_deg), np.array(tag.touched_deg)
        ends = np.exp(1j * np.radians(before + share * (after - before)))
        off = tag.off_reflection
        return np.sum(np.transpose(states) * (ends - off), axis=-1) + off
