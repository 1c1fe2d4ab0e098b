# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens in a simulated scene: presses, moves, tags, clutter and noise.

Only the simulator and the software device use this part of a scene; a reader never does.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..io.schema import Derived, ListOf, declared, key, read
from ..io.values import Choice, Integer, KeyPath, Number, Scope, Text

if TYPE_CHECKING:
    from .schema import SceneSensor

MAX_SENSORS = 16
MAX_EVENTS = 1000
MODEL_NAME_LENGTH = 4096  # of a path, the longest that Linux accepts
_LONGEST_S = 1e6
_TIME = Number(unit="s", low=0, high=_LONGEST_S)
_CLOCK_OFFSET = Number(unit="ppm", low=-1000, high=1000)
_CLOCK_DRIFT = Number(unit="ppm/s", low=-10, high=10)


def sensor_name() -> Any:
    """Declare the key by which an entry names one of the scene's sensors.

    Returns
    -------
    object
        What ``io.schema.key`` returns; by default the name of the only sensor.

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> load_scene("demo").simulation.presses[0].sensor  # stated, as it would be by default
    'arm'
    """
    return key(
        Text(limit=64),
        derived=Derived("the only sensor", _only_sensor),
        check=_check_sensor_name,
        doc="Name of the sensor. May be left out where the scene has only one.",
    )


def _names(scope: Scope) -> list[str]:
    return [sensor.name for sensor in scope["sensors"]]


def _only_sensor(scope: Scope) -> str | None:
    names = _names(scope)
    return names[0] if len(names) == 1 else None


def _check_sensor_name(name: str, scope: Scope) -> str | None:
    names = _names(scope)
    known = ", ".join(names)
    return None if name in names else f"must be the name of a sensor of the scene ({known})"


def _truth_model(scope: Scope) -> str:
    models = {sensor.name: sensor.model for sensor in scope["sensors"]}
    return scope["truth_model"] or models[scope["sensor"]]


@declared
class Press:
    """A press: force rises from 0, changes linearly while it is held, falls to 0 again.

    Examples
    --------
    >>> press = Press(
    ...     sensor="arm", start_s=0.8, hold_s=0.5, force_n=4.0, end_force_n=6.0, location_mm=45.0)
    >>> round(press.end_s, 6)
    1.5
    """

    sensor: str = sensor_name()
    start_s: float = key(
        _TIME,
        doc="Start of the press. Not before `reference_s`; presses of one sensor must not overlap.",
    )
    rise_s: float = key(
        _TIME,
        default=0.1,
        doc="Time in which the force rises from 0 to `force_n`, and falls to 0 at the end.",
    )
    hold_s: float = key(
        _TIME,
        doc="Time in which the force changes linearly from `force_n` to `end_force_n`.",
    )
    force_n: float = key(
        Number(unit="N", low=0, above=True, high=1000), doc="Force after the rise."
    )
    end_force_n: float = key(
        Number(unit="N", low=0, high=1000),
        derived=Derived("`force_n`", lambda scope: scope["force_n"]),
        doc="Force before the fall.",
    )
    location_mm: float = key(
        Number(unit="mm", low=0, high=10_000),
        doc="Centre of the contact, measured from port 1. Must lie on the sensor's line.",
    )
    tremor_n: float = key(
        Number(unit="N", low=0, high=100),
        default=0.0,
        doc="Rms of a hand's tremor (8 to 12 Hz) about the stated force.",
    )

    @property
    def end_s(self) -> float:
        """Time at which the force is 0 again, in s."""
        return self.start_s + self.hold_s + 2 * self.rise_s


@declared
class Move:
    """A movement of a sensor's tag; its two-way path grows by twice the distance.

    Examples
    --------
    >>> Move(sensor="arm", start_s=1.0, distance_mm=5.0).duration_s
    0.0
    """

    sensor: str = sensor_name()
    start_s: float = key(_TIME, doc="Start of the movement.")
    duration_s: float = key(
        _TIME,
        default=0.0,
        doc="Duration of the movement, at constant speed. The tag then stays where it is.",
    )
    distance_mm: float = key(
        Number(unit="mm", low=-1e5, high=1e5),
        doc="Change of the tag's distance from the reader, one way.",
    )


@declared
class Tag:
    """What a simulation knows about one sensor's tag, and a reader does not.

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> load_scene("demo").simulation.tags[0].truth_model
    'line-915mhz'
    """

    sensor: str = sensor_name()
    truth_model: str = key(
        Text(limit=MODEL_NAME_LENGTH),
        derived=Derived("`simulation.truth_model`, otherwise the sensor's `model`", _truth_model),
        doc="Sensor model that is pressed, as `simulation.truth_model`.",
    )
    level_db: float = key(
        Number(unit="dB", low=-140, high=140),
        default=0.0,
        doc="Strength of this tag relative to the levels that the scene states.",
    )
    clock_offset_ppm: float = key(
        _CLOCK_OFFSET,
        derived=Derived("`simulation.clock_offset_ppm`", lambda scope: scope["clock_offset_ppm"]),
        doc="Error of this tag's crystal at time 0, positive where the clock is fast.",
    )
    clock_drift_ppm_per_s: float = key(
        _CLOCK_DRIFT,
        derived=Derived(
            "`simulation.clock_drift_ppm_per_s`", lambda scope: scope["clock_drift_ppm_per_s"]
        ),
        doc="Drift of that error.",
    )
    clock_phase_deg: float | None = key(
        Number(unit="deg", low=-1e6, high=1e6, optional=True),
        default=None,
        doc="Phase of clock 1 at time 0; null draws it at random.",
    )
    clock2_delay_s: float = key(
        Number(unit="s", low=-1e-3, high=1e-3),
        default=0.0,
        doc="Delay of clock 2 relative to clock 1.",
    )
    clock2_duty: str = key(
        Choice(words=("pulses", "overlapping", "two_frequencies")),
        default="pulses",
        doc="`pulses`: the two switches are never on together. `overlapping`: clock 2 has a true "
        "75 % duty cycle, so that both are on for part of the time. `two_frequencies`: the naive "
        "scheme, square waves of 50 % duty cycle at fs and 1.4 fs.",
    )


