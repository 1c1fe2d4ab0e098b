# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules of a scene that involve several of its keys."""

from collections.abc import Iterator
from itertools import combinations, product
from typing import Any

from ..errors import InputError
from ..io.text.values import KeyPath
from .schema import Scene
from .simulated import PressForce
from .surface import surface_violations

# What breaks a rule: dotted key, rule and value, where the rule does not state the value itself.
Violation = tuple[str, str, Any] | tuple[str, str]

# Effects that the simulator computes sample by sample.
_SAMPLE_EFFECTS = (
    "bursts", "hopper", "front_end", "ripple", "lamps", "fan", "walker", "other_tags",
    "carrier_offset_hz", "phase_noise_hz", "radio_noise", "link",
)  # fmt: skip
# The ends of a sensor are read on lines at fs and 4 fs; fs, 2 fs and 4 fs are its strongest lines
# (docs/theory.md).
_HIGHEST_READ = 4
_STRONG_LINE_PAIRS = ((1, 1), (2, 1), (4, 1), (1, 2), (1, 4))


ONE_ANTENNA = (
    "reader_clock free: with one receive antenna, the common phase of transmitter and receiver is "
    "indistinguishable from the tag in quadrature with the direct path"
)


def lacks_antenna(scene: Scene) -> bool:
    """Whether samples of a scene have an unknown phase that a second antenna would cancel."""
    environment = scene.environment
    alone = scene.packets is None and environment.receive_antennas == 1
    return alone and environment.reader_clock == "free"


def check_scene(scene: Scene, source: str) -> None:
    """Refuse a scene whose keys contradict each other, with the first contradiction."""
    for check in (_settings, _clocks, _events, _models, surface_violations):
        for dotted, rule, *value in check(scene):
            raise KeyPath(source, dotted).error(rule, *value)


def _settings(scene: Scene) -> Iterator[Violation]:
    """Packets and samples exclude each other's keys, and so do shared and free oscillators."""
    environment, simulation = scene.environment, scene.simulation
    antennas, shared = environment.receive_antennas, environment.reader_clock == "shared"
    if scene.packets is None:
        if antennas > 2:
            yield "environment.receive_antennas", "must be 1 or 2 without packets", antennas
        if simulation.packets is not None:
            rule = "must be null in a scene without packets"
            yield "simulation.packets", rule, "a mapping"
    else:
        if scene.phase_group.estimator != "harmonic":
            rule = "must be 'harmonic' with packets, whose times are irregular"
            yield "phase_group.estimator", rule, scene.phase_group.estimator
        for key in _SAMPLE_EFFECTS:
            if getattr(simulation, key):
                yield f"simulation.{key}", "is not simulated for packets; leave it out"
    try:
        scene.waveform()
    except InputError as error:
        yield f"sounding.{error.where}", error.rule
    if shared and antennas > 1:
        rule = "must be 1 when reader_clock is 'shared'"
        yield "environment.receive_antennas", rule, antennas
    for key in ("carrier_offset_hz", "phase_noise_hz"):
        if shared and (value := getattr(simulation, key)):
            rule = "must be 0 when environment.reader_clock is 'shared'"
            yield f"simulation.{key}", rule, value
    for i, name in enumerate(scene.sensor_names):
        if name in scene.sensor_names[:i]:
            yield f"sensors[{i}].name", "must differ from every other sensor's", name


def _clocks(scene: Scene) -> Iterator[Violation]:
    """Lines that are read lie between clutter and Nyquist, and not on strong ones of others."""
    nyquist_hz = 0.5 / scene.snapshot_period_s
    moving_hz = scene.environment.moving_clutter_hz or 0.0
    for i, sensor in enumerate(scene.sensors):
        if scene.packets is None and sensor.clock_hz * _HIGHEST_READ >= nyquist_hz:
            rule = (
                f"must be below {nyquist_hz / _HIGHEST_READ:.6g} Hz: {_HIGHEST_READ} x clock_hz "
                f"must lie below half the snapshot rate ({nyquist_hz:.6g} Hz)"
            )
            yield f"sensors[{i}].clock_hz", rule, sensor.clock_hz
        if sensor.clock_hz <= moving_hz:
            rule = f"must be above environment.moving_clutter_hz ({moving_hz:g})"
            yield f"sensors[{i}].clock_hz", rule, sensor.clock_hz
    pairs = ((i, first) for i in range(len(scene.sensors)) for first in scene.sensors[:i])
    for (i, first), (a, b) in product(pairs, _STRONG_LINE_PAIRS):
        second = scene.sensors[i]
        own_hz, other_hz = b * second.clock_hz, a * first.clock_hz
        wander = own_hz * second.clock_tolerance_ppm + other_hz * first.clock_tolerance_ppm
        distance_hz = max(1 / scene.group_period_s, 1e-6 * wander)
        if abs(own_hz - other_hz) < distance_hz:
            own, other = (f"{n} x " if n > 1 else "" for n in (b, a))
            rule = (
                f"{own and own + 'clock_hz '}must lie {distance_hz:.3g} Hz or more from {other}the "
                f"clock of sensor '{first.name}' ({first.clock_hz:g})"
            )
            yield f"sensors[{i}].clock_hz", rule, second.clock_hz


