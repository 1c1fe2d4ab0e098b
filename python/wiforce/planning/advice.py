# SPDX-License-Identifier: GPL-3.0-or-later
"""Advice on a scene: what may go wrong, and changes that would make its readings better."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..calibration.validation import verdict
from ..errors import InputError
from ..scene import Scene, accepted_suspicions
from ..sensor.curves import CurveModel
from ..signal.carrier import BANDS, occupied_band_hz
from ..signal.lines import STRONG_LINES, lamp_distances_hz
from .clocks import (
    FARTHER,
    assess_clocks,
    clocks_for,
    lamp_multiples,
    line_numbers,
)
from .expected import other_sensors_pressed, phase_std_deg, receive_levels, why_not_readable
from .loss import LONGEST
from .plan import Plan
from .plan import plan as plan_of


def outside_band(scene: Scene) -> Iterator[str]:
    """A warning when the signal lies outside the band that the scene states; else nothing."""
    name = scene.environment.band
    occupied_hz = occupied_band_hz(scene.radio.center_frequency_hz, scene.waveform())
    if name is not None and not (band := BANDS[name]).holds(*occupied_hz):
        yield (
            f"band: the signal occupies {_mhz(occupied_hz)}, which leaves environment.band {name} "
            f"({band.low_hz / 1e6:g} to {band.high_hz / 1e6:g} MHz): "
            "change radio.center_frequency_hz or radio.sample_rate_hz"
        )


def licence_note(scene: Scene) -> Iterator[str]:
    """A remark when no band is stated and the signal lies in none that is free of licences."""
    if scene.packets is not None:  # who sends the packets is licensed, or needs no licence
        return
    occupied_hz = occupied_band_hz(scene.radio.center_frequency_hz, scene.waveform())
    free = any(band.holds(*occupied_hz) for band in BANDS.values())
    if scene.environment.band is None and not free:
        yield (
            f"the signal occupies {_mhz(occupied_hz)}, which is inside none of the licence-free "
            f"bands {', '.join(BANDS)}: transmit over cables, or with a licence"
        )


def _mhz(band_hz: tuple[float, float]) -> str:
    return "{:.6g} to {:.6g} MHz".format(*(hertz / 1e6 for hertz in band_hz))


# SNR of a tag's first line beyond which it is unlikely: channel estimates of cards have 9 to 35 dB,
# and a tag that is half a metre away is 35 dB or more below the direct path (docs/wifi.md).
_HIGHEST_SNR_DB = 0.0


def _packet_warnings(plan: Plan) -> Iterator[str]:
    """What the times of packets and the static paths may do to readings."""
    scene = plan.require_scene()
    for tag, name in enumerate(scene.sensor_names):
        own = [t.owners for t in plan.table.tones if {(tag, 1), (tag, 4)} & {*t.owners}]
        if any(len(owners) > 1 for owners in own) or len(own) < 2:
            yield (
                f"aliases: packets at these times do not separate the lines of '{name}' from each "
                "other or from those of another tag; use another clock, or less regular packets"
            )
    snr_db = scene.simulation.snr_db
    if scene.environment.reader_clock == "free" and snr_db > _HIGHEST_SNR_DB:
        yield (
            f"simulation.snr_db: {snr_db:g} dB is more than channel estimates of a Wi-Fi card "
            "allow, unless the tag is next to an antenna, so the errors above are too small; a tag "
            "40 dB below a direct path of 30 dB has -10 dB"
        )


# A press that rises within so many groups is blurred by them.
_GROUPS_PER_RISE = 2
# A cost below half a dB, 6 % of a standard deviation, is not worth a warning.
_NOTICEABLE_DB = 0.5
# Group lengths that are tried: 125, 250, 625 and 1250 snapshots of the default frame.
_GROUP_LENGTHS_S = (0.0072, 0.0144, 0.036, 0.072)
# A reference of so many groups adds 1/12 to the variance of a reading.
_REFERENCE_GROUPS = 12
# A proposal must lower the noise by 3 %, or shorten groups by 10 % at no more noise than that.
_WORTHWHILE_NOISE, _WORTHWHILE_TIME = 0.97, 0.9


@dataclass(frozen=True)
class Proposal:
    """A change to a scene, and the worst end's noise and resolution before and after."""

    change: str
    reason: str
    phase_std_deg: tuple[float, float]
    time_resolution_s: tuple[float, float]


def warnings(plan: Plan) -> list[str]:
    """What may go wrong in a scene, a sentence each."""
    scene = plan.require_scene()
    if scene.packets is not None:
        own = [*_packet_warnings(plan)]
    else:
        own = [*outside_band(scene), *_clock_warnings(plan)]
    return [
        *own,
        *_lamp_warnings(scene, plan),
        *_motion_warnings(scene, plan),
        *_receiver_warnings(scene),
        *_sensor_warnings(scene),
        *other_sensors_pressed(plan),
        *_surface_warnings(scene, plan),
    ]


