# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens in a simulated scene: presses, moves, tags, clutter and noise.

Only the simulator and the software device use this part of a scene; a reader never does.
"""

from typing import Any

from ..io.text.schema import Derived, ListOf, Mapping, declared, key
from ..io.text.values import Integer, Number, Text
from .effects import (
    LONGEST_S,
    TIME,
    Bursts,
    Fan,
    FrontEnd,
    Hopper,
    Lamps,
    OtherTag,
    Plate,
    PressForce,
    RadioNoise,
    Ripple,
    SurfacePress,
    Walker,
)
from .link import Link, level_or
from .packets import PacketFaults
from .simulated_tags import (
    CLOCK_DRIFT,
    CLOCK_OFFSET,
    MAX_SENSORS,
    MODEL_NAME_LENGTH,
    Tag,
    sensor_name,
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


def _number_or(value: Any, default: float) -> float:
    return float(value) if isinstance(value, int | float) else default


@declared
class Press(PressForce):
    """A press on the line of a sensor."""

    sensor: str = sensor_name()
    location_mm: float = key(
        Number(unit="mm", low=0, high=10_000),
        doc="Centre of the contact, measured from port 1. Must lie on the sensor's line.",
    )


@declared
class Move:
    """A movement of a sensor's tag; its two-way path grows by twice the distance."""

    sensor: str = sensor_name()
    start_s: float = key(TIME, doc="Start of the movement.")
    duration_s: float = key(
        TIME,
        default=0.0,
        doc="Duration of the movement, at constant speed. The tag then stays where it is.",
    )
    distance_mm: float = key(
        Number(unit="mm", low=-1e5, high=1e5),
        doc="Change of the tag's distance from the reader, one way.",
    )


@declared
class Simulation:
    """What happens in a simulated scene.

    ``truth_model``, ``clock_offset_ppm`` and ``clock_drift_ppm_per_s`` are only the defaults of
    the entries of ``tags``, which has one entry per sensor, in the order of the sensors.
    """

    truth_model: str | None = key(
        Text(limit=MODEL_NAME_LENGTH, optional=True),
        doc="Sensor model that is pressed; null means the sensor's `model`. It should differ from "
        "`model`, otherwise the reader knows the sensor better than any calibration could.",
    )
    duration_s: float = key(
        Number(unit="s", low=0, above=True, high=LONGEST_S),
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
    link: Link | None = key(
        Mapping(of=Link, optional=True),
        doc="A link budget, from which `snr_db` and `static_clutter_db` follow; null means none.",
    )
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
            lambda scope: _number_or(scope["environment"].moving_clutter_hz, _MOVING_HZ),
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
    bursts: Bursts | None = key(
        Mapping(of=Bursts, optional=True),
        doc="Bursts of other transmitters over the whole band; null means none.",
    )
    hopper: Hopper | None = key(
        Mapping(of=Hopper, optional=True),
        doc="A narrow-band transmitter that hops; null means none.",
    )
    front_end: FrontEnd | None = key(
        Mapping(of=FrontEnd, optional=True),
        doc="Imperfections of transmitter and receiver; null means none.",
    )
    radio_noise: RadioNoise | None = key(
        Mapping(of=RadioNoise, optional=True),
        doc="Noise of synthesizers and transmitter; null means none.",
    )
    ripple: Ripple | None = key(
        Mapping(of=Ripple, optional=True),
        doc="Amplitude modulation of the received signal; null means none.",
    )
    lamps: Lamps | None = key(
        Mapping(of=Lamps, optional=True),
        doc="Lamps that modulate what they reflect; null means none.",
    )
    fan: Fan | None = key(Mapping(of=Fan, optional=True), doc="A fan; null means none.")
    walker: Walker | None = key(
        Mapping(of=Walker, optional=True),
        doc="A person who walks, beside `moving_clutter_db`; null means nobody.",
    )
    packets: PacketFaults | None = key(
        Mapping(of=PacketFaults, optional=True),
        doc="What happens to packets; null means nothing. Needs a scene with `packets`.",
    )
    other_tags: tuple[OtherTag, ...] = key(
        ListOf(of=OtherTag, most=MAX_SENSORS), doc="Tags that are not listed as sensors."
    )
    tags: tuple[Tag, ...] = key(
        ListOf(of=Tag, most=MAX_SENSORS), doc="Properties of single tags, at most one entry each."
    )
    presses: tuple[Press, ...] = key(ListOf(of=Press, most=MAX_EVENTS), doc="The presses.")
    plate: Plate = key(
        Mapping(of=Plate), doc="The skin of the surface, which the reader knows another law of."
    )
    surface_presses: tuple[SurfacePress, ...] = key(
        ListOf(of=SurfacePress, most=MAX_EVENTS), doc="The presses on the surface."
    )
    moves: tuple[Move, ...] = key(ListOf(of=Move, most=MAX_EVENTS), doc="The movements of tags.")
