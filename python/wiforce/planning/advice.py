# SPDX-License-Identifier: GPL-3.0-or-later
"""What may go wrong in a scene, and what would make it better."""

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from .clocks import assess_clocks, propose_clocks
from .expected import expect, receive_levels, why_not_readable
from .plan import plan as plan_of

# A press that rises within so many groups is blurred by them.
_GROUPS_PER_RISE = 2
# Shares of the reading's variance, or dB, that are worth a word.
_WORTH_DB = 0.5
_NYQUIST_MARGIN = 0.9
_LEVELS_APART_DB = 20
_SHORTEST_FRAME = 320
_GROUP_LENGTHS_S = (0.0072, 0.0144, 0.036, 0.072)
# What a proposal must bring to be made.
_WORTH = 0.97


@dataclass(frozen=True)
class Proposal:
    """A change to a scene and what it would bring.

    Attributes
    ----------
    change : str
        Key of the scene file and its new value.
    reason : str
    phase_std_deg, time_resolution_s : (float, float)
        Noise of the worst end and length of a phase group, now and after the change.
    """

    change: str
    reason: str
    phase_std_deg: tuple
    time_resolution_s: tuple


def warnings(scene, plan):
    """What may go wrong, a sentence each.

    Parameters
    ----------
    scene : Scene
    plan : Plan

    Returns
    -------
    list of str
    """
    return [
        *_clock_warnings(scene, plan),
        *_motion_warnings(scene, plan),
        *_receiver_warnings(scene),
        *_sensor_warnings(scene),
    ]


def _assess(plan):
    tolerance_ppm = max(clock.tolerance_ppm for clock in plan.clocks)
    return assess_clocks(
        [clock.clock_hz for clock in plan.clocks],
        plan.waveform,
        min(plan.group_length, 1250),
        tolerance_ppm=tolerance_ppm,
        clutter_hz=plan.clutter_hz,
    )


def _clock_warnings(scene, plan):
    report = _assess(plan)
    names = scene.sensor_names
    yield from report.problems
    loss_db = {}
    for end in report.ends:
        loss_db[end.tag] = max(loss_db.get(end.tag, 0.0), end.loss_db)
    for tag, line, other, other_line in report.collisions:
        yield (
            f"clock collision: line {line} of '{names[tag]}' falls on line {other_line} of "
            f"'{names[other]}'; solved for together, ends lose up to "
            f"{max(loss_db[tag], loss_db[other]):.2f} dB in all"
        )
    nyquist_hz = 0.5 / plan.waveform.snapshot_period_s
    for clock, name in zip(plan.clocks, names, strict=True):
        if 4 * clock.clock_hz > _NYQUIST_MARGIN * nyquist_hz:
            yield (
                f"Nyquist: line 4 of '{name}' ({4 * clock.clock_hz:g} Hz) lies close to half the "
                f"snapshot rate ({nyquist_hz:.0f} Hz)"
            )
    levels = [tag.level_db for tag in scene.simulation.tags]
    if np.ptp(levels) > _LEVELS_APART_DB:
        yield f"tags differ by {np.ptp(levels):.0f} dB: a press of the strong one disturbs the weak"


def _motion_warnings(scene, plan):
    period_s = plan.group_period_s
    fast = [p.rise_s for p in scene.simulation.presses if p.rise_s < _GROUPS_PER_RISE * period_s]
    if fast:
        yield (
            f"N_g against dynamics: a press rises in {min(fast):g} s, a phase group lasts "
            f"{period_s:.3g} s; readings while it rises are averages and flagged 'transition'"
        )
    if plan.loss_db and max(plan.loss_db) > _WORTH_DB:
        yield (
            f"{plan.group_length} snapshots per group tell the lines from each other and from "
            f"clutter at a cost of {max(plan.loss_db):.1f} dB"
        )
    if scene.simulation.moving_clutter_hz > plan.clutter_hz:
        yield (
            f"what moves reaches {scene.simulation.moving_clutter_hz:g} Hz, but "
            f"environment.moving_clutter_hz is {plan.clutter_hz:g}: it leaks into the lines"
        )
    if plan.reference_groups < 4:
        share = 100 / (1 + plan.reference_groups)
        yield (
            f"the untouched reference holds {plan.reference_groups} group(s): {share:.0f} % of "
            "the variance of every reading comes from it"
        )