def _clock_warnings(plan: Plan) -> Iterator[str]:
    # Longer groups only resolve more, and would take minutes.
    shortened = replace(plan, group_length=min(plan.group_length, LONGEST))
    yield from assess_clocks(shortened).problems
    if plan.waveform.repetitions == 1:
        yield (
            "only one repetition is averaged: bursts of other transmitters are not recognised, "
            "since this takes the difference of two"
        )


def _lamp_warnings(scene: Scene, plan: Plan) -> Iterator[str]:
    """Tags whose strong lines lie within a bin of those of lamps, where other clocks would help."""
    mains_hz, bin_hz = scene.environment.possible_mains_hz, 1 / plan.group_period_s
    now_hz = [lamp_distances_hz(clock.clock_hz, mains_hz) for clock in plan.clocks]
    near = [tag for tag, hz in enumerate(now_hz) if hz.min() < bin_hz]
    clocks_hz = _proposed_hz(scene) if near else []
    for tag in near:
        hz = clocks_hz[tag]
        distance_hz = float(lamp_distances_hz(hz, mains_hz).min())
        if distance_hz == 0 or distance_hz < FARTHER * now_hz[tag].min():
            continue
        lines = [m for m, own in zip(STRONG_LINES, now_hz[tag], strict=True) if own < bin_hz]
        yield (
            f"lamps: {line_numbers(lines)} of '{scene.sensor_names[tag]}' "
            f"{'lies' if len(lines) == 1 else 'lie'} within one bin ({bin_hz:.3g} Hz) of "
            f"{lamp_multiples(mains_hz)}; with a clock of {hz:g} Hz they keep {distance_hz:g} Hz "
            "away (environment.mains_hz: null where there are no lamps)"
        )


def _proposed_hz(scene: Scene) -> list[float]:
    """Clocks proposed for the tags of a scene; their own where none fit."""
    try:
        return clocks_for(scene, len(scene.sensors)).clocks_hz
    except InputError:
        return [sensor.clock_hz for sensor in scene.sensors]


def _motion_warnings(scene: Scene, plan: Plan) -> Iterator[str]:
    period_s = plan.group_period_s
    fast = [p.rise_s for p in scene.simulation.presses if p.rise_s < _GROUPS_PER_RISE * period_s]
    if fast:
        yield (
            f"N_g against dynamics: a press rises in {min(fast):g} s, a phase group lasts "
            f"{period_s:.3g} s; readings while it rises are averages, flagged 'transition'"
        )
    moves = scene.packets is None or scene.simulation.moving_clutter_db is not None
    if moves and scene.simulation.moving_clutter_hz > plan.clutter_hz:
        yield (
            f"moving clutter reaches {scene.simulation.moving_clutter_hz:g} Hz, but "
            f"environment.moving_clutter_hz is {plan.clutter_hz:g}: it leaks into the lines"
        )
    if scene.simulation.moves:
        yield "simulation.moves: the errors above are those of tags that stand still"


def _receiver_warnings(scene: Scene) -> Iterator[str]:
    levels = receive_levels(scene)
    reasons = [why_not_readable(scene, i, levels) for i in range(len(scene.sensors))]
    yield from dict.fromkeys(filter(None, reasons))
    cost_db = 10 * np.log10(1 + levels.radio / levels.noise)
    if cost_db > _NOTICEABLE_DB:
        yield (
            f"dynamic range: noise of the radio on the static path costs {cost_db:.1f} dB; weaken "
            "the direct path, or use a radio whose transmitter and receiver share a synthesizer"
        )


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
        if isinstance(model, CurveModel):
            for each in verdict(model):
                if each.unusable:
                    yield f"sensor '{sensor.name}', by its calibration: {each.unusable}"
        for press in scene.simulation.presses:
            forces = [press.force_n, press.end_force_n]
            inside = model.in_span(forces, press.location_mm)
            if press.sensor == sensor.name and not np.all(inside):
                yield (
                    f"press of '{sensor.name}' at {press.start_s:g} s ({min(forces):g} to "
                    f"{max(forces):g} N at {press.location_mm:g} mm) leaves the span that its "
                    "model was calibrated for"
                )


# With this share a press between two strips that are shorted by 0.9 N is seen from 3.6 N on.
_LEAST_SHARE = 0.25


