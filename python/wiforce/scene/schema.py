# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes: what is measured, with what, and - for simulations - what happens.

A scene file is YAML; :func:`load_scene` checks it completely and returns frozen dataclasses that
mirror its sections. Keys and defaults are listed in docs/scenes.md.
"""

import dataclasses
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path

from ..errors import InputError
from ..waveform import sounding_waveform
from ..yamlfile import Section, read_yaml

MAX_SENSORS = 16
MAX_PRESSES = 1000
LINES = (1, 4)  # clock harmonics on which the two ends are read; both must stay below Nyquist


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


def load_scene(scene):
    """Read and check a scene.

    Parameters
    ----------
    scene : str, Path or dict
        A YAML file, the name of a shipped scene, or the mapping that such a file would hold.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        For an unreadable file, an unknown key, a wrong type, a value out of range, or sections
        that contradict each other; the message names file, dotted key, rule and value.
    """
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, dict):
        return _scene(Section(scene, "scene"), None)
    path = _scene_path(scene)
    return _scene(Section(read_yaml(path), str(scene)), path)


def shipped_scenes():
    """Names of the scenes that are shipped, sorted."""
    return sorted(path.stem for path in _shipped_folder().glob("*.yaml"))


def about_scene(name):
    """What a scene shows: the comment that its file begins with, as one line."""
    lines = _scene_path(name).read_text(encoding="utf-8").splitlines()
    return " ".join(line.lstrip("# ") for line in takewhile(lambda x: x.startswith("#"), lines))


def _shipped_folder():
    from .._config import DATA_DIR

    return Path(DATA_DIR) / "scenes"


def _scene_path(scene):
    """The file meant: a shipped scene when the name has no suffix and no such file is there."""
    path = Path(scene)
    if path.is_file() or path.suffix:
        return path
    if str(scene) not in shipped_scenes():
        if path.exists():
            return path
        rule = f"must be a .yaml file or one of {', '.join(shipped_scenes())}"
        raise InputError("scene", rule, str(scene))
    return _shipped_folder() / f"{scene}.yaml"


def _scene(top, path):
    radio = _radio(top.section("radio"))
    sounding = _sounding(top.section("sounding"), radio)
    phase_group = _phase_group(top.section("phase_group"))
    snapshot_period_s = sounding.frame_length / radio.sample_rate_hz
    environment = _environment(top.section("environment"))
    sensors = _sensors(
        top.sections("sensors", MAX_SENSORS, required=True), snapshot_period_s, environment
    )
    reference_s = top.number("reference_s", 0.5, low=0, high=3600)
    simulation = _simulation(top.section("simulation"), sensors, environment, reference_s)
    top.finish()
    scene = Scene(radio, sounding, phase_group, sensors, environment, reference_s, simulation, path)
    _check_clocks_apart(top, scene)
    _check_duration(top, scene)
    _check_presses(top, scene, _checked_models(top, scene))
    return scene


def _radio(section):
    radio = Radio(
        section.number("center_frequency_hz", 900e6, low=1e6, high=100e9),
        section.number("sample_rate_hz", 12.5e6, low=1e5, high=1e9),
    )
    section.finish()
    return radio


def _sounding(section, radio):
    sounding = Sounding(
        section.choice("waveform", ("repeated", "wifi"), "repeated"),
        section.integer("frame_length", 720, low=320, high=1_000_000),
    )
    section.finish()
    sounding_waveform(sounding.waveform, sounding.frame_length, radio.sample_rate_hz)
    return sounding


def _phase_group(section):
    group = PhaseGroup(
        section.integer("snapshots", 625, low=32, high=100_000),
        section.choice("estimator", ("harmonic", "sideband", "paper"), "harmonic"),
    )
    section.finish()
    return group


def _environment(section):
    environment = Environment(
        section.number("moving_clutter_hz", 0.0, low=0, high=10_000),
        section.choice("reader_clock", ("shared", "free"), "shared"),
        section.integer("receive_antennas", 1, low=1, high=2),
    )
    if environment.receive_antennas > 1 and environment.reader_clock == "shared":
        rule = "must be 1 when reader_clock is 'shared'"
        raise section.error("receive_antennas", rule, environment.receive_antennas)
    section.finish()
    return environment


def _sensors(sections, snapshot_period_s, environment):
    sensors = []
    for section in sections:
        sensor = SceneSensor(
            section.text("name", limit=64),
            section.text("model", limit=4096),
            section.number("clock_hz", 1000.0, above=0, high=1e6),
            section.number("clock_tolerance_ppm", 100.0, low=0, high=1000),
            _off_reflection(section),
        )
        section.finish()
        if sensor.name in [other.name for other in sensors]:
            raise section.error("name", "must differ from every other sensor's", sensor.name)
        nyquist_hz = 0.5 / snapshot_period_s
        if sensor.clock_hz * max(LINES) >= nyquist_hz:
            rule = (
                f"must be below {nyquist_hz / max(LINES):.6g} Hz: 4 x clock_hz must lie below "
                f"half the snapshot rate ({nyquist_hz:.6g} Hz)"
            )
            raise section.error("clock_hz", rule, sensor.clock_hz)
        if sensor.clock_hz <= environment.moving_clutter_hz:
            rule = (
                f"must be above environment.moving_clutter_hz ({environment.moving_clutter_hz:g})"
            )
            raise section.error("clock_hz", rule, sensor.clock_hz)
        sensors.append(sensor)
    return tuple(sensors)


def _off_reflection(section):
    """G_off / rho as a pair [re, im], or a list of two pairs, one per switch."""
    value = section.raw("off_reflection", [0.0, 0.0])
    rule = "must be a pair [re, im] of magnitude below 1, or a list of two such pairs"
    pairs = value
    if isinstance(value, list | tuple) and value and not isinstance(value[0], list | tuple):
        pairs = [value, value]
    if not isinstance(pairs, list | tuple) or len(pairs) != 2:
        raise section.error("off_reflection", rule, value)
    numbers = []
    for pair in pairs:
        if not isinstance(pair, list | tuple) or len(pair) != 2:
            raise section.error("off_reflection", rule, value)
        parts = Section({"re": pair[0], "im": pair[1]}, section.source, section.where())
        try:
            number = complex(parts.number("re"), parts.number("im"))
        except InputError:
            raise section.error("off_reflection", rule, value) from None
        if abs(number) >= 1:
            raise section.error("off_reflection", rule, value)
        numbers.append(number)
    return tuple(numbers)


def _simulation(section, sensors, environment, reference_s):
    names = [sensor.name for sensor in sensors]
    truth_model = section.text("truth_model", limit=4096, optional=True)
    offset = section.number("clock_offset_ppm", 40.0, low=-1000, high=1000)
    drift = section.number("clock_drift_ppm_per_s", 0.1, low=-10, high=10)
    tags = _tags(section, sensors, truth_model, offset, drift)
    moving_db = section.number("moving_clutter_db", low=-100, high=140, optional=True)
    moving_hz = section.number(
        "moving_clutter_hz", environment.moving_clutter_hz, low=0, high=10_000
    )
    if moving_db is not None and moving_hz == 0:
        rule = "must be null when nothing moves (moving_clutter_hz is 0)"
        raise section.error("moving_clutter_db", rule, moving_db)
    oscillators = [
        section.number("carrier_offset_hz", 0.0, low=-1e6, high=1e6),
        section.number("phase_noise_hz", 0.0, low=0, high=1e4),
    ]
    for key, value in zip(("carrier_offset_hz", "phase_noise_hz"), oscillators, strict=True):
        if value and environment.reader_clock == "shared":
            raise section.error(key, "must be 0 when environment.reader_clock is 'shared'", value)
    simulation = Simulation(
        duration_s=section.number("duration_s", 3.0, above=0, high=1e6),
        seed=section.integer("seed", 1, low=0, high=2**63 - 1),
        snr_db=section.number("snr_db", 10.0, low=-100, high=140),
        static_clutter_db=section.number(
            "static_clutter_db", 60.0, low=-100, high=140, optional=True
        ),
        moving_clutter_db=moving_db,
        moving_clutter_hz=moving_hz,
        tag_coherence_hz=section.number("tag_coherence_hz", above=0, high=1e9, optional=True),
        carrier_offset_hz=oscillators[0],
        phase_noise_hz=oscillators[1],
        adc_bits=section.integer("adc_bits", 14, low=2, high=16, optional=True),
        tags=tags,
        presses=_presses(section.sections("presses", MAX_PRESSES), names, reference_s),
        moves=_moves(section.sections("moves", MAX_PRESSES), names),
    )
    section.finish()
    return simulation


def _sensor_name(section, names):
    """The sensor that an entry speaks of; may be left out when the scene has only one."""
    name = section.text("sensor", names[0] if len(names) == 1 else None, limit=64)
    if name not in names:
        known = ", ".join(names)
        raise section.error("sensor", f"must be the name of a sensor of the scene ({known})", name)
    return name


def _tags(section, sensors, truth_model, offset, drift):
    names = [sensor.name for sensor in sensors]
    entries = {}
    for entry in section.sections("tags", MAX_SENSORS):
        name = _sensor_name(entry, names)
        if name in entries:
            raise entry.error("sensor", "must not have two entries", name)
        entries[name] = entry
    tags = []
    for sensor in sensors:
        entry = entries.get(sensor.name) or Section({}, section.source)
        entry.raw("sensor")
        tags.append(
            Tag(
                sensor.name,
                entry.text("truth_model", truth_model or sensor.model, limit=4096),
                entry.number("level_db", 0.0, low=-140, high=140),
                entry.number("clock_offset_ppm", offset, low=-1000, high=1000),
                entry.number("clock_drift_ppm_per_s", drift, low=-10, high=10),
                entry.number("clock_phase_deg", low=-1e6, high=1e6, optional=True),
                entry.number("clock2_delay_s", 0.0, low=-1e-3, high=1e-3),
                entry.choice("clock2_duty", ("pulses", "overlapping", "two_frequencies"), "pulses"),
            )
        )
        entry.finish()
    return tuple(tags)


def _presses(sections, names, reference_s):
    presses = []
    for section in sections:
        force_n = section.number("force_n", above=0, high=1000)
        press = Press(
            _sensor_name(section, names),
            section.number("start_s", low=0, high=1e6),
            section.number("rise_s", 0.1, low=0, high=1e6),
            section.number("hold_s", low=0, high=1e6),
            force_n,
            section.number("end_force_n", force_n, low=0, high=1000),
            section.number("location_mm", low=0, high=10_000),
            section.number("tremor_n", 0.0, low=0, high=100),
        )
        section.finish()
        if press.start_s < reference_s:
            rule = f"must not begin before reference_s ({reference_s:g} s), which is untouched time"
            raise section.error("start_s", rule, press.start_s)
        for other in presses:
            if other.sensor == press.sensor and (
                press.start_s < other.end_s and other.start_s < press.end_s
            ):
                rule = (
                    f"must not overlap another press of sensor '{press.sensor}' "
                    f"({other.start_s:g} to {other.end_s:g} s)"
                )
                raise section.error("start_s", rule, press.start_s)
        presses.append(press)
    return tuple(presses)


def _moves(sections, names):
    moves = []
    for section in sections:
        moves.append(
            Move(
                _sensor_name(section, names),
                section.number("start_s", low=0, high=1e6),
                section.number("duration_s", 0.0, low=0, high=1e6),
                section.number("distance_mm", low=-1e5, high=1e5),
            )
        )
        section.finish()
    return tuple(moves)


def _check_clocks_apart(top, scene):
    """No line on which one tag is read may lie on a main line of another tag."""
    resolution_hz = 1 / scene.group_period_s
    for i, second in enumerate(scene.sensors):
        for first in scene.sensors[:i]:
            for a, b in ((1, 1), (2, 1), (4, 1), (1, 2), (1, 4)):
                lines = a * first.clock_hz, b * second.clock_hz
                wander = 1e-6 * sum(
                    line * sensor.clock_tolerance_ppm
                    for line, sensor in zip(lines, (first, second), strict=True)
                )
                apart = max(resolution_hz, wander)
                if abs(lines[0] - lines[1]) < apart:
                    rule = (
                        f"{b} x clock_hz must lie {apart:.3g} Hz or more from {a} x the clock of "
                        f"sensor '{first.name}' ({first.clock_hz:g})"
                    )
                    raise top.error(f"sensors[{i}].clock_hz", rule, second.clock_hz)


def _check_duration(top, scene):
    duration_s = scene.simulation.duration_s
    if duration_s < scene.group_period_s:
        rule = f"must hold at least one phase group ({scene.group_period_s:.6g} s)"
        raise top.error("simulation.duration_s", rule, duration_s)
    for i, press in enumerate(scene.simulation.presses):
        if press.start_s >= duration_s:
            rule = f"must begin before simulation.duration_s ({duration_s:g})"
            raise top.error(f"simulation.presses[{i}].start_s", rule, press.start_s)


def _checked_models(top, scene):
    """Every model by the name the scene gives it; each must be there and hold the carrier."""
    keys = {sensor.model: f"sensors[{i}].model" for i, sensor in enumerate(scene.sensors)}
    for tag in scene.simulation.tags:
        keys.setdefault(tag.truth_model, "simulation: truth_model")
    models = {}
    for name, key in keys.items():
        try:
            models[name] = scene.load_model(name)
        except InputError as error:
            raise top.error(key, str(error).removeprefix("sensor: ")) from None
        try:
            models[name].carrier_index(scene.radio.center_frequency_hz)
        except InputError as error:
            raise top.error("radio.center_frequency_hz", f"model {error}") from None
    return models


def _check_presses(top, scene, models):
    """Locations must lie on the pressed line; its length is the truth model's."""
    truths = {tag.sensor: models[tag.truth_model] for tag in scene.simulation.tags}
    for i, press in enumerate(scene.simulation.presses):
        length_mm = truths[press.sensor].length_mm
        if press.location_mm > length_mm:
            rule = f"must lie on the line, 0 to {length_mm:g} mm"
            raise top.error(f"simulation.presses[{i}].location_mm", rule, press.location_mm)
