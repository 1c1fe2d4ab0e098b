# SPDX-License-Identifier: GPL-3.0-or-later
"""Advice on a scene: what may go wrong, and changes that would make its readings better."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..scene import Scene
from ..signal.lines import HIGHEST_LINE, NYQUIST_MARGIN, lamp_distances_hz
from .bands import outside_band
from .clocks import ClockReport, assess_clocks
from .expected import expect
from .levels import receive_levels, why_not_readable
from .mains import lamp_multiples, lamp_warnings, lines_near_lamps
from .packet_advice import packet_changes, packet_warnings
from .plan import Plan
from .plan import plan as plan_of
from .proposed_clocks import propose_clocks

# A press that rises within so many groups is blurred by them.
_GROUPS_PER_RISE = 2
# A cost below half a dB, 6 % of a standard deviation, is not worth a warning.
_NOTICEABLE_DB = 0.5
# Difference between the levels of tags, in dB, that is worth a warning.
_LEVELS_APART_DB = 20
# Group lengths that are tried: 125, 250, 625 and 1250 snapshots of the default frame.
_GROUP_LENGTHS_S = (0.0072, 0.0144, 0.036, 0.072)
# Clocks are assessed in groups of at most this length: longer ones only resolve more.
_LONGEST_ASSESSED, _LONGEST_SEARCHED = 1250, 625
# Tags for which another clock is sought, those that lose most; each takes as long as a plan.
_TAGS_CHANGED = 4
# A reference of so many groups adds 1/12 to the variance of a reading.
_REFERENCE_GROUPS, _FEW_REFERENCE_GROUPS = 12, 4
# A proposal must lower the noise by 3 %, or shorten groups by 10 % at no more noise than that.
_WORTHWHILE_NOISE, _WORTHWHILE_TIME = 0.97, 0.9


@dataclass(frozen=True)
class Proposal:
    """A change to a scene and its effect.

    Attributes
    ----------
    change : str
        Key of the scene file and its new value.
    reason : str
    phase_std_deg, time_resolution_s : tuple of float, length 2
        Noise of the worst end and length of a phase group, now and after the change.

    Examples
    --------
    >>> Proposal("reference_s: 0.44", "longer", (0.1, 0.09), (0.036, 0.036)).change
    'reference_s: 0.44'
    """

    change: str
    reason: str
    phase_std_deg: tuple[float, float]
    time_resolution_s: tuple[float, float]


def warnings(plan: Plan) -> list[str]:
    """What may go wrong in a scene.

    Parameters
    ----------
    plan : Plan
        Of the scene.

    Returns
    -------
    list of str
        A sentence each.

    Examples
    --------
    >>> from gnuradio.wiforce.planning.plan import plan
    >>> from gnuradio.wiforce.scene import load_scene
    >>> warnings(plan(load_scene("two_sensors")))[0][:59]
    "clock collision: line 7 of 'left' falls on line 5 of 'right"
    """
    scene = plan.require_scene()
    if scene.packets is not None:
        return [
            *packet_warnings(plan),
            *_motion_warnings(scene, plan),
            *_receiver_warnings(scene),
            *_sensor_warnings(scene),
        ]
    return [
        *outside_band(scene),
        *_clock_warnings(scene, plan),
        *lamp_warnings(plan),
        *_motion_warnings(scene, plan),
        *_receiver_warnings(scene),
        *_sensor_warnings(scene),
    ]


def _assess(plan: Plan) -> ClockReport:
    tolerance_ppm = max(clock.planned_ppm for clock in plan.clocks)
    return assess_clocks(
        plan.clocks_hz,
        plan.waveform,
        min(plan.group_length, _LONGEST_ASSESSED),
        tolerance_ppm=tolerance_ppm,
        clutter_hz=plan.clutter_hz,
    )


def _clock_warnings(scene: Scene, plan: Plan) -> Iterator[str]:
    report = _assess(plan)
    names = scene.sensor_names
    yield from report.problems
    loss_db: dict[int, float] = {}
    for end in report.ends:
        loss_db[end.tag] = max(loss_db.get(end.tag, 0.0), end.loss_db)
    for tag, line, other, other_line in report.collisions:
        yield (
            f"clock collision: line {line} of '{names[tag]}' falls on line {other_line} of "
            f"'{names[other]}'; they are estimated jointly, at a cost of up to "
            f"{max(loss_db[tag], loss_db[other]):.2f} dB per end"
        )
    nyquist_hz = 0.5 / plan.waveform.snapshot_period_s
    for clock, name in zip(plan.clocks, names, strict=True):
        line_hz = HIGHEST_LINE * clock.clock_hz
        if line_hz > NYQUIST_MARGIN * nyquist_hz:
            yield (
                f"Nyquist: line {HIGHEST_LINE} of '{name}' ({line_hz:g} Hz) lies close to half the "
                f"snapshot rate ({nyquist_hz:.0f} Hz)"
            )
    levels = [tag.level_db for tag in scene.simulation.tags]
    if np.ptp(levels) > _LEVELS_APART_DB:
        yield (
            f"the levels of the tags differ by {np.ptp(levels):.0f} dB: a press of the strongest "
            "disturbs the readings of the weakest"
        )


def _motion_warnings(scene: Scene, plan: Plan) -> Iterator[str]:
    period_s = plan.group_period_s
    fast = [p.rise_s for p in scene.simulation.presses if p.rise_s < _GROUPS_PER_RISE * period_s]
    if fast:
        yield (
            f"N_g against dynamics: a press rises in {min(fast):g} s, a phase group lasts "
            f"{period_s:.3g} s; readings while it rises are averages, flagged 'transition'"
        )
    if plan.loss_db and max(plan.loss_db) > _NOTICEABLE_DB:
        yield (
            f"{plan.group_length} snapshots per group separate the lines from each other and from "
            f"clutter at a cost of {max(plan.loss_db):.1f} dB"
        )
    moves = scene.packets is None or scene.simulation.moving_clutter_db is not None
    if moves and scene.simulation.moving_clutter_hz > plan.clutter_hz:
        yield (
            f"moving clutter reaches {scene.simulation.moving_clutter_hz:g} Hz, but "
            f"environment.moving_clutter_hz is {plan.clutter_hz:g}: it leaks into the lines"
        )
    if plan.reference_groups < _FEW_REFERENCE_GROUPS:
        share = 100 / (1 + plan.reference_groups)
        yield (
            f"the untouched reference holds {plan.reference_groups} group(s): {share:.0f} % of "
            "the variance of every reading comes from it"
        )


def _receiver_warnings(scene: Scene) -> Iterator[str]:
    levels = receive_levels(scene)
    reasons = [why_not_readable(scene, i, levels) for i in range(len(scene.sensors))]
    yield from dict.fromkeys(filter(None, reasons))
    if not levels.out_of_range:
        cost_db = 10 * np.log10(1 + levels.quantisation / levels.noise)
        if cost_db > _NOTICEABLE_DB:
            yield f"ADC range: quantisation noise costs {cost_db:.1f} dB"


def accepted_suspicions(scene: Scene) -> list[str]:
    """Likely mistakes in the calibrations of a scene's sensors, which were accepted.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    list of str
        A sentence each.

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> accepted_suspicions(load_scene("demo"))
    []
    """
    return [
        f"sensor '{sensor.name}' was calibrated in spite of a suspicion: {text}"
        for sensor in scene.sensors
        for text in sensor.load_model(scene).provenance.get("suspicions", ())
    ]


def _sensor_warnings(scene: Scene) -> Iterator[str]:
    yield from accepted_suspicions(scene)
    for sensor in scene.sensors:
        model = sensor.load_model(scene)
        if model.transferred_from_hz and model.transfer_std_deg:
            yield (
                f"sensor '{sensor.name}' was calibrated at {model.transferred_from_hz / 1e6:g} "
                f"MHz: transferred to {model.frequencies_hz[0] / 1e6:g} MHz, each phase is "
                f"uncertain by {model.transfer_std_deg:.2g} deg; calibrate at the carrier in use "
                "for smaller errors"
            )
        for press in scene.simulation.presses:
            forces = [press.force_n, press.end_force_n]
            inside = model.in_span(forces, press.location_mm)
            if press.sensor == sensor.name and not np.all(inside):
                yield (
                    f"press of '{sensor.name}' at {press.start_s:g} s ({min(forces):g} to "
                    f"{max(forces):g} N at {press.location_mm:g} mm) leaves the span that its "
                    "model was calibrated for"
                )


def improve(plan: Plan) -> list[Proposal]:
    """Changes to a scene that would make its readings better, each by itself.

    Parameters
    ----------
    plan : Plan
        Of the scene.

    Returns
    -------
    list of Proposal

    Examples
    --------
    >>> from gnuradio.wiforce.planning.plan import plan
    >>> from gnuradio.wiforce.scene import load_scene
    >>> improve(plan(load_scene("demo")))[0].change
    'sounding.frame_length: 320, phase_group.snapshots: 1406'
    """
    now = _worst_std(plan)
    found = []
    scene = plan.require_scene()
    against_lamps = []
    if scene.packets is None:
        against_lamps = [*_lamp_changes(scene, plan), *_all_clocks_changes(scene, plan)]
    for change, reason, better in [*_changes(scene, plan), *against_lamps]:
        try:
            changed = plan_of(better)
            std = _worst_std(changed)
        except InputError:
            continue
        faster = changed.group_period_s < _WORTHWHILE_TIME * plan.group_period_s
        useful = faster or (change, reason, better) in against_lamps
        if std < _WORTHWHILE_NOISE * now or (useful and std < now / _WORTHWHILE_NOISE):
            times = (plan.group_period_s, changed.group_period_s)
            found.append(Proposal(change, reason, (now, std), times))
    return found


def _worst_std(plan: Plan) -> float:
    return max(max(sensor.phase_std_deg) for sensor in expect(plan))


def _changes(scene: Scene, plan: Plan) -> Iterator[tuple[str, str, Scene]]:
    """Text of the change, why, and the changed scene."""
    if scene.packets is not None:
        yield from packet_changes(scene, plan)
    else:
        yield from _guard_changes(scene)
        yield from _length_changes(scene, plan)
        yield from _clock_changes(scene, plan)
    if plan.reference_groups < _REFERENCE_GROUPS:
        reference_s = round(_REFERENCE_GROUPS * plan.group_period_s + 0.005, 2)
        yield (
            f"reference_s: {reference_s:g}",
            "a longer untouched reference",
            replace(scene, reference_s=reference_s),
        )


def _guard_changes(scene: Scene) -> Iterator[tuple[str, str, Scene]]:
    frame, preamble = scene.sounding.frame_length, scene.waveform().preamble_length
    if frame <= preamble:
        return
    snapshots = round(scene.phase_group.snapshots * frame / preamble)
    yield (
        f"sounding.frame_length: {preamble}, phase_group.snapshots: {snapshots}",
        f"no guard: {frame / preamble:.2f} times the preambles, in groups as long as now",
        replace(
            scene,
            sounding=replace(scene.sounding, frame_length=preamble),
            phase_group=replace(scene.phase_group, snapshots=snapshots),
        ),
    )


def _length_changes(scene: Scene, plan: Plan) -> Iterator[tuple[str, str, Scene]]:
    """Shorter groups follow presses; longer ones have less noise where nothing is fast."""
    rises = [press.rise_s for press in scene.simulation.presses]
    for period_s in _GROUP_LENGTHS_S:
        snapshots = round(period_s / plan.waveform.snapshot_period_s)
        longer = snapshots > plan.group_length
        blurred = rises and min(rises) < _GROUPS_PER_RISE * plan.group_period_s
        fits = not rises or min(rises) >= _GROUPS_PER_RISE * period_s
        if fits and (longer or (blurred and snapshots < plan.group_length)) and snapshots >= 32:
            yield (
                f"phase_group.snapshots: {snapshots}",
                "less noise, and presses rise slowly enough"
                if longer
                else "follows the presses; averaged over groups while nothing changes",
                replace(scene, phase_group=replace(scene.phase_group, snapshots=snapshots)),
            )


def _clock_changes(scene: Scene, plan: Plan) -> Iterator[tuple[str, str, Scene]]:
    """Another clock for each tag but the first, or for those that lose most."""
    clocks_hz = [sensor.clock_hz for sensor in scene.sensors]
    tags = list(range(1, len(clocks_hz)))
    if len(tags) > _TAGS_CHANGED:
        loss_db = np.max(np.reshape([end.loss_db for end in _assess(plan).ends], (-1, 2)), axis=1)
        tags = sorted(sorted(tags, key=lambda i: -loss_db[i])[:_TAGS_CHANGED])
    for i in tags:
        others = clocks_hz[:i] + clocks_hz[i + 1 :]
        try:
            (clock_hz,) = propose_clocks(
                1,
                plan.waveform,
                min(plan.group_length, _LONGEST_SEARCHED),
                others,
                tolerance_ppm=plan.clocks[i].planned_ppm,
                clutter_hz=plan.clutter_hz,
                mains_hz=scene.environment.possible_mains_hz,
            )
        except InputError:
            continue
        reason = f"lines of '{scene.sensors[i].name}' further from those of the other tags"
        yield _with_clock(scene, i, clock_hz, reason)


def _with_clock(scene: Scene, i: int, clock_hz: float, reason: str) -> tuple[str, str, Scene]:
    sensors = list(scene.sensors)
    sensors[i] = replace(sensors[i], clock_hz=clock_hz)
    changed = replace(scene, sensors=tuple(sensors))
    return f"sensors[{i}].clock_hz: {clock_hz:g}", reason, changed


def _lamp_changes(scene: Scene, plan: Plan) -> Iterator[tuple[str, str, Scene]]:
    """Clocks whose lines keep away from those of lamps, at no more noise."""
    mains_hz = scene.environment.possible_mains_hz
    for found in lines_near_lamps(plan):
        if found.better_hz is not None:
            reason = (
                f"strong lines of '{scene.sensor_names[found.tag]}' "
                f"{found.better_distance_hz:g} Hz instead of {found.distance_hz:g} Hz from "
                f"{lamp_multiples(mains_hz)}, where lamps have theirs"
            )
            yield _with_clock(scene, found.tag, found.better_hz, reason)


def _all_clocks_changes(scene: Scene, plan: Plan) -> Iterator[tuple[str, str, Scene]]:
    """Other clocks for all tags at once, where this keeps more than one tag away from lamps."""
    mains_hz = scene.environment.possible_mains_hz

    def near_lamps(clocks_hz: Sequence[float]) -> int:
        return sum(
            lamp_distances_hz(hz, mains_hz).min() * plan.group_period_s < 1 for hz in clocks_hz
        )

    now = near_lamps(plan.clocks_hz)
    if now < 2:
        return
    try:
        clocks_hz = propose_clocks(
            len(plan.clocks),
            plan.waveform,
            min(plan.group_length, _LONGEST_ASSESSED),
            tolerance_ppm=max(clock.planned_ppm for clock in plan.clocks),
            clutter_hz=plan.clutter_hz,
            mains_hz=mains_hz,
        )
    except InputError:
        return
    after = near_lamps(clocks_hz)
    if after <= now - 2:
        sensors = zip(scene.sensors, clocks_hz, strict=True)
        changed = tuple(replace(sensor, clock_hz=hz) for sensor, hz in sensors)
        shown = ", ".join(f"{hz:g}" for hz in clocks_hz)
        yield (
            f"sensors[0..{len(clocks_hz) - 1}].clock_hz: {shown}",
            f"strong lines of {after} instead of {now} tags lie within one bin of "
            f"{lamp_multiples(mains_hz)}, where lamps have theirs",
            replace(scene, sensors=changed),
        )
