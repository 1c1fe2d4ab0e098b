# SPDX-License-Identifier: GPL-3.0-or-later
"""Information lost by reading only some lines of the tags, known before anything is received."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..estimation.clocks.tracked_tag import TagClock
from ..estimation.estimators import estimator_named
from ..scene import Scene
from ..signal.lines import CLUTTER_MARGIN, Tone, centered_times_s, clutter_basis, tag_lines
from ..signal.switching import switch_averages
from ..signal.timed_weights import clutter_at, timed_lines

# Clock phases that are tried, in cycles; they matter only where aliases meet other lines.
_PHASES = (0.1, 0.37, 0.72)
# Each tag's phase lies this part of a cycle (the golden section) after that of the one before.
_PHASE_STEP = 0.618
# Longer groups resolve more, but lose no less; the same band costs less.
_LONGEST = 1250


class Snapshots(NamedTuple):
    """Snapshots of a group: times (n,) from its centre, and orthonormal clutter (n, order)."""

    times_s: np.ndarray
    averaging_s: float
    clutter: np.ndarray

    @classmethod
    def of(
        cls,
        group_length: int,
        period_s: float,
        averaging_s: float,
        clutter_hz: float,
        times_s: np.ndarray | None = None,
    ) -> Snapshots:
        """On a grid of ``period_s``, or at irregular times (n,)."""
        if times_s is None:
            clutter = clutter_basis(group_length, period_s, clutter_hz)
            return cls(centered_times_s(group_length, period_s), averaging_s, clutter)
        basis = clutter_at(times_s, group_length * period_s, clutter_hz)
        return cls(times_s, averaging_s, np.linalg.qr(basis)[0])

    def ends(self, clocks_hz: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Waveforms (T, n, 2S) of clocks (T, S) at phases in cycles, beside clutter."""
        cycles = clocks_hz.T[..., None] * self.times_s + starts.T[..., None]
        half = np.pi * clocks_hz.T * self.averaging_s
        columns = [switch_averages(2 * np.pi * c, h) for c, h in zip(cycles, half, strict=True)]
        return self.beside_clutter(np.concatenate(columns, axis=-1))

    def beside_clutter(self, waveforms: np.ndarray) -> np.ndarray:
        """Waveforms (..., n, M) without what clutter explains."""
        return waveforms - self.clutter @ (self.clutter.T @ waveforms)


