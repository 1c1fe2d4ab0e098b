# SPDX-License-Identifier: GPL-3.0-or-later
"""The plan of a scene with packets, fitted to the packets that were received."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..estimation.ends.separation import EndSeparator
from ..estimation.groups import Groups
from ..estimation.packets.packet_channels import DividedPackets
from ..estimation.packets.packet_groups import PacketGroups
from ..estimation.packets.tag_parts import SolvedTags, solve_tags
from ..signal.timed_weights import TimedTable
from ..signal.waveform import packet_waveform
from .plan import Plan

# Clutter bands that are tried, how far they may come to a clock, and by which factor a band must
# reduce the noise: 0.1 dB.
_BANDS_HZ = (2.0, 5.0, 10.0, 20.0, 40.0, 60.0)
_HIGHEST_BAND, _WORTH_A_BAND = 0.8, 0.977
# Groups of the reference that are looked at for each band, and groups that are separated at once.
_BAND_GROUPS, _BATCH = 6, 16
# Groups with fewer packets than this share of the mean are no typical ones.
_FEW = 0.5


def fitted_plan(
    plan: Plan, subcarrier_hz: np.ndarray, time_s: np.ndarray, packets: DividedPackets
) -> Plan:
    """Fit a plan to the times (n,) and channels of packets without an oscillator's phase.

    It is designed for the group of the untouched reference with the median number of packets, and
    refused when the reference holds too few packets to read the tags.
    """
    scene = plan.require_scene()
    period_s = scene.group_period_s
    groups = int(scene.reference_s / period_s)
    bounds = np.searchsorted(time_s, np.arange(groups + 1) * period_s)
    counts = np.diff(bounds)
    usual = np.flatnonzero(counts >= _FEW * max(counts.mean(), 1))
    order = usual[np.argsort(counts[usual], kind="stable")]
    if not order.size:
        raise InputError("time_s", "must hold packets in reference_s, the untouched reference")
    typical = int(order[len(order) // 2])
    rows = slice(bounds[typical], bounds[typical + 1])
    times_s = time_s[rows] - (typical + 0.5) * period_s
    waveform = packet_waveform(
        period_s / len(times_s),
        plan.waveform.averaging_s,
        subcarrier_hz,
        channels=packets.combined.shape[1] // len(subcarrier_hz),
    )
    changed = replace(plan, waveform=waveform, group_length=len(times_s), times_s=times_s)
    changed = changed.with_clocks(plan.clocks)
    if scene.environment.moving_clutter_hz is not None:
        return changed
    return _with_band(changed, time_s, packets)


def solved_tags(
    plan: Plan,
    source: PacketGroups,
    packets: DividedPackets,
    time_s: np.ndarray,
    groups: int,
    response: Callable[[np.ndarray], np.ndarray],
    hidden: float,
) -> SolvedTags:
    """The tags in packets, and their part in what packets are divided by (:func:`.solve_tags`).

    ``plan`` is fitted to the packets; ``source`` has their groups, in units of the static paths.
    """
    table = plan.table
    assert isinstance(table, TimedTable)
    separator = EndSeparator(table, plan.clocks, plan.waveform, derotated=False)
    separated = [
        separator.process(source.read(first, min(first + _BATCH, groups)))
        for first in range(0, groups, _BATCH)
    ]
    return solve_tags(
        Groups.concatenate([*separated, separator.flush()]),
        packets,
        time_s,
        table,
        plan.clocks,
        plan.waveform.averaging_s,
        plan.reference_groups,
        response,
        hidden,
    )


def _with_band(plan: Plan, time_s: np.ndarray, packets: DividedPackets) -> Plan:
    """The plan with the clutter band that leaves the least noise in the untouched reference."""
    best, least = plan, _tone_noise(plan, time_s, packets)
    for band_hz in _BANDS_HZ:
        if band_hz > _HIGHEST_BAND * min(plan.clocks_hz):
            break
        trial = replace(plan, clutter_hz=band_hz)
        if not trial.separable:
            break
        noise = _tone_noise(trial, time_s, packets)
        if noise < _WORTH_A_BAND * least:
            best, least = trial, noise
    return best


def _tone_noise(plan: Plan, time_s: np.ndarray, packets: DividedPackets) -> float:
    """Variance of the tones by the residual of some groups of the reference."""
    table = plan.table
    assert isinstance(table, TimedTable)
    found = []
    for group in range(min(plan.reference_groups, _BAND_GROUPS)):
        bounds = np.searchsorted(time_s, np.array([group, group + 1]) * table.group_period_s)
        rows = np.arange(*bounds)
        rows = rows[packets.state[rows] >= 0]
        times_s = time_s[rows] - (group + 0.5) * table.group_period_s
        states = packets.state[rows]
        weights = table.at(times_s, states)
        if weights is not None:
            gain = np.mean(np.sum(np.abs(weights.weights) ** 2, axis=1))
            found.append(gain * table.residual(times_s, packets.combined[rows], states))
    return float(np.median(found)) if found else np.inf
