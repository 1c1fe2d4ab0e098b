# SPDX-License-Identifier: GPL-3.0-or-later
"""The sections of a scene file, key by key: types, ranges, defaults."""

from ..errors import InputError
from ..io.yamlfile import Section
from ..signal.waveform import sounding_waveform
from .schema import (
    Environment,
    Move,
    PhaseGroup,
    Press,
    Radio,
    Scene,
    SceneSensor,
    Simulation,
    Sounding,
    Tag,
)

MAX_SENSORS = 16
MAX_PRESSES = 1000
LINES = (1, 4)  # clock harmonics on which the two ends are read; both must stay below Nyquist


def parse_scene(top, path):
    """The scene that a file's top section holds, each value by its own rule; InputError else."""
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
    return Scene(radio, sounding, phase_group, sensors, environment, reference_s, simulation, path)


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
