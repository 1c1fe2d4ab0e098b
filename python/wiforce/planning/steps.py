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
    """A step of the receiver."""

    name: str  # the stage, or a part of its work
    needed: bool  # False for a step that this scene skips
    reason: str
    operations: float  # real additions and multiplications per second of signal, spent or saved


def steps(plan: Plan) -> tuple[Step, ...]:
    """The steps of a plan, in the order of the signal path."""
    if plan.times_s is not None:
        return (*_packet_steps(plan), *list(_group_steps(plan))[1:])
    return (*_snapshot_steps(plan), *_group_steps(plan))


def _packet_steps(plan: Plan) -> Iterator[Step]:
    """Steps that run per packet, and per group what its own times make necessary."""
    scene, rate = plan.require_scene(), 1 / plan.waveform.snapshot_period_s
    antennas, channels = scene.environment.receive_antennas, len(plan.waveform.bins)
    tones, length = len(plan.table.tones), plan.group_length
    yield Step(
        "antennas",
        antennas > 1,
        f"{antennas} antenna(s) to {channels} channels without the oscillator's phase and gain",
        2 * _MULTIPLY_ADD * channels * antennas * rate,
    )
    # QR of tones and clutter in real numbers, 2 n m^2, and its triangular solution.
    order = clutter_order(length, plan.waveform.snapshot_period_s, plan.clutter_hz)
    columns = tones + order
    yield Step(
        "weights",
        True,
        f"solved for each group at the times of its packets: {columns} columns",
        4 * length * columns**2 / plan.group_period_s,
    )
    yield Step("tones", True, _tones_reason(plan), _MULTIPLY_ADD * channels / 2 * rate * tones)


def _snapshot_steps(plan: Plan) -> Iterator[Step]:
    """Steps that run per snapshot: 17 000 times per second and more."""
    waveform, tones = plan.waveform, len(plan.table.tones)
    rate = 1 / waveform.snapshot_period_s
    length = waveform.symbol_length
    folded = waveform.repetitions * length
    skipped = waveform.frame_length - folded
    yield Step(
        "fold",
        True,
        f"{waveform.repetitions} repetitions of a symbol are added: {folded} samples become "
        f"{length}",
        2 * (folded - length) * rate,
    )
    yield Step(
        "guard and first repetition",
        False,
        f"{skipped} of {waveform.frame_length} samples are not averaged",
        2 * skipped * rate,
    )
    yield Step(
        "channel per snapshot",
        False,
        "fold, tones and channel estimate are linear and commute: the FFT runs per tone and group",
        (_transform_operations(length) + 6 * length) * rate - _estimator_operations(plan),
    )
    # The two tones of a pair share their products.
    yield Step("tones", True, _tones_reason(plan), _MULTIPLY_ADD * length / 2 * rate * tones)


def _tones_reason(plan: Plan) -> str:
    tags = len(plan.clocks) + len(plan.others)
    lines = f"lines +-1..+-{plan.harmonics} of {tags} tag(s)"
    reason = f"{len(plan.table.tones)} tones hold {lines}"
    if plan.loss_db:
        reason += f", within {max(plan.loss_db):.2f} dB of all lines"
    if plan.clutter_hz == 0:
        return reason + "; nothing moves: the weights reject the mean only"
    order = clutter_order(plan.group_length, plan.waveform.snapshot_period_s, plan.clutter_hz)
    return reason + f"; the weights reject {order} sequences up to {plan.clutter_hz:g} Hz"


def _group_steps(plan: Plan) -> Iterator[Step]:
    """Steps that run per phase group: tens of times per second."""
    scene, rate = plan.require_scene(), 1 / plan.group_period_s
    tags = len(plan.clocks) + len(plan.others)
    tones, ends = len(plan.table.tones), 2 * tags
    subcarriers = len(plan.waveform.bins)
    yield Step(
        "channel", True, "derotation, FFT and division per tone", _estimator_operations(plan)
    )
    yield Step(
        "separation",
        True,
        f"{tags} clock(s) tracked; mixing matrix of {tones} x {ends} per group",
        rate
        * (
            4 * tones * plan.group_length * ends
            + _MULTIPLY_ADD * subcarriers * tones * (tones + 3 * ends)
        ),
    )
    yield Step(
        "reference",
        True,
        f"against {plan.reference_groups} untouched groups ({scene.reference_s:g} s)",
        rate * _MULTIPLY_ADD * ends * subcarriers,
    )
    yield Step(
        "average", True, f"{subcarriers} subcarriers, weighted by their noise",
        rate * _MULTIPLY_ADD * ends * subcarriers,
    )  # fmt: skip
    off = any(np.any(sensor.off_reflection) for sensor in scene.sensors)
    inversion = rate * _INVERSION * len(plan.clocks)
    reason = "phases to force and location" + ("; corrected for the off state" if off else "")
    yield Step("readout", True, reason, inversion)
    yield Step("inversion while untouched", False, "force and location are not defined", inversion)


def _estimator_operations(plan: Plan) -> float:
    tones, length = len(plan.table.tones), plan.waveform.symbol_length
    return (_transform_operations(length) + 12 * length) * tones / plan.group_period_s


def _transform_operations(length: int) -> float:
    """Real operations of a Fourier transform, 5 n log2 n."""
    return float(5 * length * np.log2(length))
