# SPDX-License-Identifier: GPL-3.0-or-later
"""What a simulation knows about the tag of each sensor, and a reader does not."""

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ..io.text.schema import Derived, Mapping, declared, key, read
from ..io.text.values import Choice, KeyPath, Number, Scope, Text
from .effects import Beam, Hand

if TYPE_CHECKING:
    from .schema import SceneSensor
    from .simulated import Simulation

MAX_SENSORS = 16
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
    beam: Beam | None = key(
        Mapping(of=Beam, optional=True),
        doc="Hysteresis and creep of the soft beam; null means an elastic beam.",
    )
    hand: Hand | None = key(
        Mapping(of=Hand, optional=True),
        doc="A second path of the tag, by way of the hand that presses; null means none.",
    )


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
