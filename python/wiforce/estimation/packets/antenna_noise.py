# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise of a card's antennas against each other, which all subcarriers share."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...signal.lines import Tone, with_mirrors
from ...signal.switching import harmonics
from ...signal.timed_weights import TimedTable
from ..groups import Array
from .packet_channels import DividedPackets

# Frequencies beside a tone, in resolutions of a group, at which a tag has nothing.
_BESIDE = (-2, -1, 1, 2)
# Values by which noise is measured: their number gives its power to 1 / sqrt(4096), 1.6 %.
_VALUES = 4096


@dataclass(frozen=True, eq=False)
class SharedNoise:
    """Noise of combinations (C,), of which they share a part.

    ``whiten`` (C, C) transforms them, as row vectors, to ones whose noise is independent;
    ``precision`` (C, C) is the inverse of its covariance.
    """

    whiten: Array
    precision: Array

    def removed(self, packets: DividedPackets) -> DividedPackets:
        """Packets whose combinations have independent noise, as weights by subcarrier presume."""
        combined = packets.combined @ self.whiten.astype(packets.combined.dtype)
        return replace(packets, combined=combined)


def shared_noise(
    packets: DividedPackets, shared: Array, known: Array, time_s: Array, table: TimedTable
) -> SharedNoise:
    """Noise of the packets' combinations at the tags' lines.

    ``shared`` (C, A - 1) is by how much the combinations change with each antenna but one, on all
    subcarriers at once; ``known`` (n,) are packets from which tags are removed completely. Gain and
    phase of an antenna wander between the packets, in an Intel AX200 by 0.5 degrees rms, mostly
    below 300 Hz: at a tag's lines, they are stronger than the noise of all subcarriers by 15 dB.
    Noise of covariance D + B P B^H, with D of the subcarriers and B the directions that are shared,
    is transformed to one of covariance D. Both are measured beside the tones.
    """
    parts = _beside_tones(packets.static, packets.state, known, time_s, table)
    each = np.eye(len(shared))
    if not parts:
        return SharedNoise(each, each)
    noise = np.concatenate(parts)
    own = np.maximum(np.mean(np.abs(noise) ** 2, axis=0), 1e-300)
    if not shared.shape[1]:
        return SharedNoise(each, each / own)
    for _ in range(2):
        level = np.sqrt(own)
        white, basis = noise / level, np.linalg.qr(shared / level[:, None])[0]
        along = white @ basis.conj()
        rest = white - along @ basis.T
        kept = 1 - np.sum(np.abs(basis) ** 2, axis=1)
        own = own * np.mean(np.abs(rest) ** 2, axis=0) / np.maximum(kept, 1e-3)
    # A press that changes inside a group, or a step of the room, is no noise of the others.
    count = np.array([len(each) for each in parts])
    group = np.repeat(np.arange(len(parts)), count)
    size = np.sqrt(np.bincount(group, np.sum(np.abs(along) ** 2, axis=1)) / count)
    along /= np.maximum(size / np.maximum(np.median(size), 1e-300), 1)[group, None]
    powers, vectors = np.linalg.eigh(along.T @ along.conj() / len(along))
    # What independent noise leaves along them is no reason to weigh them less.
    factors = 1 / np.sqrt(np.maximum(powers, 1))
    turned = basis @ vectors
    across = (turned.conj() * (1 - factors)) @ turned.T
    whiten = each - level[:, None] ** -1 * across * level
    return SharedNoise(whiten, (whiten / own) @ whiten.conj().T)


def _beside_tones(
    static: Array, state: Array, known: Array, time_s: Array, table: TimedTable
) -> list[Array]:
    """Noise (N, C) of groups beside the tones, by a tag's power in each, of packets (n, C)."""
    period_s = table.group_period_s
    bounds = np.searchsorted(time_s, np.arange(0, time_s[-1] + period_s, period_s))
    whole = [(a, b) for a, b in zip(bounds[:-1], bounds[1:], strict=True) if b > a]
    chosen = [(a, b) for a, b in whole if known[a:b].all()] or whole
    lines = [tone for tone in table.tones if tone.frequency_hz > 0]
    power = np.array([_power(tone) for tone in lines])
    power = np.concatenate([power[::-1], power]) / power.sum()
    found = []
    each = len(_BESIDE) * len(power)
    for first, last in chosen[:: -(-len(chosen) * each // _VALUES)]:
        rows = np.arange(first, last)[state[first:last] >= 0]
        center_s = (time_s[first] // period_s + 0.5) * period_s
        own = []
        for steps in _BESIDE:
            beside = [t._replace(frequency_hz=t.frequency_hz + steps / period_s) for t in lines]
            # What is left of a tag, of which little is known while it is weak, is no noise.
            tones = with_mirrors([*beside, *lines])
            weights = replace(table, tones=tones).at(time_s[rows] - center_s, state[rows])
            if weights is not None:
                middle = slice(len(lines), 3 * len(lines))
                noise = weights.apply(static[rows].astype(complex))[middle]
                own.append(np.sqrt(power * len(rows))[:, None] * noise)
        if own:
            found.append(np.concatenate(own))
    return found


def _power(tone: Tone) -> float:
    return float(sum(np.sum(harmonics(abs(line)) ** 2) for _, line in tone.owners))
