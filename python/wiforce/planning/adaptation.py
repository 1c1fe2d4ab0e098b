# SPDX-License-Identifier: GPL-3.0-or-later
"""The survey of the room in the reference of a run, and the plan that is adapted to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..estimation.clocks.tracked_tag import TagClock
from ..estimation.room.clock_lines import measured
from ..estimation.room.sources import Source
from ..estimation.room.survey import LONGEST_S, SHORTEST_S, Survey, survey_channel
from ..signal.lines import CLUTTER_MARGIN, RoomNoise
from ..signal.switching import harmonics
from ..signal.weights import ToneTable
from .plan import Plan

# Noise that the room adds to a tone, relative to white noise and averaged over the subcarriers,
# below which the weights stay as they are: it costs 0.2 dB in that tone.
NEGLIGIBLE = 0.05
# Noise in a tone, relative to that with weights for the latest survey, up to which weights for an
# earlier one are kept: 0.4 dB.
_AS_GOOD = 1.1
# Tags that are solved for besides the scene's: each costs as much time per group as a sensor.
_MOST_TAGS = 2
# A line's frequency is known to this part of its width, and may drift by as much again.
_LINE_PRECISION = 10.0
# The survey sees motion for half a second only; what moves may be faster a moment later.
_RESERVE = 1.5


def adapted(plan: Plan, survey: Survey | None) -> Plan:
    """Adapt the clocks and weights of a plan to a room, by a survey of the untouched sensor.

    The same plan where its weights let nothing through. Refuses clocks whose lines nearly coincide
    as measured, and two tags within the tolerance of one clock.
    """
    if survey is None:
        return plan
    _require_one_tag_each(plan, survey)
    clocks = tuple(map(measured, plan.clocks, survey.clocks))
    if clocks != plan.clocks:
        plan = plan.with_clocks(clocks)
    two_antennas = plan.require_scene().environment.receive_antennas > 1
    if two_antennas:
        plan = plan.stating(tag_ratios=_tag_ratios(plan, survey))
    if plan.estimator != "harmonic":
        return plan
    plan = _with_band(plan, survey)
    length, clutter_hz = plan.group_length, plan.clutter_hz
    if room_noise_of_tones(plan.table, survey.noise(length, clutter_hz)).max() < NEGLIGIBLE:
        return plan
    solved = []
    for source in [source for source in survey.sources if source.kind == "tag"][:_MOST_TAGS]:
        more = replace(plan, others=(*plan.others, _clock_of(source, survey)))
        # Where its lines and ours coincide, it is noise.
        if more.separable:
            plan = more
            solved.append(source)
    if two_antennas:  # lines of the ratio, such as those of mirror images, are not additive noise
        return plan
    room = survey.noise(length, clutter_hz, solved)
    if room_noise_of_tones(plan.table, room).max() < NEGLIGIBLE:
        return plan
    colored = replace(plan, room=room)
    if colored.separable:
        return colored
    # Where this leaves no line to read, the power in a single subcarrier may leave some.
    colored = replace(plan, room=survey.noise(length, clutter_hz, solved, averaged=False))
    return colored if colored.separable else plan


def expecting_snr(plan: Plan, survey: Survey | None) -> Plan:
    """State what a survey expects of tags: lamps on their lines, SNR unless others are solved."""
    if survey is None:
        return plan
    lamps = [source for source in survey.sources if source.kind == "lamps"]
    met = [source.meets(plan.clocks_hz, plan.group_period_s) for source in lamps]
    in_lamps = np.any(met, axis=0).tolist() if met else [False] * len(plan.clocks)
    snr_db = () if plan.others else survey.snr_db
    return plan.stating(in_lamps=tuple(in_lamps), surveyed_snr_db=snr_db)


def readapted(current: Plan, plan: Plan, survey: Survey) -> Plan:
    """The plan for a room that was surveyed again.

    ``current`` remains where it reads the room about as well: surveys always differ a little.
    """
    better = adapted(plan, survey)
    suits = (
        _same_clocks(current.clocks, better.clocks)
        and _same_clocks(current.others, better.others)
        and current.clutter_hz >= better.clutter_hz
        and len(current.table.tones) == len(better.table.tones)
    )
    if suits:
        solved = [each for each in survey.sources if _clock_of(each, survey) in better.others]
        # In one subcarrier: surveys of the same lamps differ by more than averages may.
        room = survey.noise(plan.group_length, better.clutter_hz, solved, averaged=False)
        # White noise of a snapshot, of variance 1, and what the room adds to it.
        noise, least = (
            np.sum(np.abs(each.table.weights) ** 2, axis=1)
            * (1 + room_noise_of_tones(each.table, room))
            for each in (current, better)
        )
        suits = bool(np.all(noise <= _AS_GOOD * least))
    return current if suits else better


def _same_clocks(clocks: Sequence[TagClock], others: Sequence[TagClock]) -> bool:
    """Whether two lists hold the same clocks within the tolerance of the first, in any order."""
    one, other = (sorted(each, key=lambda clock: clock.clock_hz) for each in (clocks, others))
    return len(one) == len(other) and all(
        abs(a.clock_hz - b.clock_hz) <= 1e-6 * a.tolerance_ppm * a.clock_hz
        for a, b in zip(one, other, strict=True)
    )


def _require_one_tag_each(plan: Plan, survey: Survey) -> None:
    """Refuse to guess which of two tags a sensor's is."""
    for tag, line in enumerate(survey.clocks):
        if line.rival_hz is not None:
            rule = (
                f"must say which tag is meant, as must its tolerance: there is one at "
                f"{line.clock_hz:.1f} Hz and one at {line.rival_hz:.1f} Hz"
            )
            raise plan.error(f"sensors[{tag}].clock_hz", rule, plan.clocks[tag].clock_hz)


