# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of channel snapshots to readings, by a plan that is fitted to the packets received."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..estimation.ends.separation import EndSeparator
from ..estimation.groups import Array, Groups
from ..estimation.packets.antenna_states import LEAST_STEP, AntennaStates
from ..estimation.packets.packet_channels import (
    AntennaCombination,
    DividedPackets,
    PacketChannels,
    TagParts,
    rotation_std_deg,
    shared_noise,
    undivided,
)
from ..estimation.packets.tag_parts import solve_tags
from ..io.capture.channel_snapshots import ChannelSnapshots
from ..io.readings import Reading
from ..planning.plan import Plan, PlanOrScene, as_plan
from ..signal.waveform import packet_waveform
from ..signal.weights import TimedTable
from .receiver import Receiver, one_thread
from .recording_reader import CaptureReader

# A packet is left out whose channel deviates from the median by this many times the power that one
# packet in ten exceeds. Switches are closed in half of the packets, so that one in ten shows a tag
# of any strength; a second tag, or a press, raises its power by a factor of 6 at most.
_OUTLIER, _LARGE_QUANTILE = 10.0, 0.9
# A group is flagged as one with a gap when it lacks this share of the packets of a typical group,
# or when none came for this share of its time. Exponential gaps exceed 1 % of a group of 500
# packets now and then, 10 % never.
_LACKING_SHARE = 0.5
_LONGEST_GAP = 0.25
# The last group is read although its last packets are absent, up to this part of it: packets do not
# end exactly with a group.
_OPEN_END = 0.05


class PacketGroups:
    """Packets to groups with their tones.

    ``untouched`` (K (A - 1),) is the reference without tags: a change of static paths rotates tags,
    of ``hidden`` power over what a combination shows.
    """

    def __init__(
        self,
        table: TimedTable,
        packets: DividedPackets,
        untouched: Array | None = None,
        hidden: float = 1.0,
    ) -> None:
        self._untouched, self._hidden = untouched, hidden
        self._table, self._packets = table, packets

    def read(self, first: int, stop: int) -> Groups:
        """Groups ``first`` to ``stop``, with ``timed``; those without a packet are left out."""
        packets = self._packets
        groups = packets.groups(first, stop, self._table.group_period_s)
        found = [i for i, (rows, _) in enumerate(groups) if len(rows)]
        shape = len(found), len(self._table.tones), packets.combined.shape[1]
        tones, timed = np.zeros(shape, complex), np.empty(len(found), object)
        missing, rejected = np.zeros(len(found), np.int64), np.zeros(len(found))
        rotation = np.zeros(len(found))
        for row, i in enumerate(found):
            rows, times_s = groups[i]
            kept = _inliers(packets, rows)
            rejected[row] = np.mean(~kept)
            rows, times_s = rows[kept], times_s[kept]
            timed[row] = self._table.at(times_s, packets.state[rows])
            if timed[row] is None:
                missing[row] = self._table.group_length
            else:
                tones[row] = timed[row].apply(packets.combined[rows].astype(complex))
                missing[row] = self._missing(times_s)
            if self._untouched is not None and len(rows):
                rotation[row] = self._rotation_deg(rows)
        index = np.array(found, np.int64) + first
        return Groups(
            index, tones, missing, timed=timed, interference=rejected, common_std_deg=rotation
        )

    def _missing(self, times_s: Array) -> int:
        """Packets that a group lacks, where it lacks so many that its reading is flagged."""
        typical, period_s = self._table.group_length, self._table.group_period_s
        gaps_s = np.diff(np.concatenate([[-period_s / 2], times_s, [period_s / 2]]))
        lacking = max(typical - len(times_s), 0)
        if gaps_s.max() > _LONGEST_GAP * period_s:
            return max(lacking, 1)
        return lacking if lacking > _LACKING_SHARE * typical else 0

    def _rotation_deg(self, rows: Array) -> float:
        """Standard deviation of the rotation of all tags by other static paths, in degrees."""
        static = self._packets.static[rows]
        moved = np.abs(static.mean(axis=0) - self._untouched) ** 2
        noise = static.var(axis=0) / len(rows)
        others = static.shape[1] // self._packets.level.shape[1]
        change = self._hidden * others * max(float(np.mean(moved - noise)), 0.0)
        return rotation_std_deg(change, others)


