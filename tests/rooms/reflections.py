# SPDX-License-Identifier: GPL-3.0-or-later
"""Reflections that move or change: people, fans, lamps."""

from dataclasses import dataclass

import numpy as np
from second_simulator import ACTIVE, CARRIER_HZ, RATE, subcarrier_power

from rooms.effects import FRAME_S, Effect, integral, random_walk, within_frames

# Phase of a reflection per metre that it moves along the line of sight, there and back.
RAD_PER_M = 4 * np.pi * CARRIER_HZ / 299792458.0


class Scatterers(Effect):
    """Reflections with their own gains, known at the frame edges: what moves slowly."""

    def set_paths(self, air, later_s, gains):
        """Gains (scatterers, frames + 1) of unit total power, and how much later each
        arrives than by way of the tag."""
        self.late = [air.path(later, self.level_db).astype(np.complex64) for later in later_s]
        self.gains = np.asarray(gains, np.complex64)
        self.peak = sum(np.abs(path).max() for path in self.late) / np.sqrt(len(self.late))

    def add(self, block, first):
        for path, gain in zip(self.late, self.gains, strict=True):
            block[:, :ACTIVE] += path[:ACTIVE] * within_frames(gain, first, len(block))


def smooth_step(x):
    x = np.clip(x, 0, 1)
    return x**3 * (10 - 15 * x + 6 * x * x)


@dataclass
class Walker(Scatterers):
    """A person who walks, halts and turns round, at up to 1.5 m/s towards the antennas.

    A torso with two arms and two legs, whose speeds swing about that of the torso: Doppler up to
    9 Hz at 900 MHz for the torso, 27 Hz for the feet.
    """

    level_db: float
    # (share of power, how far the speed swings about the torso's, phase of the stride)
    BODY = (
        (0.6, 0.1, 0.0),
        (0.1, 0.9, 0.5),
        (0.1, 0.9, 0.0),
        (0.1, 2.0, 0.0),
        (0.1, 2.0, 0.5),
    )

    def speed(self, t, rng):
        """Speeds between 0 and 1.5 m/s with smooth changes every half second or so."""
        speed, now, level = np.zeros_like(t), -rng.uniform(0, 0.6), 0.0
        while now < t[-1]:
            target = rng.choice([0, 1, 1, 1, -1]) * rng.uniform(0.5, 1.5)
            speed += (target - level) * smooth_step((t - now) / rng.uniform(0.25, 0.5))
            now, level = now + rng.uniform(0.4, 1.0), target
        return np.clip(speed, -1.5, 1.5)

    def begin(self, air, rng):
        t = air.edges_s
        speed = self.speed(t, rng)
        while np.sqrt(np.mean(speed**2)) < 0.5:
            speed = self.speed(t, rng)
        stride = 2 * np.pi * integral(0.7 * np.abs(speed)) + 2 * np.pi * rng.random()
        gains = []
        for share, swing, phase in self.BODY:
            away = integral(speed * (1 + swing * np.sin(stride + 2 * np.pi * phase)))
            start = 2 * np.pi * rng.random()
            gains.append(np.sqrt(share) * np.exp(1j * (RAD_PER_M * away + start)))
        self.set_paths(air, rng.uniform(-10e-9, 40e-9) + rng.uniform(0, 3e-9, 5), gains)


@dataclass
class Fan(Scatterers):
    """Three blades of points along their radius, seen from the side; ``doppler_hz`` at the tips.

    The spectrum consists of harmonics of the rotation, strongest at those of the blade rate, and
    ends at ``doppler_hz``. What stands still is left out: the level is that of what changes.
    """

    level_db: float
    doppler_hz: float = 200.0

    def begin(self, air, rng):
        tip_m = rng.uniform(0.18, 0.28)
        rotation_hz = self.doppler_hz / (RAD_PER_M * tip_m)
        unsteady = 1 + random_walk(rng, air.frames, 1e-3)[:, 0]
        turn = 2 * np.pi * (integral(rotation_hz * unsteady) + rng.random())
        angles = 2 * np.pi * np.arange(512) / 512
        pattern = np.zeros(512, complex)
        for blade in range(3):
            angle = angles + 2 * np.pi * blade / 3
            # No blade is exactly like another, and each flashes when it stands across.
            flash = (1 + 0.1 * rng.standard_normal()) * (0.3 + 0.7 * np.cos(angle) ** 2)
            for share in (0.4, 0.7, 1.0):
                pattern += flash * np.exp(1j * RAD_PER_M * share * tip_m * np.sin(angle))
        harmonics = np.fft.fft(pattern)
        highest = int(self.doppler_hz / rotation_hz)
        orders = [n for n in range(-highest, highest + 1) if n]
        power = sum(np.abs(harmonics[n]) ** 2 for n in orders)
        gain = sum(harmonics[n] * np.exp(1j * n * turn) for n in orders)
        self.set_paths(air, [rng.uniform(-10e-9, 60e-9)], [gain / np.sqrt(power)])
        self.peak *= 2


