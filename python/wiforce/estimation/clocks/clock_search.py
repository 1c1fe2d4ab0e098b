# SPDX-License-Identifier: GPL-3.0-or-later
"""Acquisition of all tags over a block of groups, and of the shape of their pulses.

Wider pulses change the levels of a tag's lines relative to each other, and give end 1 a share of
line 4: the residual along the derivatives of the model gives duty cycles and delay of clock 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ...signal.switching import DUTY, duty_slopes
from ...signal.weights import TimedTable
from ...wiforce_kernels import (
    OUTLIER_RATIO,
    noise_estimate,
    phase_errors,
    phase_information,
    raised_subcarriers,
)
from ..ends.least_squares import ToneModel
from ..groups import Array, GroupFit, GroupTones, GroupWeights, power_of, without_loud
from .likelihood import DELAY_EVIDENCE, OVERLAP, acquire
from .tracked_tag import ClockPath, TrackedTag, likelihood_bias

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
    """Sums over groups: misfit, its part along the tag's channels above noise, gradient (3,),
    information (3, 3), and how much later the clock is in every group (G,), now and by steps (G,
    3).
    """

    energy: float
    coherent: float
    gradient: Array
    information: Array
    shifts: Array
    shifts_by_value: Array


def fit_pulses(model: ToneModel, tag: TrackedTag, groups: GroupTones, inverse_noise: Array) -> bool:
    """Fit duty cycles and delay of clock 2 of a tag; whether others are clearly better, then taken.

    Variable projection (G. Golub and V. Pereyra, 1973): ends and clock phase of each group are
    eliminated. ``inverse_noise`` (K,) is 1 / sigma_k^2.
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
    """Energy of a group's residual along a tag's channels, above that of noise in all others."""
    own = (fit.ends[row, ends] * np.sqrt(weights)).T
    basis = np.linalg.qr(own)[0]
    residual = fit.residual[row] * np.sqrt(weights)
    along = float(power_of(residual @ basis.conj()).sum())
    subcarriers, columns = basis.shape
    across = float(power_of(residual).sum()) - along
    return along - across * columns / max(subcarriers - columns, 1)


# Phases at which the complete model is evaluated, 0.35 deg apart: edges of switches lie at every
# degree for the 80 packets of a group, and eight groups share a clock.
_EVERY_PHASE = 1024


def _complete_likelihood(
    tag: TrackedTag, groups: GroupTones, fit: GroupFit, inverse_noise: Array
) -> Array:
    """Coefficients (G, D + 1) of J(theta) of groups with times of their own, beside other tags.

    It changes in steps where switches open or close, so that it is evaluated at all phases.
    """
    clocks = np.empty((_EVERY_PHASE, 1, 3))
    clocks[:, 0, 0] = 2 * np.pi * np.arange(_EVERY_PHASE) / _EVERY_PHASE
    clocks[:, 0, 1:] = tag.rate, tag.rate * tag.averaging_s / 2
    found = np.empty((len(groups), _EVERY_PHASE))
    for row, weights in enumerate(groups.weights):
        switched = weights.switched(clocks, [(tag.clock2_delay, *tag.duty)])
        first, second = np.ascontiguousarray(switched.T[:2])
        tones = groups.white[row] * np.sqrt(inverse_noise)
        if len(fit.rows) > 2:
            others = np.linalg.qr(fit.white[row][:, ~np.isin(fit.rows, tag.rows)])[0]
            tones = tones - others @ (others.T @ tones)
            first, second = (each - others @ (others.T @ each) for each in (first, second))
        parts = np.hstack([tones.real, tones.imag])
        # Energy in the span of two columns, by their Gram matrix and its inverse.
        one, both, two = _gram(first, second)
        of_one, of_both, of_two = _gram(parts.T @ first, parts.T @ second)
        size = np.maximum(one * two - both**2, 1e-9 * one * two)
        found[row] = (two * of_one - 2 * both * of_both + one * of_two) / np.maximum(size, 1e-300)
    return np.asarray(np.fft.rfft(found, axis=1)[:, :-1] / _EVERY_PHASE)