def _events(scene: Scene) -> Iterator[Violation]:
    """What moves has a Doppler frequency; groups and presses lie within the simulation."""
    simulation, duration_s = scene.simulation, scene.simulation.duration_s
    if simulation.moving_clutter_db is not None and simulation.moving_clutter_hz == 0:
        rule = "must be null when nothing moves (moving_clutter_hz is 0)"
        yield "simulation.moving_clutter_db", rule, simulation.moving_clutter_db
    if duration_s < scene.group_period_s:
        rule = f"must hold at least one phase group ({scene.group_period_s:.6g} s)"
        yield "simulation.duration_s", rule, duration_s
    timed: list[tuple[str, PressForce]] = [
        (f"presses[{i}]", press) for i, press in enumerate(simulation.presses)
    ]
    timed += [(f"surface_presses[{i}]", p) for i, p in enumerate(simulation.surface_presses)]
    for name, press in timed:
        start = f"simulation.{name}.start_s"
        if press.start_s < scene.reference_s:
            rule = (
                f"must not begin before reference_s ({scene.reference_s:g} s), in which no sensor "
                "is touched"
            )
            yield start, rule, press.start_s
        if press.start_s >= duration_s:
            yield start, f"must begin before simulation.duration_s ({duration_s:g})", press.start_s
    for other, (i, press) in combinations(enumerate(simulation.presses), 2):
        together = press.start_s < other[1].end_s and other[1].start_s < press.end_s
        if other[1].sensor == press.sensor and together:
            rule = (
                f"must not overlap another press of sensor '{press.sensor}' "
                f"({other[1].start_s:g} to {other[1].end_s:g} s)"
            )
            yield f"simulation.presses[{i}].start_s", rule, press.start_s


def simulation_warnings(scene: Scene) -> list[str]:
    """What differs from what was probably meant, a sentence each: one model twice."""
    return [
        f"sensor '{tag.sensor}': the model that is pressed and the one that reads it are the same "
        f"({tag.truth_model}): readings will show no calibration error, which `gr-wiforce plan` "
        "states over the calibrated span"
        for sensor, tag in zip(scene.sensors, scene.simulation.tags, strict=True)
        if (scene.folder / tag.truth_model).resolve() == (scene.folder / sensor.model).resolve()
    ]


def _models(scene: Scene) -> Iterator[Violation]:
    """Every model must load and suit the carrier; presses must lie on the line that is pressed."""
    from ..sensor import load_sensor

    keys = {sensor.model: f"sensors[{i}].model" for i, sensor in enumerate(scene.sensors)}
    for tag in scene.simulation.tags:
        stated = tag.truth_model != scene.simulation.truth_model
        owner = f"simulation.tags[{tag.sensor}]" if stated else "simulation"
        keys.setdefault(tag.truth_model, f"{owner}.truth_model")
    models = {}
    for name, key in keys.items():
        try:
            model = load_sensor(name, scene.folder)
        except InputError as error:
            yield key, str(error).removeprefix("sensor: ")
            return
        try:
            models[name] = model.at_carrier(scene.radio.center_frequency_hz)
        except InputError as error:
            yield "radio.center_frequency_hz", f"model {error}"
            return
    pressed = {tag.sensor: models[tag.truth_model] for tag in scene.simulation.tags}
    for i, press in enumerate(scene.simulation.presses):
        length_mm = pressed[press.sensor].length_mm
        if press.location_mm > length_mm:
            rule = f"must lie on the line, 0 to {length_mm:g} mm"
            yield f"simulation.presses[{i}].location_mm", rule, press.location_mm