def _surface_warnings(scene: Scene, plan: Plan) -> Iterator[str]:
    """What a user of a surface should know before a measurement."""
    if scene.surface is None:
        return
    if plan.skin is None:
        yield "surface: without a spreading law it is not read; `calibrate --surface` makes one"
        return
    skin = plan.skin
    between = skin.shares((skin.y_mm[1:] + skin.y_mm[:-1]) / 2).max(axis=-1).min()
    if between < _LEAST_SHARE:
        onset = float(skin.onset_force_n.max() / max(between, 1e-3))
        yield (
            f"surface: between strips the largest share is {between:.2f}; presses below "
            f"{onset:.1f} N are not seen there; lay the strips closer, or use a stiffer skin"
        )


def improve(plan: Plan) -> list[Proposal]:
    """Changes to a scene that would make its readings better, each by itself."""
    now = float(phase_std_deg(plan).max())
    found = []
    for change, reason, better in _changes(plan.require_scene(), plan):
        try:
            changed = plan_of(better)
            std = float(phase_std_deg(changed).max())
        except InputError:
            continue
        # Clocks are proposed where they are better: of lamps, the noise says nothing.
        useful = changed.clocks_hz != plan.clocks_hz
        useful |= changed.group_period_s < _WORTHWHILE_TIME * plan.group_period_s
        if std < _WORTHWHILE_NOISE * now or (useful and std < now / _WORTHWHILE_NOISE):
            times = (plan.group_period_s, changed.group_period_s)
            found.append(Proposal(change, reason, (now, std), times))
    return found


# Text of a change, why, and the changed scene.
_Change = tuple[str, str, Scene]


def _changes(scene: Scene, plan: Plan) -> Iterator[_Change]:
    """Changes that may make readings better."""
    frame, preamble = scene.sounding.frame_length, scene.waveform().preamble_length
    if scene.packets is None:
        if frame > preamble:
            yield _changed(
                scene,
                f"no guard: {frame / preamble:.2f} times the preambles, in groups as long as now",
                sounding={"frame_length": preamble},
                phase_group={"snapshots": round(scene.phase_group.snapshots * frame / preamble)},
            )
        yield from _length_changes(scene, plan)
    yield from _clock_changes(scene)
    if plan.reference_groups < _REFERENCE_GROUPS:
        reference_s = round(_REFERENCE_GROUPS * plan.group_period_s + 0.005, 2)
        longer = replace(scene, reference_s=reference_s)
        yield f"reference_s: {reference_s:g}", "a longer untouched reference", longer


def _changed(scene: Scene, reason: str, **sections: dict[str, int]) -> _Change:
    """A scene with other keys of its sections."""
    texts = [f"{name}.{key}: {own[key]}" for name, own in sections.items() for key in own]
    better = {name: replace(getattr(scene, name), **own) for name, own in sections.items()}
    return ", ".join(texts), reason, replace(scene, **better)


def _length_changes(scene: Scene, plan: Plan) -> Iterator[_Change]:
    """Shorter groups follow presses; longer ones have less noise where nothing is fast."""
    fastest_s = min((press.rise_s for press in scene.simulation.presses), default=np.inf)
    for period_s in _GROUP_LENGTHS_S:
        snapshots = round(period_s / plan.waveform.snapshot_period_s)
        if fastest_s < _GROUPS_PER_RISE * period_s or snapshots < 32:
            continue
        if snapshots > plan.group_length:
            reason = "less noise, and presses rise slowly enough"
        elif snapshots < plan.group_length and fastest_s < _GROUPS_PER_RISE * plan.group_period_s:
            reason = "follows the presses; averaged over groups while nothing changes"
        else:
            continue
        yield _changed(scene, reason, phase_group={"snapshots": snapshots})


def _clock_changes(scene: Scene) -> Iterator[_Change]:
    """The clocks of `clocks_for`, where they are others."""
    clocks_hz, now_hz = _proposed_hz(scene), [sensor.clock_hz for sensor in scene.sensors]
    tags = [i for i, hz in enumerate(clocks_hz) if hz != now_hz[i]]
    if not tags:
        return
    mains_hz = scene.environment.possible_mains_hz
    now, then = (
        min(float(lamp_distances_hz(clocks[i], mains_hz).min()) for i in tags)
        for clocks in (now_hz, clocks_hz)
    )
    reason = "lines are further from those of other tags"
    if then > now:
        lamps = f"from {lamp_multiples(mains_hz)}, where lamps have theirs"
        reason = f"lines are {then:g} Hz instead of {now:g} Hz {lamps}"
    yield (
        ", ".join(f"sensors[{i}].clock_hz: {clocks_hz[i]:.9g}" for i in tags),
        reason,
        scene.with_clocks({i: clocks_hz[i] for i in tags}),
    )