def _gram(first: Array, second: Array) -> tuple[Array, ...]:
    """Inner products of the columns of two matrices: of each of the first, both, and the second."""
    pairs = (first, first), (first, second), (second, second)
    return tuple(np.einsum("ij,ij->j", *pair) for pair in pairs)


# A search takes at least this many groups and this much time: within 0.4 s a clock that drifts by
# 0.5 ppm/s deviates from a constant rate by 0.014 deg at 1 kHz. docs/data/thresholds.csv
# states what other values cost.
_LEAST_GROUPS = 8
_LEAST_S = 0.4
# A tag that was not received for this long is acquired again, because its clock may have restarted.
_LOST_S = 0.5
# Longest gap over which a clock is predicted: drifting by 0.5 ppm/s it may then be wrong by
# d t^2 / 2 = 0.1 cycles at 1 kHz.
_BRIDGED_S = 20.0
# Both times are at least so many groups: in long groups, a single one may be lost.
_LOST_GROUPS = 2.5
# Snapshots with times of their own that a search takes at least. Each of them says whether an end
# is closed: by 700 packets of an AX200 clocks err by up to 2 degrees, by 1600 of them by 0.4.
_LEAST_TIMED = 2000
# Bias of a tag's likelihood above which clocks are tracked by the complete model: on line 4 it
# causes errors of 0.4 deg, close to the bound of 0.55 deg at gamma 0 dB.
_LARGEST_BIAS = np.radians(0.1)
# Gauss-Newton steps from the phases of the likelihood.
_REFINEMENTS = 3