def _clock_of(source: Source, survey: Survey) -> TagClock:
    """Clock of a tag in the room, as precisely as the survey shows it."""
    error_hz = survey.resolution_hz / _LINE_PRECISION
    return TagClock(source.fundamental_hz, 1e6 * error_hz / source.fundamental_hz)


def room_noise_of_tones(table: ToneTable, room: RoomNoise) -> np.ndarray:
    """Noise (M,) that a room adds to each tone, relative to its white noise."""
    length = table.group_length
    # Autocorrelation of each row: its product with the covariance needs the lags alone.
    spectra = np.fft.fft(table.weights, 2 * length, axis=1)
    correlation = np.fft.ifft(spectra.real**2 + spectra.imag**2, axis=1).real[:, :length]
    excess = 2 * room.autocovariance
    excess[0] = room.autocovariance[0] - 1
    return np.asarray(correlation @ excess / correlation[:, 0])


def _tag_ratios(plan: Plan, survey: Survey) -> tuple[float, ...]:
    """Amplitude of each tag over that of the static path."""
    power = np.maximum(survey.line_power, survey.least_power) / max(survey.static_power, 1e-300)
    amplitudes = [
        harmonics(1, clock.clock_hz * plan.waveform.averaging_s)[0] for clock in plan.clocks
    ]
    return tuple((np.sqrt(power) / amplitudes).tolist())


def _with_band(plan: Plan, survey: Survey) -> Plan:
    """The plan with a clutter band as wide as the motion, where the scene leaves it open."""
    moving_hz = survey.moving_hz()
    stated = plan.require_scene().environment.moving_clutter_hz
    if stated is not None or moving_hz <= plan.clutter_hz:
        return plan
    highest_hz = min(plan.clocks_hz) - 2 * CLUTTER_MARGIN / plan.group_period_s
    for band_hz in (_RESERVE * moving_hz, moving_hz):
        if band_hz >= highest_hz:
            continue
        wider = replace(plan, clutter_hz=band_hz)
        # Groups may be too short to reject so much.
        if wider.separable:
            return wider
    return plan


def surveyed_snapshots(plan: Plan) -> int:
    """Snapshots from the reference on that the room is surveyed in; 0 below 0.1 s."""
    period_s = plan.waveform.snapshot_period_s
    longest = int(min(plan.require_scene().reference_s, LONGEST_S) / period_s)
    if longest < 1:
        return 0
    # A power of two is quicker to transform.
    count = 1 << (longest.bit_length() - 1)
    return count if count * period_s >= SHORTEST_S else 0


def survey_reference(plan: Plan, snapshots: np.ndarray, folded: np.ndarray) -> Survey | None:
    """Survey the room in the longest run without gap of the reference, whose frames are in place.

    ``snapshots`` (n,) rise from 0; ``folded`` (n, 64) may be of a ratio. None below 0.1 s.
    """
    count = surveyed_snapshots(plan)
    whole = (snapshots < count) & np.isfinite(folded).all(axis=1)
    if not whole.all():
        snapshots, folded = snapshots[whole], folded[whole]
    if not len(snapshots):
        return None
    runs = np.split(folded, np.flatnonzero(np.diff(snapshots) > 1) + 1)
    waveform, bins = plan.waveform, plan.waveform.bins
    # NumPy 2 transforms single precision in single precision.
    channel = np.fft.fft(max(runs, key=len).astype(complex))[:, bins]
    channel *= waveform.equalizer()[bins]
    mains_hz = plan.require_scene().environment.possible_mains_hz
    return survey_channel(channel, waveform, plan.clocks, mains_hz)
