# SPDX-License-Identifier: GPL-3.0-or-later
"""The rooms, random mixtures of their effects, and the files of a capture in one of them."""

import copy
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import second_simulator as simple
import yaml
from second_simulator import CARRIER_HZ, FRAME, GROUP, RATE, Line, Tag

from rooms import effects as e
from rooms import radio, reflections
from rooms.undetectable import CASES

PRESSES = ((0.7, 0.05, 0.75, 3.0, 5.5, 33.0), (1.65, 0.05, 0.75, 6.0, 4.0, 54.0))
FOUR_PRESSES = tuple(
    (0.7 + 0.9 * i, 0.05, 0.5, first, last, place)
    for i, (first, last, place) in enumerate(
        [(3.0, 5.5, 33.0), (6.0, 4.0, 54.0), (2.0, 4.0, 45.0), (5.0, 7.0, 27.0)]
    )
)
LONG_PRESSES = ((0.8, 0.05, 2.8, 3.0, 5.5, 33.0), (4.4, 0.05, 2.8, 6.0, 4.0, 54.0))
TAPS = tuple(
    (0.6 + 0.1 * i, 0.01, 0.06, force, force, place)
    for i, (force, place) in enumerate([(3.0, 33.0), (6.0, 54.0), (4.5, 33.0), (4.0, 54.0)] * 4)
)


@dataclass(frozen=True)
class Room:
    """A room, and what is expected of a reader in it.

    ``readable``: at least 70 % of steady touches are read without a flag. ``phase_deg`` and
    ``force_n``: limits of phase rms and of the median force error, where they are known; 80 % are
    then to be read. ``refusable``: to refuse the capture is right.
    """

    effects: tuple = ()
    readable: bool = True
    phase_deg: float | None = None
    force_n: float | None = None
    refusable: bool = False
    snr_db: float = 10.0
    static_db: float = 50.0
    clock_hz: float = 1000.0
    presses: tuple = PRESSES
    duration_s: float = 2.6
    group: int = GROUP  # snapshots of a phase group
    line: Line = Line()  # that was calibrated

    @property
    def tag(self):
        return Tag(clock_hz=self.clock_hz, line=self.line, presses=self.presses)


