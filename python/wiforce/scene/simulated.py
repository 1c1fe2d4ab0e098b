# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens in a simulated scene: presses, moves, tags, clutter and noise.

Only the simulator and the software device use it; a reader never does.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..io.text.schema import Derived, ListOf, declared, key, read, section
from ..io.text.values import Choice, Integer, KeyPath, Number, Scope, Text
from .effects import (
    Beam,
    Bursts,
    Fan,
    FrontEnd,
    Hand,
    Hopper,
    Lamps,
    OtherTag,
    PacketFaults,
    RadioNoise,
    Ripple,
    Walker,
)
from .link import Link, level_or

if TYPE_CHECKING:
    from .schema import SceneSensor

MAX_SENSORS = 16
_LONGEST_S = 1e6
_TIME = Number(unit="s", low=0, high=_LONGEST_S)
POSITION = Number(unit="mm", low=-10_000, high=10_000)
MODEL_NAME_LENGTH = 4096  # of a path, the longest that Linux accepts
# RC oscillators are within 1 to 10 %, ceramic resonators within 0.5 %.
CLOCK_OFFSET = Number(unit="ppm", low=-20_000, high=20_000)
CLOCK_DRIFT = Number(unit="ppm/s", low=-10, high=10)
_DUTY_ERROR = Number(low=-0.1, high=0.1)