def _inliers(packets: DividedPackets, rows: Array) -> Array:
    """Packets that do not deviate from the others; ndarray of bool, shape (n,)."""
    own = packets.state[rows] >= 0
    if not own.any():
        return own
    static = packets.static[rows].astype(complex)
    center = np.median(static[own].real, axis=0) + 1j * np.median(static[own].imag, axis=0)
    power = np.mean(np.abs(static - center) ** 2, axis=1)
    large = float(np.quantile(power[own], _LARGE_QUANTILE))
    inliers: Array = power <= _OUTLIER * max(large, 1e-300)
    return inliers & own


# Rounds in which packets are divided and tags are solved for, at most, and the change of the tags'
# part, against what is unknown of it, at which they end: it then adds 5 % to that.
_MOST_ROUNDS, _SETTLED = 6, 0.3
# Groups that are separated, or passed to the receiver, at once.
_BATCH = 16
# A mean interval that differs from the scene's by this factor is a mistake: losses of the packets
# that the scene expects change it by less.
_OTHER_INTERVAL = 2.0
# Clutter bands that are tried, how far they may come to a clock, and by which factor a band must
# reduce the noise: 0.1 dB.
_BANDS_HZ = (2.0, 5.0, 10.0, 20.0, 40.0, 60.0)
_HIGHEST_BAND, _WORTH_A_BAND = 0.8, 0.977
# Groups of the reference that are looked at for each band.
_BAND_GROUPS = 6
# Groups with fewer packets than this share of the mean are no typical ones.
_FEW = 0.5


