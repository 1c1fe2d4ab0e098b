# SPDX-License-Identifier: GPL-3.0-or-later
"""What an effect may change, and the tag whose clock is not ideal.

Levels in dB are relative to |c1[1] G1|^2 of the tag that is read, as the static level of
``second_simulator``, unless they are said to be relative to the receiver's noise.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from second_simulator import (
    ACTIVE,
    FRAME,
    RATE,
    delayed,
    phases,
    pressed,
    subcarrier_power,
    switched,
)

FRAME_S = FRAME / RATE
TAG_DELAY_S = 0.15e-6  # of the tag that is read
INSIDE = np.arange(ACTIVE) / FRAME  # position of the active samples within a frame, 0 to 1


@dataclass
class Air:
    """What every effect can refer to.

    ``line`` is |c1[1]| of the tag that is read, ``noise`` the rms of the receiver's noise per
    complex sample, ``sent`` the frame as it leaves the antenna, ``frames`` the capture's length,
    ``tag`` the tag that is read, a ``SwitchedTag``.
    """

    line: float
    noise: float
    sent: np.ndarray
    frames: int
    tag: object = None

    @property
    def edges_s(self):
        """Times of all frame starts and of the end, (frames + 1,)."""
        return np.arange(self.frames + 1) * FRAME_S

    def path(self, later_s, level_db):
        """A frame so much later than by way of the tag; its level is power over the subcarriers.

        What is in the tag's room is rarely more than some 50 ns (15 m) later or earlier.
        """
        late = delayed(self.sent, TAG_DELAY_S + later_s)
        return late * self.line * 10 ** (level_db / 20) / np.sqrt(subcarrier_power(late))


class Effect:
    """An effect that changes nothing. ``begin`` is called first, with a generator of its own.

    ``first`` is always the index of the first frame of a block; a block is (frames, 720).
    """

    peak = 0.0  # highest amplitude that it adds, for the receiver's gain

    def alter_scene(self, scene):
        """Change the description that the reader gets."""

    def alter_tag(self, tag, rng):
        """Change the tag that is read, an ideal ``SwitchedTag``."""

    def transmit(self, sent, rng):
        return sent

    def begin(self, air, rng):
        pass

    def add(self, block, first):
        """Add what arrives at the antenna, in place."""

    def receive(self, block, first, peak):
        """The receiver's own doing, after noise; ``peak`` is its largest input."""
        return block


def within_frames(values, first, count):
    """From values at frame edges to linear ones at the active samples, (count, 344)."""
    begin = values[first : first + count, None]
    end = values[first + 1 : first + count + 1, None]
    return begin + (end - begin) * INSIDE.astype(values.real.dtype)


def random_walk(rng, frames, per_sqrt_s, ends=1):
    """Random walks at the frame edges that start at 0, (frames + 1, ends)."""
    steps = per_sqrt_s * np.sqrt(FRAME_S) * rng.standard_normal((frames, ends))
    return np.concatenate([np.zeros((1, ends)), np.cumsum(steps, axis=0)])


def integral(values):
    """Trapezoidal integral over time of values at the frame edges, (frames + 1,)."""
    return np.concatenate([[0], np.cumsum((values[1:] + values[:-1]) / 2) * FRAME_S])


@dataclass
class Switches:
    """Two switches on one clock, with the errors of real ones."""

    clock_hz: float
    offset_ppm: float = 0.0
    drift_ppm_per_s: float = 0.0
    start_cycles: float = 0.0
    wander_ppm: float = 0.0  # random walk of the frequency, per sqrt(second)
    jitter_s: float = 0.0  # rms error of every period's length
    duty: tuple = (0.25, 0.25)  # of clocks 1 and 2
    delay_s: float = 0.0  # of clock 2
    rise_s: float = 0.0
    cycles: np.ndarray = field(init=False, default=None)

    def begin(self, air, rng):
        """Run the clock: cycles at all frame edges."""
        t = air.edges_s
        late = t * self.offset_ppm * 1e-6 + self.drift_ppm_per_s * 1e-6 * t * t / 2
        late += integral(random_walk(rng, air.frames, self.wander_ppm * 1e-6)[:, 0])
        periods = int(t[-1] * self.clock_hz) + 2
        walk = np.cumsum(self.jitter_s * rng.standard_normal(periods))
        late += np.interp(t, np.arange(periods) / self.clock_hz, walk)
        self.cycles = self.start_cycles + self.clock_hz * (t + late)

    def on(self, first, count):
        """How far each switch is on at the active samples; edges take a sample or the rise."""
        cycles = within_frames(self.cycles, first, count)
        slope = 1 / (self.clock_hz * max(self.rise_s, 1 / RATE))
        both = switched(cycles, cycles - self.delay_s * self.clock_hz, slope, self.duty)
        return [on.astype(np.float32) for on in both]


