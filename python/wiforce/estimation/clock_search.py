# SPDX-License-Identifier: GPL-3.0-or-later
"""Acquisition of all tags over a block of groups, when only their nominal clocks are known."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np

from .acquisition import DELAY_EVIDENCE, acquire
from .group_tones import GroupTones, without_loud
from .groups import Array
from .joint_clock import likelihood_bias, phase_errors, phase_information
from .least_squares import GroupFit, ToneModel
from .noise import OUTLIER_RATIO, NoiseEstimate, usual_noise
from .pulse_fit import fit_pulses
from .tracked_tag import TrackedTag

# A search takes at least this many groups and this much time: within 0.4 s a clock that drifts by
# 0.5 ppm/s deviates from a constant rate by 0.014 deg at 1 kHz. docs/estimation.md, section
# "Thresholds", states what other values cost.
_LEAST_GROUPS = 8
_LEAST_S = 0.4
# Bias of a tag's likelihood above which clocks are tracked by the complete model: on line 4 it
# causes errors of 0.4 deg, close to the bound of 0.55 deg at gamma 0 dB.
_LARGEST_BIAS = np.radians(0.1)
# Gauss-Newton steps from the phases of the likelihood.
_REFINEMENTS = 3


class ClockSearch:
    """Finds the tags' clocks, their levels and the noise in a block of groups.

    Parameters
    ----------
    model : ToneModel
        Of the run, with its tags.
    noise : NoiseEstimate
        Set by every search.
    averaging_s : float
        Ta of the waveform, in s.

    Attributes
    ----------
    groups : int
        Groups per search.
    jointly : bool
        Whether the likelihood of some tag is biased, so that all clocks are estimated jointly from
        the complete model.

    Examples
    --------
    >>> from gnuradio.wiforce.estimation.tracked_tag import TagClock
    >>> from gnuradio.wiforce.signal.weights import design_weights
    >>> table = design_weights([1000.0], 625, 57.6e-6)
    >>> model = ToneModel(table, [TrackedTag(table, 0, TagClock(1000.0), 20.48e-6)], None)
    >>> search = ClockSearch(model, NoiseEstimate(0.036), 20.48e-6)
    >>> search.groups, search.jointly
    (12, False)
    """

    def __init__(self, model: ToneModel, noise: NoiseEstimate, averaging_s: float) -> None:
        self._model, self._noise = model, noise
        self.groups = max(_LEAST_GROUPS, int(np.ceil(_LEAST_S / model.group_period_s)))
        self.jointly = any(
            likelihood_bias(model.table, tag.likelihood, tag.clock, averaging_s) > _LARGEST_BIAS
            for tag in model.tags
        )

    def run(self, items: Sequence[GroupTones]) -> None:
        """Acquire every tag over a block of groups.

        Two or three passes, because the noise and the leakage of other tags into a tag's lines are
        known only after the first.
        """
        usable = without_loud([item for item in items if item.usable])
        if len(usable) < 2:
            return
        self._noise.set(np.mean([item.power() for item in usable], axis=0), usable)
        for _ in range(2 if len(self._model.tags) == 1 else 3):
            for tag in self._model.tags:
                self.acquire(tag, usable)
            self._take_residuals(usable)
        if self.jointly and self._model.locked:
            self._refine(usable)
            for tag in self._model.locked:
                if tag.clock2_delay and not tag.overlapping:
                    self._verify_delay(tag, usable)
        for tag in self._model.locked:
            self._fit_pulses(tag, usable)
        self._noise.set(self._noise.variance, usable, len(usable))

    def retry(self, tag: TrackedTag, item: GroupTones) -> None:
        """Try to acquire a lost tag over the latest groups."""
        tag.waiting.append(item)
        del tag.waiting[: -self.groups]
        if len(tag.waiting) == self.groups and self.acquire(tag, without_loud(tag.waiting)):
            self._fit_pulses(tag, without_loud(tag.waiting))
            tag.waiting = []

    def _fit_pulses(self, tag: TrackedTag, items: Sequence[GroupTones]) -> None:
        """Fit the pulses of a tag over a block of groups, once."""
        if tag.pulses_known or tag.overlapping:
            return
        tag.pulses_known = True
        if fit_pulses(self._model, tag, items, self._noise.inverse):
            self._take_residuals(items)

    def acquire(self, tag: TrackedTag, items: Sequence[GroupTones]) -> bool:
        """Acquire one tag over a block of usable groups; whether it was found."""
        alone = len(self._model.tags) == 1
        covariances = np.array(
            [self.covariance(tag, item, None if alone else self._model.fit(item)) for item in items]
        )
        times_s = np.array([item.center_s for item in items])
        subcarriers = items[0].tones.shape[1]
        fit = acquire(
            times_s, covariances, tag.likelihood, tag.rate, tag.clock.tolerance_ppm, subcarriers
        )
        if fit.found:
            tag.start(fit, times_s, subcarriers, self._noise.level)
        else:
            tag.drop()
        return fit.found

    def covariance(self, tag: TrackedTag, item: GroupTones, fit: GroupFit | None) -> Array:
        """Covariance of a tag's lines in a group (L, L), without the other tags."""
        tones = self._model.without_others(tag, item, fit)
        return tag.likelihood.covariance(tones, self._noise.variance * item.weights.loss)

    def measure_phases(self, fit: GroupFit | None) -> dict[TrackedTag, tuple[float, float]]:
        """Error of each locked tag's predicted phase and its variance, by the complete model."""
        if fit is None:
            return {}
        errors, variances = phase_errors(*self._information(fit))
        return {
            tag: (float(error), float(variance))
            for tag, error, variance in zip(self._model.locked, errors, variances, strict=True)
        }

    def _information(self, fit: GroupFit) -> tuple[Array, Array, Array]:
        return phase_information(
            fit.white, fit.solver, fit.slopes, fit.ends, fit.residual, self._noise.inverse
        )

    def _take_residuals(self, items: Sequence[GroupTones]) -> None:
        """Estimate the noise from the residuals of a block of groups, without outliers."""
        residuals = np.array([self._model.solve(item)[2] for item in items])
        levels = residuals.mean(axis=1)
        fitting = residuals[levels <= OUTLIER_RATIO * np.median(levels)]
        freedom = max(len(items[0].tones) - 2 * len(self._model.locked), 1)
        self._noise.set(usual_noise(fitting, freedom), items)

    def _refine(self, items: Sequence[GroupTones]) -> None:
        """Fit all clocks to a block of groups by the complete model, from their present values."""
        for _ in range(_REFINEMENTS):
            self._step_clocks(items)
            self._take_residuals(items)

    def _step_clocks(self, items: Sequence[GroupTones]) -> None:
        """A Gauss-Newton step of the phases and offsets of all clocks over a block of groups."""
        trackers = self._model.trackers
        start_s = trackers[0].time_s
        count = len(trackers)
        gradient, information = np.zeros(2 * count), np.zeros((2 * count, 2 * count))
        excess = np.zeros(2 * count)
        for item in items:
            fit = self._model.fit(item, slopes=True)
            if fit is None:
                continue
            slope, curvature, noise = self._information(fit)
            elapsed = np.array([1.0, item.center_s - start_s])
            gradient += np.kron(elapsed, slope)
            information += np.kron(np.outer(elapsed, elapsed), curvature)
            excess += np.kron(elapsed**2, noise)
        errors, variances = phase_errors(gradient, information, excess)
        for i, tracker in enumerate(trackers):
            own = [i, count + i]
            tracker.correct(errors[own], variances[own])

    def _verify_delay(self, tag: TrackedTag, items: Sequence[GroupTones]) -> None:
        """Set the delay of clock 2 to 0 unless the complete model supports it as well."""
        locked = self._model.locked
        delayed, noise = [copy(tracker) for tracker in self._model.trackers], self._noise.variance
        if tag.tracker is not None:
            tag.tracker.likelihood = tag.likelihood
        self._refine(items)
        tones, subcarriers = items[0].tones.shape
        freedom = len(items) * subcarriers * (tones - 2 * len(self._model.tags))
        evidence = freedom * (self._noise.level / np.mean(noise) - 1)
        if evidence > DELAY_EVIDENCE:
            for each, tracker in zip(locked, delayed, strict=True):
                each.tracker = tracker
            self._noise.set(noise, items)
