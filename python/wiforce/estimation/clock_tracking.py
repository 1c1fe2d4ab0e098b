# SPDX-License-Identifier: GPL-3.0-or-later
"""Tracking of all tags' clocks from group to group.

Only the tracking filters and the noise estimate have to run group by group. What they need from a
group is computed for many groups at once: likelihoods and residual, expanded to second order around
clocks that are predicted from the last group before them, the *operating point*. It is replaced at
certain groups whatever the batches are, so the division into batches does not change the clocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from .clock_search import ClockSearch
from .clock_tracker import ClockPath, ClockTracker, predict_clocks
from .group_tones import GroupTones, power_of
from .groups import Array
from .joint_clock import PhaseExpansion, phase_errors
from .least_squares import ToneModel
from .noise import NoiseEstimate, Verdict
from .tracked_tag import TrackedTag

# A tag that was not received for this long is acquired again, because its clock may have restarted.
_LOST_S = 0.5
# Longest gap over which a clock is predicted: drifting by 0.5 ppm/s it may then be wrong by
# d t^2 / 2 = 0.1 cycles at 1 kHz.
_BRIDGED_S = 20.0
# An operating point is used for this many groups, as long as no clock is further from it than this
# many radians.
_POINT_GROUPS = 16
_POINT_RAD = 0.003


@dataclass(frozen=True)
class TrackedClocks:
    """Clocks of the locked tags and noise in G groups.

    Attributes
    ----------
    path : ClockPath
        Corrected by each group; arrays of shape (G, tags).
    received : ndarray of bool, shape (G, tags)
        Whether the group contains the tag.
    ratio : ndarray, shape (G,)
        Residual of each group over the noise before it.
    raised : ndarray, shape (G, K)
        Noise of each group over that of the groups before (``NoiseEstimate.raised``).
    inverse_noise : ndarray, shape (G, K)
        1 / sigma_k^2 of each group, by the groups before and ``raised``.
    variance : ndarray, shape (G, K)
        sigma_k^2 after it, without ``raised``.
    model_lost : bool
        Whether the last of these groups shows that clocks or noise are wrong.

    Examples
    --------
    >>> path, noise = ClockPath(np.zeros((3, 1)), np.zeros((3, 1))), np.ones((3, 62))
    >>> len(TrackedClocks(path, np.ones((3, 1), bool), np.ones(3), noise, noise, noise))
    3
    """

    path: ClockPath
    received: Array
    ratio: Array
    raised: Array
    inverse_noise: Array
    variance: Array
    model_lost: bool = False

    def __len__(self) -> int:
        return len(self.ratio)


@dataclass(frozen=True)
class _OperatingPoint:
    """Clocks before a group, at which groups are evaluated from this one on up to ``stop``."""

    stop: int
    trackers: list[ClockTracker]


class ClockTracking:
    """Tracks the clocks of a model's tags.

    Parameters
    ----------
    model : ToneModel
        Its tags' trackers are updated.
    noise : NoiseEstimate
        Known before the first group is tracked.
    search : ClockSearch
        Acquires tags whose clock is not known.

    Examples
    --------
    >>> from gnuradio.wiforce.estimation.groups import Groups
    >>> from gnuradio.wiforce.estimation.tracked_tag import TagClock, TrackedTag
    >>> from gnuradio.wiforce.signal.weights import design_weights
    >>> table = design_weights([1000.0], 625, 57.6e-6)
    >>> model = ToneModel(table, [TrackedTag(table, 0, TagClock(1000.0), 20.48e-6)], None)
    >>> noise = NoiseEstimate(0.036)
    >>> noise.set(np.ones(62), 1.0)
    >>> tracking = ClockTracking(model, noise, ClockSearch(model, noise, 20.48e-6))
    >>> groups, usable = model.prepare(Groups(np.arange(3), np.ones((3, 16, 62))))
    >>> tracking.track(groups).received.shape  # no tag is locked: group by group
    (1, 0)
    """

    def __init__(self, model: ToneModel, noise: NoiseEstimate, search: ClockSearch) -> None:
        self._model, self._noise, self._search = model, noise, search
        self._point: _OperatingPoint | None = None

    def predict(self, groups: GroupTones) -> TrackedClocks:
        """Clocks and noise in groups that they were acquired from."""
        noise, clocks = self._noise, self._model.predict(groups)
        fit = self._model.solve(groups, clocks)[2]
        residual = fit.noise()
        raised = np.array([noise.raised(each, fit.freedom) for each in residual])
        last_seen_s = np.array([tag.last_seen_s for tag in self._model.locked])
        return TrackedClocks(
            clocks,
            last_seen_s >= groups.center_s[:, None] - 1e-9,
            np.mean(residual * noise.inverse / raised, axis=1),
            raised,
            noise.inverse / raised,
            np.tile(noise.variance, (len(groups), 1)),
        )

    def restart(self) -> None:
        """Start from clocks that were acquired again."""
        self._point = None

    def track(self, groups: GroupTones) -> TrackedClocks:
        """Track clocks and noise over the first of some groups, at least one.

        Parameters
        ----------
        groups : GroupTones
            All of them usable.

        Returns
        -------
        TrackedClocks
            Of as many groups as were tracked.
        """
        model, first = self._model, groups[:1]
        for tag in model.tags:
            if _expired(tag, float(groups.center_s[0])):
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
        seen = [tag.last_seen_s >= first.center_s[0] for tag in model.locked]
        return replace(clocks, path=model.predict(first), received=np.array([seen], bool))

    def _follow(self, groups: GroupTones) -> TrackedClocks:
        model, noise = self._model, self._noise
        locked, trackers = model.locked, model.trackers
        point = self._point_for(groups, trackers)
        groups = groups[: int(np.searchsorted(groups.group, point.stop))]
        assumed = predict_clocks(point.trackers, groups.center_s)
        expansion, likelihoods, freedom = self._expand(groups, assumed)
        wandering = np.array([tag.clock.wanders for tag in locked], bool)
        phase, rate = np.empty((2, *assumed.phase.shape))
        received = np.zeros(phase.shape, bool)
        raised, inverse, variance = np.empty((3, *expansion.power.shape))
        ratios: list[float] = []
        model_lost = False
        phases, levels = assumed.phase.tolist(), groups.level.tolist()
        loss, missing = groups.loss.ravel().tolist(), groups.missing.tolist()
        for row, time_s in enumerate(groups.center_s.tolist()):
            ahead = _ahead(trackers, phases[row], time_s)
            if row and (
                max(map(abs, ahead), default=0.0) > _POINT_RAD
                or any(_expired(tag, time_s) for tag in locked)
            ):
                break
            group = expansion[row]
            errors = self._measure(group)
            values = (likelihoods[row] @ noise.inverse / loss[row]).tolist()
            for i, tracker in enumerate(trackers):
                error = errors[i] if errors else None
                if tracker.update(time_s, values[i], noise.level, error, ahead[i]):
                    locked[i].last_seen_s = time_s
                    received[row, i] = True
                phase[row, i], rate[row, i] = tracker.phase, tracker.rate
            shifts = np.remainder(phase[row] - assumed.phase[row] + np.pi, 2 * np.pi) - np.pi
            shifts[wandering] = 0.0  # contained in the wander that was removed
            residual = group.power_at(shifts) / freedom
            raised[row] = noise.raised(residual, freedom)
            inverse[row] = noise.inverse / raised[row]
            ratio = float(residual @ inverse[row]) / len(residual)
            ratios.append(ratio)
            if not missing[row]:
                verdict = noise.learn(residual, ratio, levels[row], raised[row])
                model_lost = verdict is Verdict.MODEL_LOST
            variance[row] = noise.variance
            if model_lost:
                break
        count = len(ratios)
        return TrackedClocks(
            ClockPath(phase[:count], rate[:count]),
            received[:count],
            np.array(ratios),
            raised[:count],
            inverse[:count],
            variance[:count],
            model_lost,
        )

    def _point_for(self, groups: GroupTones, trackers: list[ClockTracker]) -> _OperatingPoint:
        """The operating point of the first of some groups: the present one, or a new one."""
        group, time_s = int(groups.group[0]), float(groups.center_s[0])
        point = self._point
        if point is not None and group < point.stop:
            phases = [tracker.predict(time_s)[0] for tracker in point.trackers]
            if max(map(abs, _ahead(trackers, phases, time_s)), default=0.0) <= _POINT_RAD:
                return point
        self._point = _OperatingPoint(group + _POINT_GROUPS, [copy(each) for each in trackers])
        return self._point

    def _expand(self, groups: GroupTones, assumed: ClockPath) -> tuple[PhaseExpansion, Array, int]:
        """Residual of groups around the clocks assumed, terms of each J, degrees of freedom.

        The second are those of J and its derivatives, of each locked tag without the other tags;
        shape (G, S, 3, K).
        """
        model = self._model
        fit = model.fit(groups, assumed, slopes=True)
        terms = np.empty((len(groups), assumed.phase.shape[1], 3, groups.tones.shape[2]))
        for i, (tag, tracker) in enumerate(zip(model.locked, model.trackers, strict=True)):
            own = model.own_tones(tag, groups, fit)
            terms[:, i] = tracker.likelihood.at(assumed.phase[:, i], own)
        expansion = fit.expansion()
        if any(tag.clock.wanders for tag in model.locked):
            model.remove_wander(fit, groups, assumed)
            expansion.power = power_of(fit.residual).sum(axis=1)
        return expansion, terms, fit.freedom

    def _measure(self, group: PhaseExpansion) -> list[tuple[float, float]]:
        """Errors of the phases assumed and their variances by the complete model, if used."""
        if not self._search.jointly or not self._model.locked:
            return []
        errors, variances = phase_errors(*group.information(self._noise.inverse))
        return list(zip(errors.tolist(), variances.tolist(), strict=True))


def _expired(tag: TrackedTag, time_s: float) -> bool:
    """Whether a tag's clock is not predicted any further."""
    if tag.tracker is None:
        return False
    absent_s, unseen_s = tag.tracker.time_s - tag.last_seen_s, time_s - tag.last_seen_s
    return absent_s > _LOST_S or unseen_s > _BRIDGED_S


def _ahead(trackers: Sequence[ClockTracker], phases: Sequence[float], time_s: float) -> list[float]:
    """By how much the trackers' phases exceed others, in rad."""
    return [
        tracker.ahead_of(phase, time_s) for tracker, phase in zip(trackers, phases, strict=True)
    ]