class SwitchedTag:
    """The tag that is read: pressed as its description says, switched by its own clock."""

    def __init__(self, tag, rng):
        self.tag = tag
        self.switches = Switches(
            tag.clock_hz, tag.offset_ppm, tag.drift_ppm_per_s, start_cycles=rng.random()
        )
        self.drift_deg_per_sqrt_s = 0.0

    def begin(self, air, rng):
        self.late = 10 ** (self.tag.level_db / 20) * delayed(air.sent, TAG_DELAY_S)
        self.switches.begin(air, rng)
        self.drift_deg = random_walk(rng, air.frames, self.drift_deg_per_sqrt_s, ends=2)

    def add(self, block, first):
        count = len(block)
        t = (first + np.arange(count)) * FRAME_S + 16e-6
        psi = phases(self.tag, *pressed(self.tag, t)) + self.drift_deg[first : first + count]
        ends = np.exp(1j * np.deg2rad(psi)).astype(np.complex64)
        s1, s2 = self.switches.on(first, count)
        self.reflection = s1 * ends[:, :1] + s2 * ends[:, 1:]  # of this block
        if self.tag.off:
            self.reflection += (1 - s1 - s2) * np.complex64(self.tag.off)
        block[:, :ACTIVE] += self.late[:ACTIVE].astype(np.complex64) * self.reflection


@dataclass
class Clock(Effect):
    """The tag's clock and switches are not ideal; the scene states only the tolerance."""

    offset_ppm: float = 25.0
    wander_ppm: float = 0.0
    jitter_s: float = 0.0
    duty: tuple = (0.25, 0.25)
    delay_s: float = 0.0
    rise_s: float = 0.0
    tolerance_ppm: float = 100.0

    def alter_scene(self, scene):
        scene["sensors"][0]["clock_tolerance_ppm"] = self.tolerance_ppm

    def alter_tag(self, tag, rng):
        for key in ("offset_ppm", "wander_ppm", "jitter_s", "duty", "delay_s", "rise_s"):
            setattr(tag.switches, key, getattr(self, key))


@dataclass
class Drift(Effect):
    """The phases of both ends walk, touched or not: ``deg`` rms after ``over_s`` seconds."""

    deg: float = 6.0
    over_s: float = 20.0

    def alter_tag(self, tag, rng):
        tag.drift_deg_per_sqrt_s = self.deg / np.sqrt(self.over_s)


@dataclass
class Stated(Effect):
    """The scene states this as well, true or not."""

    sections: dict

    def alter_scene(self, scene):
        scene.update(self.sections)


@dataclass
class Leak(Effect):
    """Open switches reflect as well, and the scene states how."""

    off: complex = 0.15 * np.exp(2.1j)

    def alter_scene(self, scene):
        scene["sensors"][0]["off_reflection"] = [float(self.off.real), float(self.off.imag)]

    def alter_tag(self, tag, rng):
        tag.tag = replace(tag.tag, off=self.off)


@dataclass
class OtherSensors(Effect):
    """Further tags that are pressed as their descriptions say."""

    tags: tuple

    def begin(self, air, rng):
        self.switched = [SwitchedTag(tag, rng) for tag in self.tags]
        for tag in self.switched:
            tag.begin(air, rng)
        self.peak = sum(np.abs(tag.late).max() for tag in self.switched)

    def add(self, block, first):
        for tag in self.switched:
            tag.add(block, first)


class UntouchedTag(Effect):
    """A tag that nobody touches; ``begin`` sets its ``switches`` and the reflections ``ends``."""

    def arrive(self, air, later_s):
        """Set the frame by way of this tag, so much later than by way of ours."""
        self.late = 10 ** (self.level_db / 20) * delayed(air.sent, TAG_DELAY_S + later_s)
        self.peak = np.abs(self.late).max()

    def add(self, block, first):
        s1, s2 = self.switches.on(first, len(block))
        block[:, :ACTIVE] += self.late[:ACTIVE] * (s1 * self.ends[0] + s2 * self.ends[1])


@dataclass
class OtherTag(UntouchedTag):
    """A tag that the scene does not list."""

    clock_hz: float
    level_db: float
    offset_ppm: float | None = None  # None: any within 60 ppm
    later_s: float | None = None  # than ours; None: any within -15 to 40 ns

    def begin(self, air, rng):
        offset = rng.uniform(-60, 60) if self.offset_ppm is None else self.offset_ppm
        self.switches = Switches(
            self.clock_hz, offset, rng.uniform(-0.3, 0.3), start_cycles=rng.random()
        )
        self.switches.begin(air, rng)
        self.ends = np.exp(2j * np.pi * rng.random(2))
        self.arrive(air, rng.uniform(-15e-9, 40e-9) if self.later_s is None else self.later_s)


def near_tag(apart_ppm, level_db=-10.0, later_s=None):
    """A tag of the same kind as ours, a few ppm beside it."""
    return OtherTag(1000.0, level_db, 25.0 + apart_ppm, later_s)
