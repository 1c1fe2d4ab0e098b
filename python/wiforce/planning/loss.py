# SPDX-License-Identifier: GPL-3.0-or-later
"""Information lost by reading only some lines of the tags, known before anything is received."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..estimation.estimators import estimator_named
from ..scene import Scene
from ..signal.lines import CLUTTER_MARGIN, Tone, centered_times_s, clutter_basis, tag_lines
from ..signal.switching import switch_averages
from ..signal.weights import clutter_at, timed_lines

if TYPE_CHECKING:
    from .plan import Plan

# Clock phases that are tried, in cycles; they matter only where aliases meet other lines.
_PHASES = (0.1, 0.37, 0.72)
# Each tag's phase lies this part of a cycle (the golden section) after that of the one before.
_PHASE_STEP = 0.618
# Longer groups resolve more, but lose no less; the same band costs less.
LONGEST = 1250


class Snapshots(NamedTuple):
    """Snapshots of a group: times (n,) from its centre, and orthonormal clutter (n, order)."""

    times_s: np.ndarray
    averaging_s: float
    clutter: np.ndarray

    @classmethod
    def of(cls, plan: Plan, longest: int | None = None) -> Snapshots:
        """Those of a plan's groups, on a grid at most ``longest``."""
        period_s, length = plan.waveform.snapshot_period_s, plan.group_length
        if plan.times_s is None:
            length = min(length, longest or length)
            times_s = centered_times_s(length, period_s)
            clutter = clutter_basis(length, period_s, plan.clutter_hz)
        else:
            times_s = plan.times_s
            clutter = np.linalg.qr(clutter_at(times_s, length * period_s, plan.clutter_hz))[0]
        return cls(times_s, plan.waveform.averaging_s, clutter)

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


def losses_db(choices: Sequence[int], plan: Plan) -> dict[int, np.ndarray]:
    """Loss (2S,) in dB of each end from using lines +-1..+-harmonics, for several choices.

    Over least squares of all snapshots on [s1, s2, clutter], the mean over clock phases and signs
    of errors. Choices rise, as far as a group resolves them.
    """
    snapshots, period_s = Snapshots.of(plan, LONGEST), plan.waveform.snapshot_period_s

    def tones(count: int, length: int) -> Sequence[Tone]:
        if plan.times_s is not None:
            whole_s = length * period_s
            return timed_lines(plan.clocks_hz, plan.times_s, whole_s, plan.clutter_hz, count)
        return tag_lines(plan.clocks_hz, period_s, length, count, plan.clutter_hz)

    waveforms = np.concatenate([_ends_off(plan, snapshots, sign) for sign in (1, -1)])
    whole = variances(gram(waveforms)).sum(axis=0)
    losses: dict[int, np.ndarray] = {}
    for count in choices:
        if losses and 2 * len(tones(count, plan.group_length)) >= plan.group_length:
            continue
        used = tones(count, len(snapshots.times_s))
        cycles = np.outer(snapshots.times_s, [t.frequency_hz for t in used if t.frequency_hz > 0])
        lines = np.hstack([np.cos(2 * np.pi * cycles), np.sin(2 * np.pi * cycles)])
        lines = np.linalg.qr(snapshots.beside_clutter(lines))[0]
        losses[count] = 10 * np.log10(variances(gram(lines.T @ waveforms)).sum(axis=0) / whole)
    return losses


def end_variances(plan: Plan) -> np.ndarray:
    """Variances (2S,) of ends over the noise in H, summed over phases, beside clutter."""
    waveforms = _ends_off(plan, Snapshots.of(plan, LONGEST))
    return np.asarray(variances(gram(waveforms)).sum(axis=0))


def _ends_off(plan: Plan, snapshots: Snapshots, sign: int = 1) -> np.ndarray:
    """Waveforms (3, n, 2S) of clocks at some phases, off by their tolerance in turns."""
    errors = [sign * (-1) ** i * 1e-6 * clock.planned_ppm for i, clock in enumerate(plan.clocks)]
    return snapshots.ends(*tried_phases(np.array(plan.clocks_hz) * (1 + np.array(errors))))


# Doppler of a person is 12 Hz at 900 MHz and 33 Hz at 2.4 GHz (2 m/s), that of a fan's blades 60 to
# 250 Hz.
BANDS_HZ = (250.0, 200.0, 150.0, 100.0, 60.0, 30.0)
# What rejecting clutter that may not exist may cost: 1.2 % of a standard deviation.
ACCEPTED_COST_DB = 0.1


def clutter_band_hz(plan: Plan) -> float:
    """The clutter band that the scene of a plan states, in Hz.

    Where it states none, the widest, at most 250 Hz, that costs every end at most 0.1 dB, or 0.
    """
    scene = plan.require_scene()
    stated_hz = scene.environment.moving_clutter_hz
    if stated_hz is not None:
        return stated_hz
    # Every sequence that is rejected at irregular times costs a packet's worth of information, so
    # that nothing is rejected before a survey has found something.
    if scene.packets or estimator_named(plan.estimator).rectangular:
        return 0.0
    length_s = min(plan.group_length, LONGEST) * plan.waveform.snapshot_period_s
    highest_hz = min(plan.clocks_hz) - CLUTTER_MARGIN / length_s
    still = end_variances(replace(plan, clutter_hz=0.0))
    for band_hz in BANDS_HZ:
        if band_hz < highest_hz:
            cost = np.max(end_variances(replace(plan, clutter_hz=band_hz)) / still)
            if 10 * np.log10(cost) <= ACCEPTED_COST_DB:
                return band_hz
    return 0.0


# Of the typical group's times; any other seed gives the same expected errors within 0.1 dB.
_SEED = 1


def typical_times_s(scene: Scene) -> np.ndarray | None:
    """Rising times (N,) of the packets of a typical phase group, from its centre, if any."""
    if scene.packets is None:
        return None
    count, period_s = scene.phase_group.snapshots, scene.group_period_s
    if scene.packets.gaps == "regular":
        return (np.arange(count) + 0.5) * (period_s / count) - period_s / 2
    # Given their number, the times of a Poisson process are uniform.
    return np.sort(np.random.default_rng(_SEED).uniform(-period_s / 2, period_s / 2, count))
