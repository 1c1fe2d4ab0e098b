# SPDX-License-Identifier: GPL-3.0-or-later
"""Phase groups of packets, whose times are their own, and their tones."""

from __future__ import annotations

import numpy as np

from ...signal.timed_weights import TimedTable
from ..groups import Array, Groups
from .packet_channels import DividedPackets, rotation_std_deg

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


def whole_groups(time_s: Array, period_s: float) -> int:
    """Number of whole groups that packets span, by times since the start of the first."""
    return int(time_s[-1] / period_s + _OPEN_END)


class PacketGroups:
    """Packets to groups with their tones; ``time_s`` (n,) from the start of the first group.

    ``untouched`` (K (A - 1),) is the reference without tags: a change of static paths rotates tags,
    of ``hidden`` power over what a combination shows. ``distorted`` leaves tags in the divisor.
    """

    def __init__(
        self,
        table: TimedTable,
        time_s: Array,
        packets: DividedPackets,
        untouched: Array | None = None,
        distorted: bool = False,
        hidden: float = 1.0,
    ) -> None:
        self._untouched, self._distorted, self._hidden = untouched, distorted, hidden
        self._table, self._time_s, self._packets = table, time_s, packets
        self._period_s = table.group_period_s

    def read(self, first: int, stop: int) -> Groups:
        """Groups ``first`` to ``stop``, with ``timed``; those without a packet are left out."""
        bounds = np.searchsorted(self._time_s, np.arange(first, stop + 1) * self._period_s)
        found = [i for i in range(stop - first) if bounds[i + 1] > bounds[i]]
        packets = self._packets
        channel = packets.distorted if self._distorted else packets.combined
        shape = len(found), len(self._table.tones), packets.combined.shape[1]
        tones, timed = np.zeros(shape, complex), np.empty(len(found), object)
        missing, rejected = np.zeros(len(found), np.int64), np.zeros(len(found))
        rotation = np.zeros(len(found))
        for row, i in enumerate(found):
            rows = np.arange(bounds[i], bounds[i + 1])
            times_s = self._time_s[rows] - (first + i + 0.5) * self._period_s
            kept = _inliers(packets, rows)
            rejected[row] = np.mean(~kept)
            timed[row] = self._table.at(times_s[kept], packets.state[rows[kept]])
            if timed[row] is not None:
                tones[row] = timed[row].apply(channel[rows[kept]].astype(complex))
            if self._untouched is not None and kept.any():
                rotation[row] = self._rotation_deg(rows[kept])
            missing[row] = self._missing(times_s[kept])
            if timed[row] is None:
                missing[row] = self._table.group_length
        index = np.array(found, np.int64) + first
        return Groups(
            index, tones, missing, timed=timed, interference=rejected, common_std_deg=rotation
        )

    def _missing(self, times_s: Array) -> int:
        """Packets that a group lacks, where it lacks so many that its reading is flagged."""
        typical, half_s = self._table.group_length, self._period_s / 2
        gaps_s = np.diff(np.concatenate([[-half_s], times_s, [half_s]]))
        lacking = max(typical - len(times_s), 0)
        if gaps_s.max() > _LONGEST_GAP * self._period_s:
            return max(lacking, 1)
        return lacking if lacking > _LACKING_SHARE * typical else 0

    def _rotation_deg(self, rows: Array) -> float:
        """Standard deviation of the rotation of all tags by other static paths, in degrees."""
        static = self._packets.static[rows]
        moved = np.abs(static.mean(axis=0) - self._untouched) ** 2
        noise = static.var(axis=0) / len(rows)
        others = static.shape[1] // self._packets.level.shape[1]
        change = self._hidden * others * max(float(np.mean(moved - noise)), 0.0)
        return float(rotation_std_deg(np.array([change]), others)[0])


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