@dataclass
class Lamps(Effect):
    """Lamps that reflect more or less at twice the mains' frequency and all harmonics.

    ``level_db`` is that of the amplitude at 1 kHz (of the next harmonic, where the mains are at
    60 Hz), of which the lines at positive and negative frequency have half each; the amplitudes of
    harmonics fall as 1/h.
    """

    level_db: float
    mains_hz: float = 50.0
    wander_hz: float = 0.06  # random walk of the mains' frequency, per sqrt(second)
    harmonics: int = 120
    NODES = 9  # of linear interpolation within the active samples of a frame

    def begin(self, air, rng):
        frequency = 2 * (self.mains_hz + rng.uniform(-0.02, 0.02))
        frequency = frequency + 2 * random_walk(rng, air.frames, self.wander_hz)[:, 0]
        self.turns = integral(frequency) + rng.random()
        at = np.arange(8193) / 8192
        order = np.arange(1, self.harmonics + 1)[:, None]
        at_1k = round(1000 / (2 * self.mains_hz))
        size = at_1k / order / np.sqrt(3)
        # Lamps of one room, on different paths.
        self.late = [
            air.path(rng.uniform(-20e-9, 80e-9), self.level_db) * np.exp(2j * np.pi * rng.random())
            for _ in range(3)
        ]
        phases = rng.random((3, self.harmonics, 1))
        # Their lines add with random phases; at 1 kHz the sum has the stated level.
        turns = np.exp(2j * np.pi * phases[:, at_1k - 1])
        line = np.sum(turns * self.late, axis=0) / np.sqrt(3)
        size[at_1k - 1] *= air.line * 10 ** (self.level_db / 20) / np.sqrt(subcarrier_power(line))
        self.tables = [
            np.sum(size * np.cos(2 * np.pi * (order * at + phase)), axis=0) for phase in phases
        ]
        self.peak = sum(
            np.abs(path).max() * np.abs(table).max()
            for path, table in zip(self.late, self.tables, strict=True)
        )

    def add(self, block, first):
        count, steps = len(block), self.NODES - 1
        begin = self.turns[first : first + count, None]
        rate = self.turns[first + 1 : first + count + 1, None] - begin
        turns = begin + rate * np.arange(self.NODES) * (ACTIVE / steps / RATE / FRAME_S)
        turns = (turns % 1) * 8192
        whole = turns.astype(int)
        share = turns - whole
        along = np.arange(ACTIVE // steps) / (ACTIVE // steps)
        for path, table in zip(self.late, self.tables, strict=True):
            value = table[whole] * (1 - share) + table[whole + 1] * share
            gain = value[:, :-1, None] + np.diff(value)[:, :, None] * along
            block[:, :ACTIVE] += path[:ACTIVE] * gain.reshape(count, ACTIVE)


@dataclass
class HandPath(Effect):
    """A second path of our tag's signal, by way of the hand that presses.

    It appears and goes with the hand, 0.3 s before and after a press, and changes as the hand
    moves: some cm on its way, a few mm while it presses. The level is that of its power relative
    to the tag's own path.
    """

    level_db: float

    def begin(self, air, rng):
        t, self.tag = air.edges_s, air.tag
        near, away_m = np.zeros_like(t), np.full_like(t, 0.2)
        for start, rise, hold, *_ in self.tag.tag.presses:
            end = start + 2 * rise + hold
            here = smooth_step((t - start + 0.3) / 0.3) * smooth_step((end + 0.3 - t) / 0.3)
            near = np.maximum(near, here)
            away_m = np.where(here > 0, 0.2 * (1 - here), away_m)
        tremor_m = 2e-3 * np.sin(2 * np.pi * (rng.uniform(1, 4) * t + rng.random()))
        turn = RAD_PER_M * (away_m + tremor_m) + 2 * np.pi * rng.random()
        self.gain = near * np.exp(1j * turn)
        own_db = 20 * np.log10(np.sqrt(subcarrier_power(self.tag.late)) / air.line)
        self.late = air.path(rng.uniform(1e-9, 5e-9), own_db + self.level_db)
        self.peak = np.abs(self.late).max()

    def add(self, block, first):
        gain = within_frames(self.gain, first, len(block))
        block[:, :ACTIVE] += self.late[:ACTIVE] * gain * self.tag.reflection
