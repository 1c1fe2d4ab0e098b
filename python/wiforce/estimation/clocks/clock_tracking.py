# SPDX-License-Identifier: GPL-3.0-or-later
"""Tracking of all tags' clocks from group to group.

Only the tracking filters and the noise estimate have to run group by group. What they need from a
group is computed for many groups at once: likelihoods and residual, expanded to second order around
clocks that are predicted from the last group before them, the *operating point*. It is replaced at
certain groups whatever the batches are, so the division into batches does not change the clocks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ...wiforce_kernels import follow_clocks, phase_expansion, raised_subcarriers
from ..ends.least_squares import ToneModel
from ..ends.noise import NoiseEstimate, NoiseHistory, Verdict
from ..group_tones import GroupTones
from ..groups import Array
from .clock_search import ClockSearch
from .joint_clock import phase_errors
from .tracked_tag import ClockPath, ClockTracker, TrackedTag, expected_clocks

# A tag that was not received for this long is acquired again, because its clock may have restarted.
_LOST_S = 0.5
# Both times are at least so many groups: in long groups, a single one may be lost.
_LEAST_GROUPS = 2.5
# Longest gap over which a clock is predicted: drifting by 0.5 ppm/s it may then be wrong by
# d t^2 / 2 = 0.1 cycles at 1 kHz.
_BRIDGED_S = 20.0
# An operating point is used for this long, at least this many groups, as long as every clock is
# near it. Noise, a mean over two seconds, changes little meanwhile.
# At least the last number of groups is expanded at once.
_POINT_S = 1.0
_POINT_GROUPS = 16
_LEAST_REACH = 4
# How far a clock may be from its operating point, in radians. The second-order expansion of J errs
# by n^2 d^3 / 6 at a distance d, where n = 3 is a typical harmonic: at the limit, by this many
# standard deviations of the clock's phase.
_POINT_RAD = (0.003, 0.01)
_POINT_STDS = 1e-3


@dataclass(frozen=True)
class TrackedClocks:
    """Clocks of the locked tags and noise in G groups."""

    path: ClockPath  # corrected by each group, (G, tags)
    received: Array  # (G, tags), the group contains the tag
    noise: NoiseHistory  # MODEL_LOST where the last group shows that clocks or noise are wrong

    def __len__(self) -> int:
        return len(self.noise)


@dataclass(frozen=True)
class _OperatingPoint:
    """Clocks and noise before a group, by which groups are evaluated up to ``stop``.

    It serves clocks that are not further from it than ``reach_rad``, each by its own.
    """

    stop: int
    trackers: list[ClockTracker]
    reach_rad: list[float]
    inverse_noise: Array
    noise_level: float

    def serves(self, ahead: Sequence[float]) -> bool:
        """Whether clocks that are ahead of it by so much are near enough."""
        return all(abs(each) <= reach for each, reach in zip(ahead, self.reach_rad, strict=True))


@dataclass(frozen=True)
class _Measurement:
    """What G groups say of the clocks of S tags, at the clocks assumed."""

    assumed: Array  # (G, S), phases in rad
    likelihood: Array  # (G, S, 3), J, J' and J'' of each tag without the others
    noise_level: float  # mean noise variance by which the likelihoods are scaled
    # (G, S, 2), of the phases by the complete model, and their variances, where used
    errors: Array | None


class ClockTracking:
    """Tracks the clocks of a model's tags, and acquires those that are not known by ``search``."""

    def __init__(self, model: ToneModel, noise: NoiseEstimate, search: ClockSearch) -> None:
        self._model, self._noise, self._search = model, noise, search
        self._point: _OperatingPoint | None = None
        least_s = _LEAST_GROUPS * model.group_period_s
        self._limits_s = max(_LOST_S, least_s), max(_BRIDGED_S, least_s)
        self._point_groups = max(_POINT_GROUPS, int(_POINT_S / model.group_period_s))
        # Groups that are expanded at once: about as many as a point has served lately.
        self._reach = _POINT_GROUPS

    def predict(self, groups: GroupTones) -> TrackedClocks:
        """Clocks and noise in groups that they were acquired from."""
        noise, clocks = self._noise, self._model.predict(groups)
        fit = self._model.solve(groups, clocks)[2]
        residual = fit.noise()
        raised = raised_subcarriers(residual * noise.inverse, fit.freedom)
        seen_s = np.array([tracker.seen_s for tracker in self._model.trackers])
        history = NoiseHistory(
            np.mean(residual * noise.inverse / raised, axis=1),
            raised,
            noise.inverse / raised,
            np.tile(noise.variance, (len(groups), 1)),
            Verdict.LEARNED,
        )
        return TrackedClocks(clocks, seen_s >= groups.center_s[:, None] - 1e-9, history)

    def restart(self) -> None:
        """Start from clocks that were acquired again."""
        self._point = None

    def track(self, groups: GroupTones) -> TrackedClocks:
        """Track clocks and noise over the first of some usable groups, at least one."""
        model, first = self._model, groups[:1]
        for tag in model.tags:
            if self._expired(tag, float(groups.center_s[0])):
                tag.drop()
        lost = [tag for tag in model.tags if tag.tracker is None]
        if not lost:
            return self._follow(groups)
        # The tags that are locked may change with every group.
        self.restart()
        clocks = self._follow(first)
        for tag in lost:
            self._search.retry(tag, first)
        self.restart()
        seen = [tracker.seen_s >= first.center_s[0] for tracker in model.trackers]
        return replace(clocks, path=model.predict(first), received=np.array([seen], bool))

    def _follow(self, groups: GroupTones) -> TrackedClocks:
        model, trackers = self._model, self._model.trackers
        locked, point = model.locked, self._point_for(groups, trackers)
        served = int(groups.group.searchsorted(point.stop))
        groups = groups[: min(served, self._reach)]
        assumed = expected_clocks(point.trackers, groups.center_s)
        groups = model.without_spread_lines(groups, assumed)
        expansion, likelihood, freedom = self._expand(groups, assumed, point.inverse_noise)
        measured = _Measurement(
            assumed.phase,
            likelihood,
            point.noise_level,
            self._errors(expansion, point.inverse_noise),
        )
        before: list[ClockTracker] = []
        if len(groups) > 1:  # a part of them may be tracked again
            before = list(map(copy, trackers))
        path, received = self._filter(groups.center_s, measured, point)
        count = len(received)
        if count < len(groups):
            self._reach = max(count, _LEAST_REACH)
        elif count == self._reach:
            self._reach = min(2 * count, self._point_groups)
        shifts = (path.phase - assumed.phase[:count] + np.pi) % (2 * np.pi) - np.pi
        for i, tag in enumerate(locked):
            if tag.clock.wanders:  # contained in the wander that was removed
                shifts[:, i] = 0.0
        residuals = expansion.power_at(shifts) / freedom
        levels, complete = groups.level[:count].tolist(), groups.missing[:count] == 0
        noise = self._noise.follow(residuals, freedom, levels, complete.tolist())
        if noise.verdict is not Verdict.LEARNED:
            # What follows is tracked by the noise that this group has shown.
            self.restart()
            if len(noise) < count:
                for tag, tracker in zip(locked, before, strict=True):
                    tag.tracker = tracker
                path, received = self._filter(groups.center_s[: len(noise)], measured, point)
        return TrackedClocks(path, received, noise)

    def _filter(
        self, center_s: Array, measured: _Measurement, point: _OperatingPoint
    ) -> tuple[ClockPath, Array]:
        """Update the trackers by one group after the other, as long as the point serves.

        Gives the path of as many of the groups at ``center_s`` (G,) as were taken, and which tags
        (G, S) each contains; ``measured`` was at the operating ``point``.
        """
        count = len(center_s)
        phase, rate, received = follow_clocks(
            self._model.trackers,
            center_s,
            measured.assumed[:count],
            measured.likelihood[:count],
            None if measured.errors is None else measured.errors[:count],
            measured.noise_level,
            point.reach_rad,
            *self._limits_s,
        )
        return ClockPath(phase, rate), received

    def _point_for(self, groups: GroupTones, trackers: list[ClockTracker]) -> _OperatingPoint:
        """The operating point of the first of some groups: the present one, or a new one."""
        group, time_s = int(groups.group[0]), float(groups.center_s[0])
        point = self._point
        if point is not None and group < point.stop:
            phases = [tracker.predict(time_s) for tracker in point.trackers]
            if point.serves(_ahead(trackers, phases, time_s)):
                return point
        before, noise = [copy(each) for each in trackers], self._noise
        stop = group + self._point_groups
        reach_rad = [_reach_rad(tracker) for tracker in before]
        self._point = _OperatingPoint(stop, before, reach_rad, noise.inverse, noise.level)
        return self._point

    def _expand(
        self, groups: GroupTones, assumed: ClockPath, inverse_noise: Array
    ) -> tuple[phase_expansion, Array, int]:
        """Residual of groups around the clocks assumed, likelihoods, degrees of freedom.

        The second are J and its derivatives of each locked tag without the others; shape (G, S, 3).
        """
        model = self._model
        fit = model.fit(groups, assumed)
        likelihood = np.empty((*assumed.phase.shape, 3))
        for i, (tag, tracker) in enumerate(zip(model.locked, model.trackers, strict=True)):
            own = model.own_tones(tag, groups, fit)
            likelihood[:, i] = tracker.likelihood.at(assumed.phase[:, i], own, inverse_noise)
        expansion = phase_expansion(fit)
        if any(tag.clock.wanders for tag in model.locked):
            model.remove_wander(fit, groups, assumed)
            expansion.set_power(fit)
        return expansion, likelihood / groups.loss[:, :, None], fit.freedom

    def _expired(self, tag: TrackedTag, time_s: float) -> bool:
        """Whether a tag's clock is not predicted any further."""
        return tag.tracker is not None and tag.tracker.expired(time_s, *self._limits_s)

    def _errors(self, expansion: phase_expansion, inverse_noise: Array) -> Array | None:
        """Errors of the phases assumed and their variances by the complete model, if used."""
        if not self._search.jointly or not self._model.locked:
            return None
        errors, variances = phase_errors(*expansion.information(inverse_noise))
        return np.array([errors, variances]).transpose(1, 2, 0)


def _reach_rad(tracker: ClockTracker) -> float:
    """How far a clock may be from where it is now for the expansion of J to hold."""
    error_rad = _POINT_STDS * math.sqrt(tracker.variances[0])
    return min(max((6 / 9 * error_rad) ** (1 / 3), _POINT_RAD[0]), _POINT_RAD[1])


def _ahead(trackers: Sequence[ClockTracker], phases: Sequence[float], time_s: float) -> list[float]:
    """By how much the trackers' phases exceed others, in rad."""
    return [
        tracker.ahead_of(phase, time_s) for tracker, phase in zip(trackers, phases, strict=True)
    ]
