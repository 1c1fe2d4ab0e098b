# SPDX-License-Identifier: GPL-3.0-or-later
"""Duty cycles of a tag's two clocks, and the delay of the second, from the residual of groups.

Wider pulses change the levels of a tag's lines relative to each other, and give end 1 a share of
line 4. What nominal pulses cannot explain of the tones is the residual; its component along the
derivative of the model by each of the three numbers gives them by Gauss-Newton steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..signal.switching import DUTY, duty_slopes
from .acquisition import DELAY_EVIDENCE, OVERLAP
from .group_tones import GroupTones, power_of
from .groups import Array
from .least_squares import GroupFit, ToneModel
from .tracked_tag import TrackedTag

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


@dataclass
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


def fit_pulses(
    model: ToneModel, tag: TrackedTag, items: Sequence[GroupTones], inverse_noise: Array
) -> bool:
    """Fit the duty cycles and the delay of clock 2 of a tag whose clock is tracked.

    Parameters
    ----------
    model : ToneModel
        With the clocks of all tags.
    tag : TrackedTag
        Its likelihoods are replaced where the evidence is clear.
    items : sequence of GroupTones
        Untouched, or at least without a change inside a group.
    inverse_noise : ndarray, shape (K,)
        1 / sigma_k^2.

    Returns
    -------
    bool
        Whether other values than the present ones are clearly better.

    Notes
    -----
    Variable projection (G. Golub and V. Pereyra, 1973): the ends of every group are eliminated, and
    so is the phase of the clock in every group, which jitter moves.

    Examples
    --------
    A clock 1 of 24.5 % duty, without noise:

    >>> from gnuradio.wiforce.estimation.clock_search import ClockSearch
    >>> from gnuradio.wiforce.estimation.groups import Groups
    >>> from gnuradio.wiforce.estimation.noise import NoiseEstimate
    >>> from gnuradio.wiforce.estimation.tracked_tag import TagClock
    >>> from gnuradio.wiforce.signal.switching import switch_averages
    >>> from gnuradio.wiforce.signal.weights import design_weights
    >>> table = design_weights([1000.0], 625, 57.6e-6)
    >>> model = ToneModel(table, [TrackedTag(table, 0, TagClock(1000.0), 20.48e-6)], None)
    >>> phases = 2 * np.pi * 1000 * table.times_s
    >>> waveforms = switch_averages(phases, np.pi * 1000 * 20.48e-6, 0.0, (0.245, 0.25))
    >>> tones = table.weights @ waveforms @ np.outer([1, 1j], np.ones(62))
    >>> items = model.prepare(Groups(np.arange(12), np.tile(tones, (12, 1, 1))))
    >>> ClockSearch(model, NoiseEstimate(0.036), 20.48e-6).run(items)
    >>> np.round(model.tags[0].duty, 5).tolist()
    [0.245, 0.25]
    """
    tracker = tag.tracker
    if tracker is None:
        return False
    before = tag.likelihood, tracker.likelihood
    values = np.array([*tag.duty, tag.clock2_delay])
    # The phases first: what they leave of the residual would hide how much the pulses explain.
    shifts = _sums(model, tag, items, inverse_noise, np.zeros(len(items))).shifts
    sums: list[_Sums] = []
    for _ in range(_STEPS):
        now = _sums(model, tag, items, inverse_noise, shifts)
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
        sums.append(_sums(model, tag, items, inverse_noise, shifts))
        change = np.abs(values - [*before[0].duty, before[1].clock2_delay])
        matters = np.any(change > (_NEGLIGIBLE, _NEGLIGIBLE, _NEGLIGIBLE_RAD))
        clear = sums[0].energy - sums[-1].energy > DELAY_EVIDENCE
        if matters and clear and sums[-1].coherent < _MAY_REMAIN * sums[0].coherent:
            tracker.phase += float(shifts.mean())
            return True
    tag.likelihood, tracker.likelihood = before
    return False


def _sums(
    model: ToneModel,
    tag: TrackedTag,
    items: Sequence[GroupTones],
    inverse_noise: Array,
    shifts: Array,
) -> _Sums:
    """Sums over groups whose clock phases are ``shifts`` ahead of the tracker's."""
    tracker, place = tag.tracker, model.locked.index(tag)
    if tracker is None:
        raise ValueError("the clock of the tag is not known")
    phase, count = tracker.phase, len(items)
    found = _Sums(0.0, 0.0, np.zeros(3), np.zeros((3, 3)), np.zeros(count), np.zeros((count, 3)))
    for row, item in enumerate(items):
        tracker.phase = phase + shifts[row]
        fit = model.fit(item)
        if fit is None:
            continue
        slopes = tag.waveforms_and_slopes(item.center_s, item.weights)[1]
        changes = item.weights.whitener @ item.weights.mix([slopes, duty_slopes(slopes)])
        first, second = fit.ends[2 * place : 2 * place + 2]
        # By the duty cycles, the delay of clock 2, and the phase of both.
        by_value = np.stack(
            [
                np.outer(changes[:, 2], first),
                np.outer(changes[:, 3], second),
                np.outer(-changes[:, 1], second),
                np.outer(changes[:, 0], first) + np.outer(changes[:, 1], second),
            ]
        )
        by_value -= fit.white @ (fit.solver @ by_value)
        weights = inverse_noise / item.weights.loss
        weighted = (by_value * weights).reshape(4, -1).conj()
        gradient = 2 * (weighted @ fit.residual.ravel()).real
        information = 2 * (weighted @ by_value.reshape(4, -1).T).real
        own = max(float(information[3, 3]), 1e-300)
        across = information[:3, 3]
        found.shifts[row] = gradient[3] / own
        found.shifts_by_value[row] = across / own
        found.gradient += gradient[:3] - across * gradient[3] / own
        found.information += information[:3, :3] - np.outer(across, across) / own
        misfit = float(power_of(fit.residual).sum(axis=0) @ weights)
        found.coherent += _coherent(fit, place, weights)
        found.energy += misfit - float(gradient[3] ** 2 / own) / 2
    tracker.phase = phase
    return found


def _coherent(fit: GroupFit, place: int, weights: Array) -> float:
    """Energy of a residual along the channels of a tag's ends, above that of noise.

    Noise is what the residual holds on average in all other directions.
    """
    own = (fit.ends[2 * place : 2 * place + 2] * np.sqrt(weights)).T
    basis = np.linalg.qr(own)[0]
    residual = fit.residual * np.sqrt(weights)
    along = float(power_of(residual @ basis.conj()).sum())
    subcarriers, columns = basis.shape
    across = float(power_of(residual).sum()) - along
    return along - across * columns / max(subcarriers - columns, 1)