class SnapshotReader(CaptureReader):
    """Reads channel snapshots, with a plan that is fitted to their times.

    Refuses a file that contradicts the scene, or is shorter than the reference and one group.
    """

    def __init__(
        self, recording: ChannelSnapshots, plan: PlanOrScene, tracked: bool = False
    ) -> None:
        plan = as_plan(plan)
        _check(recording, plan)
        self._recording = recording
        self._one_thread = one_thread()
        time_s = recording.time_s - recording.time_s[0]
        groups = int(time_s[-1] / plan.group_period_s + _OPEN_END)
        super().__init__(recording.path, plan, groups)
        free = plan.require_scene().environment.reader_clock == "free"
        self._plans: list[Plan] = []  # one for each clutter band that may suit the packets
        self.notes = [*recording.notes]
        with self._one_thread():
            if free:
                self._read_antennas(plan, time_s)
            else:
                packets = undivided(recording.channel, time_s)
                self.plan = self._fitted(plan, packets)
                self.source = PacketGroups(_table_of(self.plan), packets)
        if interval := self._interval_note(self.plan):
            self.notes.insert(0, interval)
        self.receiver = Receiver(self.plan, tracked, derotated=False)

    def _read_antennas(self, plan: Plan, time_s: Array) -> None:
        """Divide by the oscillator and the receiver chains, and solve for the tags in that."""
        recording, scene = self._recording, plan.require_scene()
        untouched = time_s < scene.reference_s
        hertz = recording.subcarrier_hz

        def solve(channels: PacketChannels, former: _Round | None, weighted: bool) -> _Round:
            parts = former.tags if former else None
            packets = channels.divide(parts)
            fitted = self._fitted(plan, packets)
            table, combination = _table_of(fitted), channels.combination
            mean = packets.static[untouched & (packets.state >= 0)].mean(axis=0)
            distorted = PacketGroups(table, replace(packets, combined=packets.distorted), mean)
            precision = None
            if weighted:
                known = parts.known if parts else np.zeros(len(time_s), bool)
                _, precision = shared_noise(packets, combination.shared, known, table)
            separator = EndSeparator(table, fitted.clocks, fitted.waveform, derotated=False)
            separated = [
                separator.process(distorted.read(first, min(first + _BATCH, self.groups)))
                for first in range(0, self.groups, _BATCH)
            ]
            tags = solve_tags(
                Groups.concatenate([*separated, separator.flush()]),
                packets,
                table,
                fitted.clocks,
                fitted.waveform.averaging_s,
                fitted.reference_groups,
                combination,
                precision,
            )
            change, least = tags.change_since(parts), tags.uncertain
            if former and len(former.least) == len(least):
                least = tuple(map(min, least, former.least))
            states = channels.states
            return _Round(fitted, packets, mean, tags, change, least, states, combination)

        def settle(weighted: bool) -> _Round:
            channels, finer = copy(coarse), copy(fine)
            first = solve(channels, None, weighted)
            now = solve(channels, first, weighted)
            if finer.states.count > first.states.count:
                other = solve(finer, None, weighted)
                if other.tags.snr > first.tags.snr:
                    other = solve(finer, other, weighted)
                    if other.tags.snr > now.tags.snr:
                        channels, now = finer, other
            rounds = [now]
            while len(rounds) < _MOST_ROUNDS and not now.settled and now.tags.snr:
                now = solve(channels, now, weighted)
                rounds.append(now)
            return max(rounds, key=lambda each: (each.settled, each.tags.snr))

        # Gain steps of the antennas hide a weak tag, and a strong one looks like steps. What shows
        # the tags best is followed, once they are known.
        card = recording.channel, time_s, untouched, hertz, plan.group_period_s
        coarse, fine = PacketChannels(*card), PacketChannels(*card, LEAST_STEP)
        # Noise that subcarriers share is measured well only where tags are known. A wrong weight
        # leads to another solution, which knows less of the tags, or to none.
        found = [settle(False)]
        if found[0].tags.snr and found[0].combination.shared.shape[1]:
            found.append(settle(True))
        now = max(found, key=lambda each: (bool(each.tags.snr), each.settled, -each.uncertain))
        self.notes += now.states.notes
        if (kept_db := now.combination.kept_db) < 0:
            self.notes.append(
                f"one antenna leaves {kept_db:.1f} dB of the tags beside the phases of the "
                "packets; `gr-wiforce check` states the error to expect, and two antennas on one "
                "oscillator lose nothing"
            )
        table = _table_of(now.plan)
        whiten, _ = shared_noise(now.packets, now.combination.shared, now.tags.known, table)
        combined = now.packets.combined @ whiten.astype(now.packets.combined.dtype)
        packets = replace(now.packets, combined=combined)
        self.source = PacketGroups(table, packets, now.untouched, now.combination.hidden)
        self.plan = now.plan.stating(tag_ratios=now.ratios)

    def _fitted(self, plan: Plan, packets: DividedPackets) -> Plan:
        try:
            if not self._plans:
                self._plans = _packet_plans(plan, self._recording.subcarrier_hz, packets)
            return _best_plan(self._plans, packets)
        except InputError as error:
            # Times in another unit leave groups nearly empty, which the rule of the plan hides.
            note = self._interval_note(plan)
            if note:
                raise InputError(self._recording.path, note) from error
            raise

    def _interval_note(self, plan: Plan) -> str:
        """What is wrong with the interval of the packets; empty if it is that of the scene."""
        packets, recording = plan.require_scene().packets, self._recording
        assert packets is not None  # as _check requires
        mean_s = recording.received_s / (len(recording.time_s) - 1)
        if max(mean_s / packets.interval_s, packets.interval_s / mean_s) <= _OTHER_INTERVAL:
            return ""
        count = plan.group_period_s / mean_s
        return (
            f"packets come every {mean_s:.3g} s on average, but packets.interval_s is "
            f"{packets.interval_s:g}: a phase group holds {count:.3g} packets; correct the "
            "scene, or the times, which are in seconds"
        )

    def __iter__(self) -> Iterator[list[Reading]]:
        for first in range(0, self.groups, _BATCH):
            with self._one_thread():
                groups = self.source.read(first, min(first + _BATCH, self.groups))
            if len(groups):
                yield self.receiver.process(groups)
        yield self.receiver.finish(self.groups)


def _table_of(plan: Plan) -> TimedTable:
    assert isinstance(plan.table, TimedTable)  # as _check requires packets
    return plan.table


