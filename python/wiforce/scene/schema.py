# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes: what is measured, with what, and - for simulations - what happens.

Frozen dataclasses that mirror the sections of a scene file (:func:`load.load_scene`). Keys and
defaults are listed in docs/scenes.md.
"""

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path

from ..signal.waveform import sounding_waveform


@dataclass(frozen=True)
class Radio:
    center_frequency_hz: float
    sample_rate_hz: float


@dataclass(frozen=True)
class Sounding:
    waveform: str
    frame_length: int


@dataclass(frozen=True)
class PhaseGroup:
    """Snapshots per reading, and how phases are had from them (``estimation.estimators``)."""

    snapshots: int
    estimator: str


@dataclass(frozen=True)
class SceneSensor:
    """A sensor in a scene; ``off_reflection`` is G_off / rho per switch."""

    name: str
    model: str
    clock_hz: float
    clock_tolerance_ppm: float
    off_reflection: tuple

    def load_model(self, scene):
        """The reader's model of this sensor (see ``sensor.load_sensor``)."""
        return scene.load_model(self.model)


@dataclass(frozen=True)
class Environment:
    moving_clutter_hz: float
    reader_clock: str
    receive_antennas: int = 1


@dataclass(frozen=True)
class Press:
    """A press: force rises from 0, goes linearly to ``end_force_n``, falls again to 0.

    ``tremor_n`` is the rms of a hand's tremor about that.
    """

    sensor: str
    start_s: float
    rise_s: float
    hold_s: float
    force_n: float
    end_force_n: float
    location_mm: float
    tremor_n: float = 0.0

    @property
    def end_s(self):
        return self.start_s + self.hold_s + 2 * self.rise_s


@dataclass(frozen=True)
class Move:
    """A sensor's tag moves: its two-way path grows by twice ``distance_mm``."""

    sensor: str
    start_s: float
    duration_s: float
    distance_mm: float


@dataclass(frozen=True)
class Tag:
    """What a simulation knows of one sensor's tag, and a reader does not."""

    sensor: str
    truth_model: str
    level_db: float
    clock_offset_ppm: float
    clock_drift_ppm_per_s: float
    clock_phase_deg: float | None
    clock2_delay_s: float
    clock2_duty: str


@dataclass(frozen=True)
class Simulation:
    duration_s: float
    seed: int
    snr_db: float
    static_clutter_db: float | None
    moving_clutter_db: float | None
    moving_clutter_hz: float
    tag_coherence_hz: float | None
    carrier_offset_hz: float
    phase_noise_hz: float
    adc_bits: int | None
    tags: tuple
    presses: tuple
    moves: tuple


@dataclass(frozen=True)
class Scene:
    """A checked scene. ``path`` is its file, None for a scene given as a dict."""

    radio: Radio
    sounding: Sounding
    phase_group: PhaseGroup
    sensors: tuple
    environment: Environment
    reference_s: float
    simulation: Simulation
    path: Path | None = field(default=None, compare=False)

    def waveform(self):
        """The sounding frame of this scene (``waveform.Waveform``)."""
        return sounding_waveform(
            self.sounding.waveform, self.sounding.frame_length, self.radio.sample_rate_hz
        )

    @property
    def snapshot_period_s(self):
        return self.sounding.frame_length / self.radio.sample_rate_hz

    @property
    def group_samples(self):
        """Samples in a phase group."""
        return self.phase_group.snapshots * self.sounding.frame_length

    @property
    def group_period_s(self):
        return self.group_samples / self.radio.sample_rate_hz

    @property
    def sensor_names(self):
        return tuple(sensor.name for sensor in self.sensors)

    def load_model(self, name):
        """A sensor model by shipped name, or by path relative to the scene file."""
        from ..sensor import load_sensor

        return load_sensor(name, relative_to=self.path.parent if self.path else None)

    def as_dict(self):
        """The scene with all defaults filled in, as plain values that YAML and JSON can hold."""
        return _plain({k: v for k, v in dataclasses.asdict(self).items() if k != "path"})


def _plain(value):
    if isinstance(value, complex):
        return [value.real, value.imag]
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
