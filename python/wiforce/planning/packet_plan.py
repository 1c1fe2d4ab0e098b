# SPDX-License-Identifier: GPL-3.0-or-later
"""The plan of a scene with packets, fitted to the packets that were received."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

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


class PacketPlans:
    """Fits a plan to the times of packets: one for each clutter band that may suit them."""

    def __init__(
        self, plan: Plan, subcarrier_hz: np.ndarray, time_s: np.ndarray, channels: int
    ) -> None:
        scene = plan.require_scene()
        period_s = scene.group_period_s
        groups = int(scene.reference_s / period_s)
        bounds = np.searchsorted(time_s, np.arange(groups + 1) * period_s)
        counts = np.diff(bounds)
        filled = np.flatnonzero(counts >= _FEW * max(counts.mean(), 1))
        order = filled[np.argsort(counts[filled], kind="stable")]
        if not order.size:
            raise InputError("time_s", "must hold packets in reference_s, the untouched reference")
        typical = int(order[len(order) // 2])
        rows = slice(bounds[typical], bounds[typical + 1])
        times_s = time_s[rows] - (typical + 0.5) * period_s
        waveform = packet_waveform(
            period_s / len(times_s), plan.waveform.averaging_s, subcarrier_hz, channels=channels
        )
        changed = replace(plan, waveform=waveform, group_length=len(times_s), times_s=times_s)
        try:
            self._plans = [changed.with_clocks(plan.clocks)]
        except InputError as error:
            if len(times_s) >= _FEW * plan.group_length:
                raise
            rule = (
                f"must hold packets throughout reference_s: a typical group of it has "
                f"{len(times_s)} of the {plan.group_length} of phase_group.snapshots, which do not "
                f"determine the lines of the tags; {bounds[-1]} of {len(time_s)} packets lie in "
                "the reference"
            )
            raise InputError("time_s", rule) from error
        if scene.environment.moving_clutter_hz is None:
            self._plans += _other_bands(self._plans[0])
        looked_at = np.arange(min(changed.reference_groups, _BAND_GROUPS) + 1)
        self._rows = [
            slice(*ends) for ends in pairwise(np.searchsorted(time_s, looked_at * period_s))
        ]
        self._time_s = time_s

    def best(self, packets: DividedPackets) -> Plan:
        """The plan whose clutter band leaves the least noise in the untouched reference."""
        best, *others = self._plans
        if not others:
            return best
        least = self._tone_noise(best, packets)
        for plan in others:
            noise = self._tone_noise(plan, packets)
            if noise < _WORTH_A_BAND * least:
                best, least = plan, noise
        return best

    def _tone_noise(self, plan: Plan, packets: DividedPackets) -> float:
        """Variance of the tones by the residual of some groups of the reference."""
        table = plan.table
        assert isinstance(table, TimedTable)
        found = []
        for group, rows in enumerate(self._rows):
            states = packets.state[rows]
            kept = states >= 0
            times_s = self._time_s[rows][kept] - (group + 0.5) * table.group_period_s
            noise = table.tone_noise(times_s, packets.combined[rows][kept], states[kept])
            if noise is not None:
                found.append(noise)
        return float(np.median(found)) if found else np.inf


def _other_bands(plan: Plan) -> list[Plan]:
    """Plans with other clutter bands, each wider than the one before."""
    found: list[Plan] = []
    for band_hz in _BANDS_HZ:
        trial = replace(plan, clutter_hz=band_hz)
        if band_hz > _HIGHEST_BAND * min(plan.clocks_hz) or not trial.separable:
            break
        found.append(trial)
    return found


def solved_tags(
    plan: Plan,
    source: PacketGroups,
    packets: DividedPackets,
    time_s: np.ndarray,
    groups: int,
    response: Callable[[np.ndarray], np.ndarray],
    precision: np.ndarray | None,
    hidden: float,
) -> SolvedTags:
    """The tags in packets of a fitted plan, and their part in what these are divided by."""
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
        precision,
        hidden,
    )
