# SPDX-License-Identifier: GPL-3.0-or-later
"""Steps of the receiver: which ones a scene needs, why, and what each costs."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..signal.lines import clutter_order
from .plan import Plan

# Real operations of one complex multiplication and addition.
_MULTIPLY_ADD = 8
# Real operations of one inversion: two Taylor expansions, covariance, checks.
_INVERSION = 200


@dataclass(frozen=True)
class Step:
    name: str  # the stage, or a part of its work
    needed: bool  # False for a step that this scene skips
    reason: str
    operations: float  # real additions and multiplications per second of signal, spent or saved


def steps(plan: Plan) -> tuple[Step, ...]:
    """The steps of a plan, in the order of the signal path."""
    per_snapshot = _snapshot_steps if plan.times_s is None else _packet_steps
    return (*per_snapshot(plan), *_group_steps(plan))


def _packet_steps(plan: Plan) -> Iterator[Step]:
    """Steps that run per packet, and per group what its own times make necessary."""
    antennas, rate = plan.require_scene().environment.receive_antennas, _rate(plan)
    channels, columns = len(plan.waveform.bins), len(plan.table.tones) + _clutter_order(plan)
    reason = f"{antennas} antenna(s) to {channels} channels without the oscillator's phase and gain"
    yield Step("antennas", antennas > 1, reason, 2 * _MULTIPLY_ADD * channels * antennas * rate)
    # QR of tones and clutter in real numbers, 2 n m^2, and its triangular solution.
    reason = f"solved for each group at the times of its packets: {columns} columns"
    solution = 4 * plan.group_length * columns**2 / plan.group_period_s
    yield Step("weights", True, reason, solution)
    yield _tones(plan, channels)


def _snapshot_steps(plan: Plan) -> Iterator[Step]:
    """Steps that run per snapshot: 17 000 times per second and more."""
    waveform, rate, length = plan.waveform, _rate(plan), plan.waveform.symbol_length
    repetitions, folded = waveform.repetitions, waveform.repetitions * length
    reason = f"{repetitions} repetitions of a symbol are added: {folded} samples become {length}"
    yield Step("fold", True, reason, 2 * (folded - length) * rate)
    skipped = waveform.frame_length - folded
    reason = f"{skipped} of {waveform.frame_length} samples are not averaged"
    yield Step("guard and first repetition", False, reason, 2 * skipped * rate)
    tones = len(plan.table.tones)
    estimator = (_transform_operations(length) + 12 * length) * tones / plan.group_period_s
    each = (_transform_operations(length) + 6 * length) * rate
    reason = "fold, tones and channel estimate are linear and commute: the FFT runs per tone and "
    yield Step("channel per snapshot", False, reason + "group", each - estimator)
    yield _tones(plan, length)
    reason = "derotation, FFT and division per tone"
    yield Step("channel", True, reason, estimator)


def _tones(plan: Plan, values: int) -> Step:
    """The sums of snapshots of so many values to tones, of which a pair shares its products."""
    tones, tags = len(plan.table.tones), len(plan.clocks) + len(plan.others)
    reason = f"{tones} tones hold lines +-1..+-{plan.harmonics} of {tags} tag(s)"
    if plan.loss_db:
        reason += f", within {max(plan.loss_db):.2f} dB of all lines"
    if plan.clutter_hz == 0:
        reason += "; nothing moves: the weights reject the mean only"
    else:
        order = _clutter_order(plan)
        reason += f"; the weights reject {order} sequences up to {plan.clutter_hz:g} Hz"
    return Step("tones", True, reason, _MULTIPLY_ADD * values / 2 * _rate(plan) * tones)


def _group_steps(plan: Plan) -> Iterator[Step]:
    """Steps that run per phase group: tens of times per second."""
    scene, rate = plan.require_scene(), 1 / plan.group_period_s
    tags, tones = len(plan.clocks) + len(plan.others), len(plan.table.tones)
    ends, subcarriers = 2 * tags, len(plan.waveform.bins)
    reason = f"{tags} clock(s) tracked; mixing matrix of {tones} x {ends} per group"
    mixing = 4 * tones * plan.group_length * ends
    solution = _MULTIPLY_ADD * subcarriers * tones * (tones + 3 * ends)
    yield Step("separation", True, reason, rate * (mixing + solution))
    products = rate * _MULTIPLY_ADD * ends * subcarriers
    reason = f"against {plan.reference_groups} untouched groups ({scene.reference_s:g} s)"
    yield Step("reference", True, reason, products)
    yield Step("average", True, f"{subcarriers} subcarriers, weighted by their noise", products)
    off = any(np.any(sensor.off_reflection) for sensor in scene.sensors)
    inversion = rate * _INVERSION * len(plan.clocks)
    reason = "phases to force and location" + ("; corrected for the off state" if off else "")
    yield Step("readout", True, reason, inversion)
    yield Step("inversion while untouched", False, "force and location are not defined", inversion)


def _rate(plan: Plan) -> float:
    return 1 / plan.waveform.snapshot_period_s


def _clutter_order(plan: Plan) -> int:
    return clutter_order(plan.group_length, plan.waveform.snapshot_period_s, plan.clutter_hz)


def _transform_operations(length: int) -> float:
    """Real operations of a Fourier transform, 5 n log2 n."""
    return float(5 * length * np.log2(length))
