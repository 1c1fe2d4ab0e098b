# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of a scene's plan: needed or skipped, why, and what each costs."""

from dataclasses import dataclass

import numpy as np

from ..signal.waveform import FFT_LENGTH
from ..signal.weights import clutter_order, tag_lines
from .plan import ACCEPTED_LOSS_DB, HARMONICS

# Real operations of a 64-point FFT, 5 n log2 n, and of one complex multiplication and addition.
_FFT = 5 * FFT_LENGTH * 6
_MULTIPLY_ADD = 8
# Of one inversion: two Taylor expansions, covariance, checks.
_INVERSION = 200


@dataclass(frozen=True)
class Step:
    """A step of the chain.

    Attributes
    ----------
    name : str
        The block, or what is done in it.
    needed : bool
    reason : str
    operations : float
        Real additions and multiplications per second of signal: what it costs, or what the skip
        saves.
    """

    name: str
    needed: bool
    reason: str
    operations: float


def steps(scene, plan):
    """The steps of a scene, in the order of the chain.

    Parameters
    ----------
    scene : Scene
    plan : Plan

    Returns
    -------
    tuple of Step
    """
    return (*_snapshot_steps(plan), *_group_steps(scene, plan))


def _snapshot_steps(plan):
    """What runs per snapshot: 17 000 times a second and more."""
    waveform, tones = plan.waveform, len(plan.table.tones)
    rate = 1 / waveform.snapshot_period_s
    folded = waveform.repetitions * FFT_LENGTH
    skipped = waveform.frame_length - folded
    yield Step(
        "preamble_fold",
        True,
        f"{waveform.repetitions} repetitions of a symbol are added: {folded} samples become 64",
        2 * (folded - FFT_LENGTH) * rate,
    )
    yield Step(
        "guard and first repetition",
        False,
        f"{skipped} of {waveform.frame_length} samples hold nothing that is averaged",
        2 * skipped * rate,
    )
    yield Step(
        "channel per snapshot",
        False,
        "fold, tones and channel estimate are linear and commute: the FFT runs per tone and group",
        (_FFT + 6 * FFT_LENGTH) * rate - _estimator_operations(plan),
    )
    # The two tones of a pair share their products.
    per_tone = _MULTIPLY_ADD * FFT_LENGTH / 2 * rate
    yield Step("phase_group_doppler", True, _doppler_reason(plan), per_tone * tones)
    most = _most_tones(plan)
    if plan.loss_db and tones < most < plan.group_length / 2:
        yield Step(
            "more lines",
            False,
            f"up to +-{HARMONICS[-1]} they would bring {ACCEPTED_LOSS_DB:g} dB at most",
            per_tone * (most - tones),
        )


def _doppler_reason(plan):
    lines = f"lines +-1..+-{plan.harmonics} of {len(plan.clocks)} tag(s)"
    reason = f"{len(plan.table.tones)} tones hold {lines}"
    if plan.loss_db:
        reason += f", within {max(plan.loss_db):.2f} dB of all lines"
    if plan.clutter_hz == 0:
        return reason + "; nothing moves: the weights take out the mean only"
    order = clutter_order(plan.group_length, plan.waveform.snapshot_period_s, plan.clutter_hz)
    return reason + f"; the weights null {order} sequences up to {plan.clutter_hz:g} Hz"


def _most_tones(plan):
    clocks_hz = tuple(clock.clock_hz for clock in plan.clocks)
    period_s = plan.waveform.snapshot_period_s
    return len(tag_lines(clocks_hz, period_s, plan.group_length, HARMONICS[-1], plan.clutter_hz))


def _group_steps(scene, plan):
    """What runs per phase group: tens of times a second."""
    rate = 1 / plan.group_period_s
    tones, ends = len(plan.table.tones), 2 * len(plan.clocks)
    subcarriers = len(plan.waveform.bins)
    yield Step(
        "ofdm_channel_estimator", True, "derotation, FFT and division per tone",
        _estimator_operations(plan),
    )  # fmt: skip
    yield Step(
        "end_separation",
        True,
        f"{len(plan.clocks)} clock(s) tracked; mixing matrix of {tones} x {ends} per group",
        rate
        * (
            4 * tones * plan.group_length * ends
            + _MULTIPLY_ADD * subcarriers * tones * (tones + 3 * ends)
        ),
    )
    yield Step(
        "conjugate_difference",
        True,
        f"against {plan.reference_groups} untouched groups ({scene.reference_s:g} s)",
        rate * _MULTIPLY_ADD * ends * subcarriers,
    )
    yield Step(
        "subcarrier_average", True, f"{subcarriers} subcarriers, weighted by their noise",
        rate * _MULTIPLY_ADD * ends * subcarriers,
    )  # fmt: skip
    several = plan.smoothing_groups > 1
    yield Step(
        "average over groups",
        several,
        f"up to {plan.smoothing_groups} groups while nothing changes"
        if several
        else "a group is long enough by itself",
        rate * 40 * ends * max(1, plan.smoothing_groups if several else 0),
    )
    off = any(np.any(sensor.off_reflection) for sensor in scene.sensors)
    inversion = rate * _INVERSION * len(plan.clocks)
    reason = "phases to force and location" + ("; the off state taken out" if off else "")
    yield Step("force_inversion", True, reason, inversion)
    yield Step("inversion while untouched", False, "there is no force to be found", inversion)


def _estimator_operations(plan):
    tones = len(plan.table.tones)
    return (_FFT + 12 * FFT_LENGTH) * tones / plan.group_period_s