def _receiver_warnings(scene):
    levels = receive_levels(scene)
    reasons = [why_not_readable(scene, i, levels) for i in range(len(scene.sensors))]
    yield from dict.fromkeys(filter(None, reasons))
    if not levels.out_of_range:
        cost_db = 10 * np.log10(1 + levels.quantisation / levels.noise)
        if cost_db > _WORTH_DB:
            yield f"ADC range: the ADC's steps cost {cost_db:.1f} dB"


def _sensor_warnings(scene):
    for sensor in scene.sensors:
        model = sensor.load_model(scene)
        for press in scene.simulation.presses:
            forces = [press.force_n, press.end_force_n]
            inside = model.in_span(forces, press.location_mm)
            if press.sensor == sensor.name and not np.all(inside):
                yield (
                    f"press of '{sensor.name}' at {press.start_s:g} s ({min(forces):g} to "
                    f"{max(forces):g} N at {press.location_mm:g} mm) leaves what its model was "
                    "calibrated for"
                )


def improve(scene, plan):
    """Changes to a scene that would make its readings better.

    Returns
    -------
    list of Proposal
    """
    now = _worst_std(scene, plan)
    found = []
    for change, reason, better in _changes(scene, plan):
        try:
            changed = plan_of(better)
            std = _worst_std(better, changed)
        except InputError:
            continue
        faster = changed.group_period_s < 0.9 * plan.group_period_s
        if std < _WORTH * now or (faster and std < now / _WORTH):
            times = (plan.group_period_s, changed.group_period_s)
            found.append(Proposal(change, reason, (now, std), times))
    return found


def _worst_std(scene, plan):
    return max(max(sensor.phase_std_deg) for sensor in expect(scene, plan))


def _changes(scene, plan):
    """(text of the change, why, the changed scene), each by itself."""
    yield from _guard_changes(scene)
    yield from _length_changes(scene, plan)
    yield from _clock_changes(scene, plan)
    if plan.reference_groups < 12:
        reference_s = round(12 * plan.group_period_s + 0.005, 2)
        yield (
            f"reference_s: {reference_s:g}",
            "a longer untouched reference",
            replace(scene, reference_s=reference_s),
        )


def _guard_changes(scene):
    frame = scene.sounding.frame_length
    if frame <= _SHORTEST_FRAME:
        return
    snapshots = round(scene.phase_group.snapshots * frame / _SHORTEST_FRAME)
    yield (
        f"sounding.frame_length: {_SHORTEST_FRAME}, phase_group.snapshots: {snapshots}",
        f"no guard: {frame / _SHORTEST_FRAME:.2f} x the preambles, in groups as long as now",
        replace(
            scene,
            sounding=replace(scene.sounding, frame_length=_SHORTEST_FRAME),
            phase_group=replace(scene.phase_group, snapshots=snapshots),
        ),
    )


def _length_changes(scene, plan):
    """Shorter groups follow presses; longer ones are quieter where nothing is fast."""
    rises = [press.rise_s for press in scene.simulation.presses]
    for period_s in _GROUP_LENGTHS_S:
        snapshots = round(period_s / plan.waveform.snapshot_period_s)
        longer = snapshots > plan.group_length
        blurred = rises and min(rises) < _GROUPS_PER_RISE * plan.group_period_s
        fits = not rises or min(rises) >= _GROUPS_PER_RISE * period_s
        if fits and (longer or (blurred and snapshots < plan.group_length)) and snapshots >= 32:
            yield (
                f"phase_group.snapshots: {snapshots}",
                "quieter, and presses rise slowly enough"
                if longer
                else "follows the presses; averaged again while nothing changes",
                replace(scene, phase_group=replace(scene.phase_group, snapshots=snapshots)),
            )


def _clock_changes(scene, plan):
    """Another clock for each tag but the first."""
    clocks_hz = [sensor.clock_hz for sensor in scene.sensors]
    for i, sensor in enumerate(scene.sensors[1:], 1):
        others = clocks_hz[:i] + clocks_hz[i + 1 :]
        better = propose_clocks(
            1,
            plan.waveform,
            min(plan.group_length, 625),
            others,
            tolerance_ppm=sensor.clock_tolerance_ppm,
            clutter_hz=plan.clutter_hz,
        )
        for clock_hz in better:
            sensors = list(scene.sensors)
            sensors[i] = replace(sensor, clock_hz=clock_hz)
            yield (
                f"sensors[{i}].clock_hz: {clock_hz:g}",
                f"lines of '{sensor.name}' further from those of the others",
                replace(scene, sensors=tuple(sensors)),
            )
