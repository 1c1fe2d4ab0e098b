# SPDX-License-Identifier: GPL-3.0-or-later
"""Duty cycles of a tag's two clocks, and the delay of the second, from the residual of groups.

Wider pulses change the levels of a tag's lines relative to each other, and give end 1 a share of
line 4. What nominal pulses cannot explain of the tones is the residual; its component along the
derivative of the model by each of the three numbers gives them by Gauss-Newton steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...signal.switching import DUTY, duty_slopes
from ..ends.least_squares import ToneModel
from ..group_tones import GroupFit, GroupTones, GroupWeights, power_of
from ..groups import Array
from .acquisition import DELAY_EVIDENCE, OVERLAP
from .tracked_tag import ClockPath, TrackedTag

# Gauss-Newton steps: the model is almost linear in these numbers.
_STEPS = 4
# Largest duty-cycle error that is believed: a second tag on almost the same clock can look like
# more. Smaller ones than the second number do not matter, they change phases by 0.01 deg; a delay
# by this many rad neither.
_LARGEST_ERROR = 0.0125
_NEGLIGIBLE = 1e-4
_NEGLIGIBLE_RAD = 1e-3
# Part of the residual along the ends' own channels that may remain. Disturbances by the room leave
# such a residual too, of which the pulses explain little.
_MAY_REMAIN = 0.5
# Turns of both ends' waveforms, then their widening, by both duty cycles, the delay of clock 2, and
# the phase of both.
_BY_VALUE = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [0, -1, 0, 0], [1, 1, 0, 0]])


@dataclass(eq=False, repr=False)
class _Sums:
    """Sums over groups, the phase of the clock in each being fitted as well.

    Misfit, and its part along the tag's own channels above noise; gradient and information by the
    three numbers; how much later the clock is in every group, at the present numbers and by steps.
    """

    energy: float
    coherent: float
    gradient: Array
    information: Array
    shifts: Array
    shifts_by_value: Array


def fit_pulses(model: ToneModel, tag: TrackedTag, groups: GroupTones, inverse_noise: Array) -> bool:
    """Fit the duty cycles and the delay of clock 2 of a tag whose clock is tracked.

    Returns whether other values are clearly better, and then replaces the tag's likelihoods.
    Nothing changes inside the groups; ``inverse_noise`` (K,) is 1 / sigma_k^2. Variable projection
    (G. Golub and V. Pereyra, 1973): the ends of every group are eliminated, and so is the phase of
    the clock in every group, which jitter moves.
    """
    tracker = tag.tracker
    if tracker is None:
        return False
    before = tag.likelihood, tracker.likelihood
    values = np.array([*tag.duty, tag.clock2_delay])
    # The phases first: what they leave of the residual would hide how much the pulses explain.
    shifts = _sums(model, tag, groups, inverse_noise, np.zeros(len(groups))).shifts
    sums: list[_Sums] = []
    for _ in range(_STEPS):
        now = _sums(model, tag, groups, inverse_noise, shifts)
        step = np.linalg.lstsq(now.information, now.gradient, rcond=1e-9)[0]
        if not sums and now.gradient @ step / 2 < DELAY_EVIDENCE:
            return False
        sums.append(now)
        values = values + step
        shifts = shifts + now.shifts - now.shifts_by_value @ step
        if np.abs(values[:2] - DUTY).max() > _LARGEST_ERROR or abs(values[2]) > OVERLAP:
            break
        duty, delay = (float(values[0]), float(values[1])), float(values[2])
        tag.likelihood = before[0].delayed(0.0, duty)
        tracker.likelihood = before[0].delayed(delay, duty)
    else:
        sums.append(_sums(model, tag, groups, inverse_noise, shifts))
        change = np.abs(values - [*before[0].duty, before[1].clock2_delay])
        matters = np.any(change > (_NEGLIGIBLE, _NEGLIGIBLE, _NEGLIGIBLE_RAD))
        clear = sums[0].energy - sums[-1].energy > DELAY_EVIDENCE
        if matters and clear and sums[-1].coherent < _MAY_REMAIN * sums[0].coherent:
            tracker.phase += float(shifts.mean())
            return True
    tag.likelihood, tracker.likelihood = before
    return False


def _sums(
    model: ToneModel, tag: TrackedTag, groups: GroupTones, inverse_noise: Array, shifts: Array
) -> _Sums:
    """Sums over groups whose clock phases are ``shifts`` ahead of the tracker's."""
    place = model.locked.index(tag)
    ends = slice(2 * place, 2 * place + 2)
    clocks = model.predict(groups)
    clocks.phase[:, place] += shifts
    fit = model.fit(groups, clocks)
    changes = np.concatenate(
        [_changes(tag, weights, clocks.of(place, rows)) for weights, rows in groups.by_weights()]
    )
    # What a change of the ends cannot compensate, times the channel of its end.
    changes = changes - fit.white @ (fit.solver @ changes)
    channels = fit.ends[:, ends][:, [0, 1, 0, 1]]
    weights = inverse_noise / groups.loss
    adjoint, weighted = changes.conj().swapaxes(1, 2), channels.conj() * weights[:, None]
    along = np.sum((adjoint @ fit.residual) * weighted, axis=2).real
    within = ((adjoint @ changes) * (weighted @ channels.swapaxes(1, 2))).real
    gradient = 2 * along @ _BY_VALUE.T
    information = 2 * _BY_VALUE @ within @ _BY_VALUE.T
    # The phase of every group is eliminated.
    own = np.maximum(information[:, 3, 3], 1e-300)
    across = information[:, :3, 3]
    by_phase = gradient[:, 3] / own
    squares = np.sum(power_of(fit.residual).sum(axis=1) * weights)
    return _Sums(
        float(squares - np.sum(gradient[:, 3] ** 2 / own) / 2),
        sum(_coherent(fit, row, ends, weights[row]) for row in range(len(groups))),
        np.sum(gradient[:, :3] - across * by_phase[:, None], axis=0),
        information[:, :3, :3].sum(axis=0) - (across / own[:, None]).T @ across,
        by_phase,
        across / own[:, None],
    )


def _changes(tag: TrackedTag, weights: GroupWeights, clock: ClockPath) -> Array:
    """Derivatives of both waveforms' tones by the phase and by the duty cycles; (G, M, 4)."""
    slopes = tag.waveforms_and_slopes(clock, weights.times_s)[1]
    return np.concatenate([weights.mix(slopes), weights.mix(duty_slopes(slopes))], axis=2)


def _coherent(fit: GroupFit, row: int, ends: slice, weights: Array) -> float:
    """Energy of a group's residual along the channels of a tag's ends, above that of noise.

    Noise is what the residual holds on average in all other directions.
    """
    own = (fit.ends[row, ends] * np.sqrt(weights)).T
    basis = np.linalg.qr(own)[0]
    residual = fit.residual[row] * np.sqrt(weights)
    along = float(power_of(residual @ basis.conj()).sum())
    subcarriers, columns = basis.shape
    across = float(power_of(residual).sum()) - along
    return along - across * columns / max(subcarriers - columns, 1)