class ClockSearch:
    """Finds the tags' clocks, their levels and the noise in a block of ``groups``.

    A clock is given up where its tag was absent, or not received, for longer than ``limits_s``; all
    are estimated ``jointly``, from the complete model, where some tag's likelihood is biased.
    """

    def __init__(self, model: ToneModel, noise: noise_estimate, averaging_s: float) -> None:
        self._model, self._noise = model, noise
        self.groups = max(_LEAST_GROUPS, int(np.ceil(_LEAST_S / model.group_period_s)))
        least_s = _LOST_GROUPS * model.group_period_s
        self.limits_s = max(_LOST_S, least_s), max(_BRIDGED_S, least_s)
        enough = int(np.ceil(_LEAST_TIMED / model.table.group_length))
        self.timed = isinstance(model.table, TimedTable) and enough > self.groups
        self.groups = enough if self.timed else self.groups
        self.jointly = self.timed or any(
            likelihood_bias(model.table, tag.likelihood, tag.clock, averaging_s) > _LARGEST_BIAS
            for tag in model.tags
        )

    def run(self, groups: GroupTones) -> None:
        """Acquire every tag over usable groups; again, as noise and leakage are known only then."""
        groups = without_loud(groups)
        if len(groups) < 2:
            return
        self._noise.set(groups.power().mean(axis=0), groups.level.max())
        for _ in range(2 if len(self._model.tags) == 1 else 3):
            for tag in self._model.tags:
                self.acquire(tag, groups)
            self._take_residuals(groups)
        if self.jointly and self._model.locked:
            self._refine(groups)
            for tag in self._model.locked:
                if tag.clock2_delay and not tag.overlapping:
                    self._verify_delay(tag, groups)
        for tag in self._model.locked:
            self._fit_pulses(tag, groups)
        self._noise.set(self._noise.variance, groups.level.max(), len(groups))

    def late_s(self, groups: GroupTones, first: int) -> float:
        """By how much later groups from ``first`` on are, in s, by clocks: slips of frames."""
        groups = without_loud(groups)
        behind, tags = groups.group >= first, self._model.tags
        self._noise.set(groups.power().mean(axis=0), groups.level.max())
        late_s = self._late_s()
        found = np.zeros(len(late_s))
        for tag in tags:
            tones = self._model.own_tones(tag, groups, None)
            covariances = tag.likelihood.covariance(tones, self._noise.variance * groups.loss)
            clock = tag.likelihood, tag.rate, tag.clock.tolerance_ppm, tones.shape[2]
            found += [
                acquire(groups.center_s + behind * each, covariances, *clock).energy
                for each in late_s
            ]
        return _best_of(late_s, found)

    def late_by_clocks_s(self, group: GroupTones) -> float:
        """The same for one group, by the clocks that are tracked."""
        model, late_s = self._model, self._late_s()
        if not model.locked or not self._noise.known:
            return 0.0
        found = []
        for each in late_s:
            moved = replace(group, center_s=group.center_s + each)
            fit = model.solve(moved, model.predict(moved))
            found.append(-fit.freedom * np.sum(fit.noise() * self._noise.inverse))
        return _best_of(late_s, np.array(found))

    def _late_s(self) -> Array:
        """Times by which groups may be late: whole frames, up to half the slowest period."""
        period_s = self._model.table.snapshot_period_s
        half_s = np.pi / min(tag.rate for tag in self._model.tags)
        most = int(half_s / period_s)
        return period_s * np.arange(-most, most + 1)

    def renew(self, groups: GroupTones) -> GroupTones:
        """Give up expired clocks, search lost ones; the groups that have the tags then locked."""
        first, tags = groups[:1], self._model.tags
        for tag in tags:
            if tag.tracker and tag.tracker.expired(float(first.center_s[0]), *self.limits_s):
                tag.drop()
        lost = [tag for tag in tags if tag.tracker is None]
        for tag in lost:
            self._retry(tag, first)
        return first if lost else groups

    def _retry(self, tag: TrackedTag, group: GroupTones) -> None:
        """Try to acquire a lost tag over the latest groups, the last of which is given."""
        tag.waiting.append(group)
        del tag.waiting[: -self.groups]
        if len(tag.waiting) < self.groups:
            return
        latest = without_loud(GroupTones.concatenate(tag.waiting))
        if self.acquire(tag, latest):
            if self.timed:
                self._place_clocks(latest, [tag])
            self._fit_pulses(tag, latest)
            tag.waiting = []

    def _fit_pulses(self, tag: TrackedTag, groups: GroupTones) -> None:
        """Fit the pulses of a tag over a block of groups, once."""
        if tag.pulses_known or tag.overlapping:
            return
        tag.pulses_known = True
        if fit_pulses(self._model, tag, groups, self._noise.inverse):
            self._take_residuals(groups)

    def acquire(self, tag: TrackedTag, groups: GroupTones) -> bool:
        """Acquire one tag over a block of usable groups; whether it was found."""
        model, subcarriers = self._model, groups.tones.shape[2]
        fit = None if len(model.tags) == 1 else model.fit(groups, model.predict(groups))
        covariances = tag.likelihood.covariance(
            model.own_tones(tag, groups, fit), self._noise.variance * groups.loss
        )
        found = acquire(
            groups.center_s,
            covariances,
            tag.likelihood,
            tag.rate,
            tag.clock.tolerance_ppm,
            subcarriers,
        )
        if found.found:
            tag.start(found, groups.center_s, subcarriers, self._noise.level)
        else:
            tag.drop()
        return found.found

    def _take_residuals(self, groups: GroupTones) -> None:
        """Estimate the noise from the residuals of a block of groups, without outliers."""
        fit = self._model.solve(groups, self._model.predict(groups))
        residuals = fit.noise()
        levels = residuals.mean(axis=1)
        fitting = residuals[levels <= OUTLIER_RATIO * np.median(levels)]
        self._noise.set(_robust_noise(fitting, fit.freedom), groups.level.max())

    def _refine(self, groups: GroupTones) -> None:
        """Fit all clocks to a block of groups by the complete model, from their present values."""
        for _ in range(len(self._model.locked) if self.timed else _REFINEMENTS):
            if self.timed:
                self._place_clocks(groups, self._model.locked)
            else:
                self._step_clocks(groups)
            self._take_residuals(groups)

    def _place_clocks(self, groups: GroupTones, tags: Sequence[TrackedTag]) -> None:
        """Set clocks to the most likely ones in a block of groups, by the complete model."""
        times_s = groups.center_s.tolist()
        for tag, coefficients in self._likelihoods(groups, tags):
            assert tag.tracker is not None
            tag.tracker.latest = list(zip(times_s, coefficients, strict=True))
            tag.tracker.place(float(groups.center_s.mean()), tag.clock.tolerance_ppm)

    def follow(self, group: GroupTones) -> None:
        """Set all clocks to the most likely ones in the latest groups, of which one is new."""
        time_s = float(group.center_s[0])
        for tag, coefficients in self._likelihoods(group, self._model.locked):
            assert tag.tracker is not None
            latest = [*tag.tracker.latest, (time_s, coefficients[0])]
            tag.tracker.latest = latest[-self.groups :]
            tag.tracker.place(time_s)

    def _likelihoods(
        self, groups: GroupTones, tags: Sequence[TrackedTag]
    ) -> list[tuple[TrackedTag, Array]]:
        """J of tags in some groups by the complete model."""
        fit = self._model.fit(groups, self._model.predict(groups))
        inverse = self._noise.inverse
        return [(tag, _complete_likelihood(tag, groups, fit, inverse)) for tag in tags]

    def _step_clocks(self, groups: GroupTones) -> None:
        """A Gauss-Newton step of the phases and offsets of all clocks over a block of groups."""
        trackers = self._model.trackers
        count = len(trackers)
        fit = self._model.fit(groups, self._model.predict(groups))
        slope, curvature, noise = phase_information(fit, self._noise.inverse)
        # A phase error at the start acts on all groups alike, one of the rate by the time elapsed.
        elapsed_s = groups.center_s - trackers[0].time_s
        course = np.stack([np.ones(len(groups)), elapsed_s], axis=1)
        gradient = np.einsum("gi,gs->is", course, slope).ravel()
        information = np.einsum("gi,gj,gst->isjt", course, course, curvature)
        excess = np.einsum("gi,gs->is", course**2, noise).ravel()
        errors, variances = phase_errors(
            gradient, information.reshape(2 * count, 2 * count), excess
        )
        for i, tracker in enumerate(trackers):
            own = [i, count + i]
            tracker.correct(errors[own], variances[own])

    def _verify_delay(self, tag: TrackedTag, groups: GroupTones) -> None:
        """Set the delay of clock 2 to 0 unless the complete model supports it as well."""
        locked = self._model.locked
        delayed, noise = [copy(tracker) for tracker in self._model.trackers], self._noise.variance
        if tag.tracker is not None:
            tag.tracker.likelihood = tag.likelihood
        self._refine(groups)
        _, tones, subcarriers = groups.tones.shape
        freedom = len(groups) * subcarriers * (tones - 2 * len(self._model.tags))
        evidence = freedom * (self._noise.level / np.mean(noise) - 1)
        if evidence > DELAY_EVIDENCE:
            for each, tracker in zip(locked, delayed, strict=True):
                each.tracker = tracker
            self._noise.set(noise, groups.level.max())


def _best_of(late_s: Array, likelihood: Array) -> float:
    """The most likely of some times; 0 unless the evidence against it is clear."""
    best = int(np.argmax(likelihood))
    clear = likelihood[best] - likelihood[late_s == 0.0][0] > DELAY_EVIDENCE
    return float(late_s[best]) if clear else 0.0


def _robust_noise(residuals: Array, freedom: int) -> Array:
    """Mean (K,) of the residuals (G, K) without subcarriers that are raised in some groups."""
    quartile = np.sort(residuals, axis=0)[len(residuals) // 4]
    if not np.all(quartile > 0):
        return np.asarray(residuals.mean(axis=0))
    # The quartile of 12 groups lies below the mean, by about one standard deviation of a ratio.
    inverse = (1 - 0.7 * freedom**-0.5) / quartile if freedom > 1 else 0.3 / quartile
    kept = raised_subcarriers(residuals * inverse, freedom) == 1
    if kept.all():
        return np.asarray(residuals.mean(axis=0))
    return np.asarray(np.sum(residuals * kept, axis=0) / np.maximum(kept.sum(axis=0), 1))