def tried_phases(clocks_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Clocks (3, S), and phases in cycles at which they are tried."""
    starts = np.multiply.outer(_PHASES, 1 + np.arange(len(clocks_hz)) * _PHASE_STEP)
    return np.tile(clocks_hz, (len(starts), 1)), starts


def gram(waveforms: np.ndarray) -> np.ndarray:
    """Products (..., M, M) of waveforms (..., n, M)."""
    return np.swapaxes(waveforms, -1, -2) @ waveforms


def variances(products: np.ndarray) -> np.ndarray:
    """Variances (..., M) by least squares, in white noise, of waveforms with these products."""
    # What has no energy left, but for rounding, is refused elsewhere.
    scale = np.sqrt(np.maximum(np.diagonal(products, axis1=-2, axis2=-1), 1e-30))
    alike = products / (scale[..., None] * scale[..., None, :]) + 1e-9 * np.eye(scale.shape[-1])
    return np.asarray(np.diagonal(np.linalg.inv(alike), axis1=-2, axis2=-1) / scale**2)


def losses_db(
    choices: Sequence[int],
    clocks: Sequence[TagClock],
    group_length: int,
    snapshot_period_s: float,
    averaging_s: float,
    clutter_hz: float,
    times_s: np.ndarray | None = None,
) -> dict[int, np.ndarray]:
    """Loss (2S,) in dB of each end from using lines +-1..+-harmonics, for several choices.

    Over least squares of all snapshots on [s1, s2, clutter], the mean over clock phases and signs
    of errors. Choices rise, as far as a group resolves them.
    """
    clocks_hz = [clock.clock_hz for clock in clocks]
    length = group_length if times_s is not None else min(group_length, _LONGEST)
    snapshots = Snapshots.of(length, snapshot_period_s, averaging_s, clutter_hz, times_s)

    def tones(count: int, length: int) -> Sequence[Tone]:
        if times_s is not None:
            period_s = group_length * snapshot_period_s
            return timed_lines(clocks_hz, times_s, period_s, clutter_hz, count)
        return tag_lines(clocks_hz, snapshot_period_s, length, count, clutter_hz)

    waveforms = np.concatenate([_ends_off(clocks, snapshots, sign) for sign in (1, -1)])
    whole = variances(gram(waveforms)).sum(axis=0)
    losses: dict[int, np.ndarray] = {}
    for count in choices:
        if losses and 2 * len(tones(count, group_length)) >= group_length:
            continue
        used = tones(count, len(snapshots.times_s))
        cycles = np.outer(snapshots.times_s, [t.frequency_hz for t in used if t.frequency_hz > 0])
        lines = np.hstack([np.cos(2 * np.pi * cycles), np.sin(2 * np.pi * cycles)])
        lines = np.linalg.qr(snapshots.beside_clutter(lines))[0]
        losses[count] = 10 * np.log10(variances(gram(lines.T @ waveforms)).sum(axis=0) / whole)
    return losses


def end_variances(clocks: Sequence[TagClock], snapshots: Snapshots) -> np.ndarray:
    """Variances (2S,) of ends over the noise in H, summed over phases, beside clutter."""
    return np.asarray(variances(gram(_ends_off(clocks, snapshots))).sum(axis=0))


def _ends_off(clocks: Sequence[TagClock], snapshots: Snapshots, sign: int = 1) -> np.ndarray:
    """Waveforms (3, n, 2S) of clocks at some phases, off by their tolerance in turns."""
    errors = [sign * (-1) ** i * 1e-6 * clock.planned_ppm for i, clock in enumerate(clocks)]
    clocks_hz = np.array([clock.clock_hz for clock in clocks]) * (1 + np.array(errors))
    return snapshots.ends(*tried_phases(clocks_hz))


# Doppler of a person is 12 Hz at 900 MHz and 33 Hz at 2.4 GHz (2 m/s), that of a fan's blades 60 to
# 250 Hz.
BANDS_HZ = (250.0, 200.0, 150.0, 100.0, 60.0, 30.0)
# What rejecting clutter that may not exist may cost: 1.2 % of a standard deviation.
ACCEPTED_COST_DB = 0.1


def automatic_band_hz(
    clocks: Sequence[TagClock], group_length: int, snapshot_period_s: float, averaging_s: float
) -> float:
    """Widest clutter band, at most 250 Hz, that costs every end at most 0.1 dB, or 0."""
    length = min(group_length, _LONGEST)
    resolution_hz = 1 / (length * snapshot_period_s)
    highest_hz = min(clock.clock_hz for clock in clocks) - CLUTTER_MARGIN * resolution_hz

    def variance(band_hz: float) -> np.ndarray:
        snapshots = Snapshots.of(length, snapshot_period_s, averaging_s, band_hz)
        return end_variances(clocks, snapshots)

    still = variance(0.0)
    for band_hz in BANDS_HZ:
        if band_hz < highest_hz:
            cost = np.max(variance(band_hz) / still)
            if 10 * np.log10(cost) <= ACCEPTED_COST_DB:
                return band_hz
    return 0.0


def clutter_band_hz(scene: Scene, clocks: Sequence[TagClock]) -> float:
    """The scene's clutter band in Hz, or one that costs hardly anything where it states none."""
    stated_hz = scene.environment.moving_clutter_hz
    if stated_hz is not None:
        return stated_hz
    # Every sequence that is rejected at irregular times costs a packet's worth of information, so
    # that nothing is rejected before a survey has found something.
    if scene.packets or estimator_named(scene.phase_group.estimator).rectangular:
        return 0.0
    waveform = scene.waveform()
    return automatic_band_hz(
        clocks, scene.phase_group.snapshots, waveform.snapshot_period_s, waveform.averaging_s
    )


# Of the typical group's times; any other seed gives the same expected errors within 0.1 dB.
_SEED = 1


def typical_times_s(scene: Scene) -> np.ndarray:
    """Rising times (N,) of the packets of a typical phase group, from its centre."""
    count, period_s = scene.phase_group.snapshots, scene.group_period_s
    if scene.packets is not None and scene.packets.gaps == "regular":
        return (np.arange(count) + 0.5) * (period_s / count) - period_s / 2
    # Given their number, the times of a Poisson process are uniform.
    return np.sort(np.random.default_rng(_SEED).uniform(-period_s / 2, period_s / 2, count))