def _packet_plans(plan: Plan, subcarrier_hz: Array, packets: DividedPackets) -> list[Plan]:
    """Plans for the times of packets, by a typical group: one for each clutter band."""
    scene, time_s = plan.require_scene(), packets.time_s
    period_s = scene.group_period_s
    groups = packets.groups(0, int(scene.reference_s / period_s), period_s)
    counts = np.array([len(rows) for rows, _ in groups])
    filled = np.flatnonzero(counts >= _FEW * max(counts.mean(), 1))
    order = filled[np.argsort(counts[filled], kind="stable")]
    if not order.size:
        raise InputError("time_s", "must hold packets in reference_s, the untouched reference")
    _, times_s = groups[order[len(order) // 2]]
    waveform = packet_waveform(
        period_s / len(times_s),
        plan.waveform.averaging_s,
        subcarrier_hz,
        channels=packets.combined.shape[1] // len(subcarrier_hz),
    )
    changed = replace(plan, waveform=waveform, group_length=len(times_s), times_s=times_s)
    try:
        fitted = changed.with_clocks(plan.clocks)
    except InputError as error:
        if len(times_s) >= _FEW * plan.group_length:
            raise
        rule = (
            f"must hold packets throughout reference_s: a typical group of it has "
            f"{len(times_s)} of the {plan.group_length} of phase_group.snapshots, which do not "
            f"determine the lines of the tags; {counts.sum()} of {len(time_s)} packets lie in "
            "the reference"
        )
        raise InputError("time_s", rule) from error
    stated = scene.environment.moving_clutter_hz is not None
    return [fitted] if stated else [fitted, *_other_bands(fitted)]


def _best_plan(plans: list[Plan], packets: DividedPackets) -> Plan:
    """The plan whose clutter band leaves the least noise in the untouched reference."""
    best, *others = plans
    least = _tone_noise(best, packets) if others else 0.0
    for plan in others:
        noise = _tone_noise(plan, packets)
        if noise < _WORTH_A_BAND * least:
            best, least = plan, noise
    return best


def _tone_noise(plan: Plan, packets: DividedPackets) -> float:
    """Variance of the tones by the residual of some groups of the reference."""
    table, found = _table_of(plan), []
    looked_at = min(plan.reference_groups, _BAND_GROUPS)
    for rows, times_s in packets.groups(0, looked_at, table.group_period_s):
        own = packets.state[rows] >= 0
        noise = table.tone_noise(
            times_s[own], packets.combined[rows[own]], packets.state[rows[own]]
        )
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


@dataclass(frozen=True, eq=False)
class _Round:
    """Packets as they were divided in a round, and the tags in them."""

    plan: Plan
    packets: DividedPackets
    untouched: Array
    tags: TagParts
    change: tuple[float, ...]  # of the tags' part since the round before
    least: tuple[float, ...]  # uncertainty of any round so far: one that knows less is not settled
    states: AntennaStates
    combination: AntennaCombination

    @property
    def ratios(self) -> tuple[float, ...]:
        """What is unknown of the tags' parts along the static paths."""
        found: list[float] = np.hypot(self.tags.uncertain, self.change).tolist()
        return tuple(found)

    @property
    def uncertain(self) -> float:
        """The largest of them."""
        return max(self.ratios, default=np.inf)

    @property
    def settled(self) -> bool:
        """Whether another round would change nothing."""
        pairs = zip(self.change, self.least, strict=True)
        return all(c <= _SETTLED * u for c, u in pairs)


def _check(recording: ChannelSnapshots, plan: Plan) -> None:
    scene = plan.require_scene()
    if scene.packets is None:
        rule = "holds channel snapshots, but the scene describes samples: it needs 'packets:'"
        raise InputError(recording.path, rule)
    stated, carrier_hz = scene.radio.center_frequency_hz, recording.center_frequency_hz
    if carrier_hz is not None and abs(carrier_hz - stated) > 1.0:
        rule = f"center_frequency_hz must be that of the scene ({stated:.9g})"
        raise InputError(recording.path, rule, carrier_hz)
