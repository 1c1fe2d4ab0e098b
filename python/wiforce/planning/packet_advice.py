# SPDX-License-Identifier: GPL-3.0-or-later
"""Advice on a scene with packets: clocks that suit their times, and what may go wrong."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..estimation.tracked_tag import TagClock
from ..scene import Scene
from ..signal.lines import STRONG_LINES, lamp_distances_hz
from ..signal.timed_weights import clutter_at, timed_lines
from .expected import phase_std_deg
from .loss import end_variances
from .mains import lamp_multiples, lines_lie, too_near
from .plan import Plan
from .plan import plan as plan_of

# Clocks that are tried: slow tags, whose oscillators are watch crystals and dividers. Higher ones
# gain nothing where packets are irregular, and meet their own aliases where they are regular.
_LOWEST_HZ, _HIGHEST_HZ, _STEP_HZ = 50.0, 200.0, 1.0
# Clocks that leave the worst end this much of the best one's information have about the same
# expected error, 2.5 % of a standard deviation; among them lamps decide.
_ABOUT_EQUAL = 0.95
# Distance of strong lines from those of lamps, in bins of a group, up to which they interfere.
_NEAR_BINS = 2.0
# SNR of a tag's first line beyond which it is unlikely: channel estimates of cards have 9 to 35 dB,
# and a tag that is half a metre away is 35 dB or more below the direct path (docs/wifi.md).
_HIGHEST_SNR_DB = 0.0


@dataclass(frozen=True)
class PacketClocks:
    """Clocks that suit the times of packets.

    Attributes
    ----------
    clocks_hz : tuple of float
        One per sensor, in Hz.
    lamp_distance_hz : float
        Of their strong lines to the nearest line of a lamp; infinite without lamps.

    Examples
    --------
    >>> PacketClocks((85.0,), 10.0).clocks_hz
    (85.0,)
    """

    clocks_hz: tuple[float, ...]
    lamp_distance_hz: float


def recommend_clocks(plan: Plan) -> PacketClocks | None:
    """Clocks between 50 and 200 Hz for the tags of a scene with packets.

    One after the other, each leaves the worst end nearly the most information at the times of a
    typical group; among such clocks, it is the one farthest from the lines of lamps.

    Parameters
    ----------
    plan : Plan
        Of a scene with packets.

    Returns
    -------
    PacketClocks or None
        None where no clock can be distinguished from clutter and from itself at these times.

    Examples
    --------
    >>> from gnuradio.wiforce.planning.plan import plan
    >>> settings = plan({
    ...     "packets": {}, "phase_group": {"snapshots": 300},
    ...     "sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 120}]})
    >>> found = recommend_clocks(settings)
    >>> found.clocks_hz, found.lamp_distance_hz
    ((165.0,), 30.0)
    """
    mains_hz = plan.require_scene().environment.possible_mains_hz
    chosen: list[TagClock] = []
    for clock in plan.clocks:
        best = _best(plan, chosen, clock, mains_hz)
        if best is None:
            return None
        chosen.append(best)
    clocks_hz = tuple(clock.clock_hz for clock in chosen)
    distance = min(float(lamp_distances_hz(hertz, mains_hz).min()) for hertz in clocks_hz)
    return PacketClocks(clocks_hz, distance)


def _best(
    plan: Plan, chosen: Sequence[TagClock], clock: TagClock, mains_hz: Sequence[float]
) -> TagClock | None:
    """The clock of a further tag beside those chosen."""
    bin_hz = 1 / plan.group_period_s
    found: list[tuple[float, float, TagClock]] = []
    for hertz in np.arange(_LOWEST_HZ, _HIGHEST_HZ + _STEP_HZ / 2, _STEP_HZ).tolist():
        trial = replace(clock, clock_hz=hertz, nominal_hz=None)
        if any(too_near(hertz, other.clock_hz, bin_hz) for other in chosen):
            continue
        distance = float(lamp_distances_hz(hertz, mains_hz).min())
        information = _information(plan, [*chosen, trial])
        if information > 0:
            found.append((information, distance, trial))
    if not found:
        return None
    most = max(information for information, _, _ in found)
    good = [each for each in found if each[0] >= _ABOUT_EQUAL * most]
    return max(good, key=lambda each: (each[1], each[0]))[2]


def _information(plan: Plan, clocks: Sequence[TagClock]) -> float:
    """Information on the worst end of some tags at the times of a typical group; 0 if unusable."""
    times_s, period_s = plan.times_s, plan.group_period_s
    if times_s is None:
        return 0.0
    clocks_hz = [clock.clock_hz for clock in clocks]
    # The lines that are read must be those of one tag each, and not their own mirror images.
    owners = [tone.owners for tone in timed_lines(clocks_hz, times_s, period_s, plan.clutter_hz)]
    for tag in range(len(clocks)):
        alone = {abs(each[0][1]) for each in owners if len(each) == 1 and each[0][0] == tag}
        if not {1, 2, 4} <= alone:
            return 0.0
    clutter = np.linalg.qr(clutter_at(times_s, period_s, plan.clutter_hz))[0]
    variances = end_variances(clocks, times_s, plan.waveform.averaging_s, clutter)
    return float(1 / variances.max())


def packet_warnings(plan: Plan) -> Iterator[str]:
    """What the times of packets, lamps and the static paths may do to readings.

    Parameters
    ----------
    plan : Plan
        Of a scene with packets.

    Yields
    ------
    str
        A sentence each.

    Examples
    --------
    >>> from gnuradio.wiforce.planning.plan import plan
    >>> settings = plan({
    ...     "packets": {}, "phase_group": {"snapshots": 300},
    ...     "sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 120}]})
    >>> next(packet_warnings(settings))[:49]
    "mains: lines 1, 2 and 4 of 'arm' lie within 6.67 "
    """
    scene = plan.require_scene()
    mains_hz = scene.environment.possible_mains_hz
    near_hz = _NEAR_BINS / plan.group_period_s
    for clock, name in zip(plan.clocks, scene.sensor_names, strict=True):
        apart = lamp_distances_hz(clock.clock_hz, mains_hz)
        near = [line for line, hz in zip(STRONG_LINES, apart.tolist(), strict=True) if hz < near_hz]
        if near:
            yield (
                f"mains: {lines_lie(near, name)} within {near_hz:.3g} Hz of "
                f"{lamp_multiples(mains_hz)}: where a lamp modulates what it reflects, this tag is "
                "disturbed"
            )
    yield from _alias_warnings(plan)
    snr_db = scene.simulation.snr_db
    if scene.environment.reader_clock == "free" and snr_db > _HIGHEST_SNR_DB:
        yield (
            f"simulation.snr_db: {snr_db:g} dB is more than channel estimates of a Wi-Fi card "
            "allow, unless the tag is next to an antenna, so the errors above are too small; a tag "
            "40 dB below a direct path of 30 dB has -10 dB"
        )


def _alias_warnings(plan: Plan) -> Iterator[str]:
    scene = plan.require_scene()
    lines = plan.table.tones
    for tag, name in enumerate(scene.sensor_names):
        own = [tone.owners for tone in lines if (tag, 1) in tone.owners or (tag, 4) in tone.owners]
        if any(len(owners) > 1 for owners in own) or len(own) < 2:
            yield (
                f"aliases: packets at these times do not separate the lines of '{name}' from each "
                "other or from those of another tag; use another clock, or less regular packets"
            )


def packet_changes(scene: Scene, plan: Plan) -> Iterator[tuple[str, str, Scene]]:
    """Clocks that are better for the times of packets: change, reason, and the changed scene.

    Parameters
    ----------
    scene : Scene
        With packets.
    plan : Plan
        Of it.

    Yields
    ------
    tuple of str, str and Scene

    Examples
    --------
    >>> from gnuradio.wiforce.planning.plan import plan
    >>> settings = plan({
    ...     "packets": {}, "phase_group": {"snapshots": 300},
    ...     "sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 120}]})
    >>> next(packet_changes(settings.require_scene(), settings))[0]
    'sensors[0].clock_hz: 165'
    """
    found = recommend_clocks(plan)
    if found is None:
        return
    mains_hz = scene.environment.possible_mains_hz
    sensors = [
        replace(sensor, clock_hz=hertz)
        for sensor, hertz in zip(scene.sensors, found.clocks_hz, strict=True)
    ]
    change = ", ".join(
        f"sensors[{i}].clock_hz: {hertz:g}" for i, hertz in enumerate(found.clocks_hz)
    )
    reason = f"suits packets every {1e3 * scene.snapshot_period_s:.3g} ms"
    if mains_hz:
        reason += (
            f", strong lines {found.lamp_distance_hz:g} Hz or more from {lamp_multiples(mains_hz)}"
        )
    yield change, reason, replace(scene, sensors=tuple(sensors))


def recommendation(plan: Plan) -> str | None:
    """The clocks recommended for a scene with packets, as a sentence.

    Parameters
    ----------
    plan : Plan

    Returns
    -------
    str or None
        None for a scene of samples, and where no clock is usable.

    Examples
    --------
    >>> from gnuradio.wiforce.planning.plan import plan
    >>> recommendation(plan("demo")) is None
    True
    """
    scene = plan.require_scene()
    if scene.packets is None:
        return None
    for change, reason, changed in packet_changes(scene, plan):
        try:
            std = phase_std_deg(plan_of(changed))
        except InputError:
            return None
        noise = "/".join(f"{worst:.3g}" for worst in std.max(axis=0))
        level = f"at snr_db {scene.simulation.snr_db:g}"
        return f"recommended clocks: {change} ({reason}); noise {noise} deg rms {level}"
    return None