def _rooms():
    rooms = {"clean": Room(phase_deg=0.055, force_n=0.1)}
    for level in (-10, 0, 10, 20, 30):
        rooms[f"walker{level:+d}"] = Room((reflections.Walker(level),))
        rooms[f"fan{level:+d}"] = Room((reflections.Fan(level),))
    for name, moves in (("walker+30", 30.0), ("fan+30", 200.0)):
        rooms[f"{name}-declared"] = Room(
            (*rooms[name].effects, e.Stated({"environment": {"moving_clutter_hz": moves}}))
        )
    rooms["three-walkers+20"] = Room((reflections.Walker(20),) * 3)
    for clock in (2000, 500, 1300, 1790, 1400):
        for level in (-10, 10, 30):
            # Lines of the others coincide with some of ours, all or the seventh.
            readable = clock in (1300, 1790)
            room = Room((e.OtherTag(clock, level),), readable)
            rooms[f"tag-{clock}{level:+d}"] = room
    for clock in (2000, 500):
        rooms[f"tag-{clock}-10-same-delay"] = Room((e.OtherTag(clock, -10, later_s=0.0),), False)
    for apart in (5, 20, 60):
        rooms[f"near-tag-{apart}ppm"] = Room((e.near_tag(apart),), False)
        rooms[f"near-tag-{apart}ppm-same-delay"] = Room((e.near_tag(apart, later_s=0.0),), False)
    rooms["near-tag-20ppm+10"] = Room((e.near_tag(20, 10),), False)
    sent, received = radio.TransmitterImage, radio.ReceiverImage
    rooms |= {
        "image-30": Room((received(-30),), phase_deg=0.1, force_n=0.1),
        "image-23": Room((received(-23),), False),
        "sent-image-30": Room((sent(-30),), phase_deg=0.05, force_n=0.07),
        "sent-image-23": Room((sent(-23),), False),
        "both-images-30": Room((sent(-30), received(-30)), phase_deg=0.1, force_n=0.1),
        "iq-raw": Room(
            (
                received(gain_db=0.5, phase_deg=3.0),
                radio.DcOffset(0.05),
                radio.Compression(0.01),
            ),
            phase_deg=0.2,
            force_n=0.15,
        ),
        "iq-calibrated": Room(
            (received(gain_db=0.1, phase_deg=0.6),), phase_deg=0.05, force_n=0.07
        ),
        "compression-1": Room((radio.Compression(0.01),)),
        "compression-4": Room((radio.Compression(0.04),), False),
        "lamps-10": Room((reflections.Lamps(-10),), False),
        "lamps-25": Room((reflections.Lamps(-25),)),
        "lamps-10-at-1040": Room(
            (reflections.Lamps(-10),), phase_deg=0.08, force_n=0.1, clock_hz=1040.0
        ),
        "lamps-60hz-10": Room((reflections.Lamps(-10, mains_hz=60.0),), False),
        "ripple": Room((radio.Ripple(),), False),
        "phase-noise": Room((radio.PhaseNoise(),)),
        "bursts-20": Room((radio.Bursts(0.2, 25),), phase_deg=0.06, force_n=0.08),
        "bursts-45": Room((radio.Bursts(0.45, 35),), phase_deg=0.1, force_n=0.1),
        "hopper": Room((radio.Hopper(0.5, 30),), phase_deg=0.06, force_n=0.08),
        "overloading-bursts": Room((radio.OverloadingBursts(0.02, 65),), False),
        "second-reader+10": Room((radio.SecondReader(10),), False),
        "second-reader+30": Room((radio.SecondReader(30),), False),
        "hand-30": Room((reflections.HandPath(-30),), False),
        "hand-20": Room((reflections.HandPath(-20),), False),
        "duty": Room(
            (e.Clock(duty=(0.2485, 0.2510), delay_s=1e-6, rise_s=0.5e-6),),
            phase_deg=0.05,
            force_n=0.07,
        ),
        "resonator": Room(
            (e.Clock(700.0, wander_ppm=20, jitter_s=0.3e-6, tolerance_ppm=1000.0),),
            phase_deg=0.065,
            force_n=0.07,
        ),
        "no-crystal": Room(
            (e.Clock(3000.0, 20.0, 0.3e-6, (0.242, 0.259), 3e-6, 2e-6, tolerance_ppm=5000.0),),
            phase_deg=0.15,
            force_n=0.15,
        ),
        "drift": Room((e.Drift(),), presses=LONG_PRESSES, duration_s=7.6),
        "taps": Room(phase_deg=0.08, force_n=0.07, presses=TAPS, group=125),
        "half-frame": Room(
            (e.Stated({"sounding": {"frame_length": FRAME // 2}}),), False, refusable=True
        ),
    }
    return rooms


ROOMS = _rooms()
OTHER_TRANSMITTERS = {
    "bursts-30-weak": Room((radio.Bursts(0.3, 10),)),
    "bursts-20-short": Room((radio.Bursts(0.2, 25, (20e-6, 60e-6)),)),
}
# What the scene describes, or what only its levels make difficult.
DESCRIBED = {
    "leaky": Room((e.Leak(),), phase_deg=0.06, force_n=0.15),
    "faint": Room(phase_deg=1.0, force_n=0.5, snr_db=-15.0, static_db=40.0),
}
UNDETECTABLE = {
    name: Room((effect,), False, presses=FOUR_PRESSES, duration_s=4.3, line=line)
    for name, (line, effect) in CASES.items()
}
# Of docs/rooms.md and docs/theory.md.
TABLES = {
    "undetectable": list(UNDETECTABLE),
    "interference": ["clean", "bursts-20", "bursts-45", *OTHER_TRANSMITTERS, "hopper"],
}


def mixture(seed):
    """Two to four different effects at random levels; the same seed gives the same room."""
    rng = np.random.default_rng([seed, 99])

    def level(low, high):
        return round(float(rng.uniform(low, high)), 1)

    def clock():
        return float(rng.choice([2000, 500, 1300, 1790, 1400]))

    makers = [
        lambda: reflections.Walker(level(-10, 30)),
        lambda: reflections.Fan(level(-10, 30), level(60, 200)),
        lambda: e.OtherTag(clock(), level(-10, 30), None),
        lambda: e.near_tag(level(5, 60), level(-20, -5)),
        lambda: radio.ReceiverImage(level(-40, -23)),
        lambda: radio.TransmitterImage(level(-40, -23)),
        lambda: radio.Compression(level(0.5, 4) / 100),
        lambda: radio.DcOffset(0.05),
        lambda: reflections.Lamps(level(-35, -10), float(rng.choice([50, 60]))),
        lambda: radio.Ripple(level(1, 10) / 100),
        lambda: radio.Bursts(level(0.1, 0.5), level(10, 35)),
        lambda: radio.Hopper(level(0.2, 0.6), level(10, 35)),
        lambda: e.Clock(
            level(-95, 95), level(0, 20), level(0, 0.3) * 1e-6, (0.249, 0.251), 0.5e-6, 0.5e-6
        ),
        lambda: e.Drift(level(1, 6)),
    ]
    chosen = rng.choice(len(makers), rng.integers(2, 5), replace=False)
    return Room(tuple(makers[i]() for i in sorted(chosen)), readable=False)


def room_named(name):
    """A room of the tables, or ``mixture-SEED``."""
    if name.startswith("mixture-"):
        return mixture(int(name.removeprefix("mixture-")))
    return (UNDETECTABLE | OTHER_TRANSMITTERS | DESCRIBED | ROOMS)[name]


class Capture:
    """The samples of a room for one seed; ``tag`` in place of the room's.

    Every effect draws from a generator of its own.
    """

    def __init__(self, room, seed, tag=None):
        self.frames = math.floor(room.duration_s * RATE / FRAME) // GROUP * GROUP
        self.effects = copy.deepcopy(room.effects)
        generators = [np.random.default_rng([seed, 10 + i]) for i in range(len(self.effects))]
        effects = list(zip(self.effects, generators, strict=True))
        self.noise_rng, rng = np.random.default_rng([seed, 2]), np.random.default_rng([seed, 3])
        averaging = np.sinc(room.clock_hz * 256 / RATE)
        line = 0.25 * np.sinc(0.25) * averaging
        noise = line / 10 ** (room.snr_db / 20) * np.sqrt(4 * 64 / 62)
        sent = simple.frame()
        for effect, own in effects:
            sent = effect.transmit(sent, own)
        self.air = e.Air(line, noise, sent, self.frames)
        self.still = self.static(rng, room.static_db)
        self.tag = self.air.tag = e.SwitchedTag(tag or room.tag, rng)
        for effect, own in effects:
            effect.alter_tag(self.tag, own)
        self.tag.begin(self.air, rng)
        for effect, own in effects:
            effect.begin(self.air, own)
        self.peak = np.max(np.abs(self.still) + np.abs(self.tag.late))
        self.peak += 3.5 * noise + sum(effect.peak for effect in self.effects)

    def static(self, rng, level_db):
        """The direct path, earlier than by way of the tag, and five reflections."""
        later = [rng.uniform(-30e-9, 0), *rng.uniform(-20e-9, 150e-9, 5)]
        levels = (1, 0.3, 0.2, 0.2, 0.1, 0.1)
        still = sum(
            level * np.exp(2j * np.pi * rng.random()) * self.air.path(delay, 0)
            for delay, level in zip(later, levels, strict=True)
        )
        power = simple.subcarrier_power(still)
        return still * self.air.line * 10 ** (level_db / 20) / np.sqrt(power)

    def blocks(self):
        """Received samples, 3 dB below full scale: arrays (625, 720)."""
        scale = 10 ** (-3 / 20) / self.peak
        for first in range(0, self.frames, GROUP):
            block = np.empty((GROUP, FRAME), np.complex64)
            block[:] = self.still
            for source in (self.tag, *self.effects):
                source.add(block, first)
            noise = radio.normal(self.noise_rng, block.size).reshape(block.shape)
            block += np.float32(self.air.noise) * noise
            for effect in self.effects:
                block = effect.receive(block, first, self.peak)
            yield np.float32(scale) * block


def scene_of(room):
    """What the reader knows: only our tag, nothing about the room."""
    scene = {
        "sensors": [{"name": "finger", "model": "finger.yaml", "clock_hz": room.clock_hz}],
        "radio": {"center_frequency_hz": CARRIER_HZ, "sample_rate_hz": RATE},
        "phase_group": {"snapshots": room.group},
        "reference_s": 0.5,
    }
    for effect in room.effects:
        effect.alter_scene(scene)
    return scene


def write_room(room, seed, folder):
    """Write ``finger.csv`` (VNA), ``scene.yaml`` and ``capture``.

    The VNA table depends on tag and seed alone.
    """
    folder = Path(folder)
    simple.write_vna(room.tag, folder / "finger.csv", np.random.default_rng([seed, 1]))
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene_of(room), sort_keys=False))
    simple.write_capture(Capture(room, seed).blocks(), folder / "capture")