@declared
class Simulation:
    """What happens in a simulated scene.

    ``truth_model``, ``clock_offset_ppm`` and ``clock_drift_ppm_per_s`` are only the defaults of
    the entries of ``tags``, which has one entry per sensor, in the order of the sensors.

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> load_scene("demo").simulation.static_clutter_db
    60.0
    """

    truth_model: str | None = key(
        Text(limit=MODEL_NAME_LENGTH, optional=True),
        default=None,
        doc="Sensor model that is pressed; null means the sensor's `model`. It should differ from "
        "`model`, otherwise the reader knows the sensor better than any calibration could.",
    )
    duration_s: float = key(
        Number(unit="s", low=0, above=True, high=_LONGEST_S),
        default=3.0,
        doc="Length of the capture, at least one phase group. Whole frames are written.",
    )
    seed: int = key(
        Integer(low=0, high=2**63 - 1),
        default=1,
        doc="Seed of everything random. The same scene and seed give the same bytes.",
    )
    snr_db: float = key(
        Number(unit="dB", low=-100, high=140),
        default=10.0,
        doc="Power |c1[1] G1|^2 of the tag's first line relative to the noise in H, per "
        "subcarrier and snapshot.",
    )
    static_clutter_db: float | None = key(
        Number(unit="dB", low=-100, high=140, optional=True),
        default=60.0,
        doc="Rms power over the subcarriers of everything that stands still, relative to "
        "|c1[1] G1|^2; null means none.",
    )
    moving_clutter_db: float | None = key(
        Number(unit="dB", low=-100, high=140, optional=True),
        default=None,
        doc="The same for everything that moves. Needs a `moving_clutter_hz` above 0.",
    )
    moving_clutter_hz: float = key(
        Number(unit="Hz", low=0, high=10_000),
        derived=Derived(
            "`environment.moving_clutter_hz`", lambda scope: scope["environment"].moving_clutter_hz
        ),
        doc="Highest Doppler frequency of what moves. Where it differs from the default, the "
        "reader works with a wrong value.",
    )
    tag_coherence_hz: float | None = key(
        Number(unit="Hz", low=0, above=True, high=1e9, optional=True),
        default=None,
        doc="Coherence bandwidth of Rayleigh fading on the tags' paths; null means flat paths.",
    )
    clock_offset_ppm: float = key(
        _CLOCK_OFFSET,
        default=40.0,
        doc="Error of the tags' crystals at time 0, positive where the clock is fast.",
    )
    clock_drift_ppm_per_s: float = key(
        _CLOCK_DRIFT,
        default=0.1,
        doc="Drift of that error. It reverses where the error reaches the tolerance.",
    )
    carrier_offset_hz: float = key(
        Number(unit="Hz", low=-1e6, high=1e6),
        default=0.0,
        doc="Offset of the receiver's oscillator from the transmitter's. Needs `reader_clock: "
        "free` if not 0.",
    )
    phase_noise_hz: float = key(
        Number(unit="Hz", low=0, high=1e4),
        default=0.0,
        doc="Linewidth of that oscillator, whose phase is a random walk. Needs `reader_clock: "
        "free` if not 0.",
    )
    adc_bits: int | None = key(
        Integer(unit="bits", low=2, high=16, optional=True),
        default=14,
        doc="Resolution of the converter; codes are left-justified in ci16. null means 16 bits "
        "for ci16 and no rounding for cf32.",
    )
    tags: tuple[Tag, ...] = key(
        ListOf(of=Tag, most=MAX_SENSORS), doc="Properties of single tags, at most one entry each."
    )
    presses: tuple[Press, ...] = key(ListOf(of=Press, most=MAX_EVENTS), doc="The presses.")
    moves: tuple[Move, ...] = key(ListOf(of=Move, most=MAX_EVENTS), doc="The movements of tags.")


def with_all_tags(
    simulation: Simulation, sensors: Iterable["SceneSensor"], where: KeyPath
) -> Simulation:
    """Complete the list of tags: one entry per sensor, in the order of the sensors.

    Parameters
    ----------
    simulation : Simulation
        As read from a scene file.
    sensors : iterable of SceneSensor
        Of the scene.
    where : KeyPath
        Of the simulation in its file, for messages.

    Returns
    -------
    Simulation

    Raises
    ------
    InputError
        When two entries name the same sensor.

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> scene = load_scene("two_sensors")
    >>> complete = with_all_tags(scene.simulation, scene.sensors, KeyPath("scene.yaml"))
    >>> [tag.sensor for tag in complete.tags]
    ['left', 'right']
    """
    stated: dict[str, Tag] = {}
    for index, tag in enumerate(simulation.tags):
        if tag.sensor in stated:
            duplicate = where.key("tags").item(index).key("sensor")
            raise duplicate.error("must not have two entries", tag.sensor)
        stated[tag.sensor] = tag
    scope = Scope(vars(simulation), {"sensors": sensors})
    return replace(
        simulation,
        tags=tuple(
            stated.get(sensor.name) or read(Tag, {"sensor": sensor.name}, where, scope)
            for sensor in sensors
        ),
    )