def sensor_name() -> Any:
    """Declare the key by which an entry names a sensor of the scene; or the only one."""
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
class Tag:
    """What a simulation knows about one sensor's tag, and a reader does not."""

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
        CLOCK_OFFSET,
        derived=Derived("`simulation.clock_offset_ppm`", lambda scope: scope["clock_offset_ppm"]),
        doc="Error of this tag's crystal at time 0, positive where the clock is fast.",
    )
    clock_drift_ppm_per_s: float = key(
        CLOCK_DRIFT,
        derived=Derived(
            "`simulation.clock_drift_ppm_per_s`", lambda scope: scope["clock_drift_ppm_per_s"]
        ),
        doc="Drift of that error.",
    )
    clock_phase_deg: float | None = key(
        Number(unit="deg", low=-1e6, high=1e6, optional=True),
        doc="Phase of clock 1 at time 0; null draws it at random.",
    )
    clock_wander_ppm_per_sqrt_s: float = key(
        Number(unit="ppm", low=0, high=1000),
        default=0.0,
        doc="Random walk of that error, per root of a second, reflected at 1000 ppm from it.",
    )
    clock_period_jitter_s: float = key(
        Number(unit="s", low=0, high=1e-4),
        default=0.0,
        doc="Standard deviation of the length of a period of clock 1. The deviations of all "
        "periods add up, as those of any free-running oscillator.",
    )
    clock_jitter_s: float = key(
        Number(unit="s", low=0, high=1e-4),
        default=0.0,
        doc="Standard deviation by which each period of clock 1 comes early or late, both "
        "switches alike. It does not accumulate.",
    )
    clock1_duty_error: float = key(
        _DUTY_ERROR, default=0.0, doc="What is added to the duty cycle of clock 1, on both sides."
    )
    clock2_duty_error: float = key(
        _DUTY_ERROR, default=0.0, doc="The same for clock 2, as a part of its own period."
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
    switch_rise_s: float = key(
        Number(unit="s", low=0, high=1e-4),
        default=0.0,
        doc="Time in which a switch goes from off to on and back, linearly in amplitude and "
        "centred on the clock's edge.",
    )
    drift_deg_per_sqrt_s: float = key(
        Number(unit="deg", low=0, high=100),
        default=0.0,
        doc="Random walk of the phase of either end, per root of a second, with temperature and "
        "humidity. The truth file does not contain it.",
    )
    beam: Beam | None = section(Beam, absent="an elastic beam")
    hand: Hand | None = section(Hand, absent="none")


def with_all_tags(
    simulation: "Simulation", sensors: Iterable["SceneSensor"], where: KeyPath
) -> "Simulation":
    """Complete the list of tags to one per sensor, in their order; refuses two of one."""
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


MAX_EVENTS = 1000
# Highest Doppler frequency of a walking person at 2.4 GHz; what moves where a scene states nothing.
_MOVING_HZ = 30.0
_DURATION_S = 3.0


def _default_duration(scope: Any) -> float:
    """Duration of a simulation that states none, so that scenes for reading need not state it."""
    snapshots = scope["phase_group"].snapshots
    if scope.get("packets"):
        return max(_DURATION_S, float(snapshots * scope["packets"].interval_s))
    samples = snapshots * scope["sounding"].frame_length
    return max(_DURATION_S, samples / scope["radio"].sample_rate_hz)


@declared
class PressForce:
    """A press: force rises from 0, changes linearly while it is held, falls to 0 again."""

    start_s: float = key(_TIME, doc="Start of the press, not before `reference_s`.")
    rise_s: float = key(
        _TIME,
        default=0.1,
        doc="Time in which the force rises from 0 to `force_n`, and falls to 0 at the end.",
    )
    hold_s: float = key(
        _TIME, doc="Time in which the force changes linearly from `force_n` to `end_force_n`."
    )
    force_n: float = key(
        Number(unit="N", low=0, above=True, high=1000), doc="Force after the rise."
    )
    end_force_n: float = key(
        Number(unit="N", low=0, high=1000),
        derived=Derived("`force_n`", lambda scope: scope["force_n"]),
        doc="Force before the fall.",
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
class Press(PressForce):
    """A press on the line of a sensor."""

    sensor: str = sensor_name()
    location_mm: float = key(
        Number(unit="mm", low=0, high=10_000),
        doc="Centre of the contact, measured from port 1. Must lie on the sensor's line.",
    )


@declared
class SurfacePress(PressForce):
    """A press on the surface."""

    x_mm: float = key(POSITION, doc="Where it is along the strips.")
    y_mm: float = key(POSITION, doc="Where it is across.")


@declared
class Plate:
    """The skin of the surface as a thin plate on an elastic foundation."""

    reach_mm: float = key(
        Number(unit="mm", low=0.5, high=1000),
        default=10.0,
        doc="1/k of the plate: its pressure falls with the distance across as exp(-kd) "
        "(cos kd + sin kd).",
    )
    bearing_mm: float | None = key(
        Number(unit="mm", low=0.1, high=1000, optional=True),
        doc="Width over which a strip bears the plate; null means the median distance of the "
        "strips, so that they bear all of the force.",
    )


@declared
class Move:
    """A movement of a sensor's tag; its two-way path grows by twice the distance."""

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
class Simulation:
    """What happens in the scene, for `simulate` and `emulate` only.

    ``truth_model``, ``clock_offset_ppm`` and ``clock_drift_ppm_per_s`` are only the defaults of
    the entries of ``tags``, which has one entry per sensor, in the order of the sensors.
    """

    truth_model: str | None = key(
        Text(limit=MODEL_NAME_LENGTH, optional=True),
        doc="Sensor model that is pressed; null means the sensor's `model`. It should differ from "
        "`model`, otherwise the reader knows the sensor better than any calibration could.",
    )
    duration_s: float = key(
        Number(unit="s", low=0, above=True, high=_LONGEST_S),
        derived=Derived(
            f"{_DURATION_S:g}; one phase group where that is longer", _default_duration
        ),
        doc="Length of the capture, at least one phase group. Whole frames are written.",
    )
    seed: int = key(
        Integer(low=0, high=2**63 - 1),
        default=1,
        doc="Seed of everything random. The same scene and seed give the same bytes.",
    )
    link: Link | None = section(Link, absent="none")
    snr_db: float = key(
        Number(unit="dB", low=-100, high=140),
        derived=level_or(10.0, 0),
        doc="Power |c1[1] G1|^2 of the tag's first line relative to the noise in H, per "
        "subcarrier and snapshot.",
    )
    static_clutter_db: float | None = key(
        Number(unit="dB", low=-100, high=140, optional=True),
        derived=level_or(60.0, 1),
        doc="Rms power over the subcarriers of everything that stands still, relative to "
        "|c1[1] G1|^2; null means none.",
    )
    moving_clutter_db: float | None = key(
        Number(unit="dB", low=-100, high=140, optional=True),
        doc="The same for everything that moves. Needs a `moving_clutter_hz` above 0.",
    )
    moving_clutter_hz: float = key(
        Number(unit="Hz", low=0, high=10_000),
        derived=Derived(
            f"`environment.moving_clutter_hz`; {_MOVING_HZ:g} where that is not a number",
            lambda scope: (
                _MOVING_HZ if (hz := scope["environment"].moving_clutter_hz) is None else hz
            ),
        ),
        doc="Highest Doppler frequency of what moves. Where it differs from a number that "
        "`environment.moving_clutter_hz` states, the reader works with a wrong value.",
    )
    tag_coherence_hz: float | None = key(
        Number(unit="Hz", low=0, above=True, high=1e9, optional=True),
        doc="Coherence bandwidth of Rayleigh fading on the tags' paths; null means flat paths.",
    )
    clock_offset_ppm: float = key(
        CLOCK_OFFSET,
        default=40.0,
        doc="Error of the tags' crystals at time 0, positive where the clock is fast.",
    )
    clock_drift_ppm_per_s: float = key(
        CLOCK_DRIFT,
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
    bursts: Bursts | None = section(Bursts, absent="none")
    hopper: Hopper | None = section(Hopper, absent="none")
    front_end: FrontEnd | None = section(FrontEnd, absent="none")
    radio_noise: RadioNoise | None = section(RadioNoise, absent="none")
    ripple: Ripple | None = section(Ripple, absent="none")
    lamps: Lamps | None = section(Lamps, absent="none")
    fan: Fan | None = section(Fan, absent="none")
    walker: Walker | None = section(Walker, absent="nobody")
    packets: PacketFaults | None = section(PacketFaults, absent="nothing")
    other_tags: tuple[OtherTag, ...] = key(
        ListOf(of=OtherTag, most=MAX_SENSORS), doc="Tags that are not listed as sensors."
    )
    tags: tuple[Tag, ...] = key(
        ListOf(of=Tag, most=MAX_SENSORS), doc="Properties of single tags, at most one entry each."
    )
    presses: tuple[Press, ...] = key(ListOf(of=Press, most=MAX_EVENTS), doc="The presses.")
    plate: Plate = section(Plate)
    surface_presses: tuple[SurfacePress, ...] = key(
        ListOf(of=SurfacePress, most=MAX_EVENTS), doc="The presses on the surface."
    )
    moves: tuple[Move, ...] = key(ListOf(of=Move, most=MAX_EVENTS), doc="The movements of tags.")
