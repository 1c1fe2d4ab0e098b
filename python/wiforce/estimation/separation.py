# SPDX-License-Identifier: GPL-3.0-or-later
"""Separation of the tags' ends: from a group's tones to one complex number per end and subcarrier.

The weights of a run are fixed. What they make of each tag's two square waves at the tracked clock,
M = W [s1, s2], is computed per group and inverted for all tags together, so that aliases, the
clock's offset and lines that tags share cost almost nothing.
"""

import math
from collections import deque
from copy import copy

import numpy as np

from ..signal.switching import harmonics
from .acquisition import DELAY_EVIDENCE, acquire
from .group_fit import GroupFit, GroupTones, inverse_of, power_of, without_loud
from .joint_clock import likelihood_bias, phase_errors, phase_information
from .state import GroupState
from .tracked_tag import TrackedTag

# Acquisition: at least so many groups and so much time.
_ACQUIRE_GROUPS = 8
_ACQUIRE_S = 0.4
_NOISE_MEMORY_S = 2.0
# A tag not seen for so long has to be acquired anew: its clock may have restarted.
_LOST_S = 0.5
# After so long a gap a crystal that drifts by 0.5 ppm/s may have any phase: 0.1 cycles at 1 kHz.
_BRIDGED_S = 20.0
# Smallest noise, relative to the mean tone, that counts as noise rather than rounding.
_NOISE_FLOOR = 1e-14
# Residual of a group over the usual noise: below it is chance; above, noise has not become so.
_NOTABLE = 1.15
_UNUSUAL = 3.0
# Groups whose median residual tells that the noise has changed, and from which factor on. A press
# that changes disturbs fewer.
_STEP_GROUPS = 8
_STEP = 1.33
# Bias of a tag's likelihood, in radians, from which on clocks are tracked by the whole model.
_LARGEST_BIAS = np.radians(0.1)
_REFINEMENTS = 3
# A mixing matrix that amplifies noise above this cannot separate its ends.
_WORST_GAIN = 100.0


class EndSeparator:
    """Tones of each group in, the ends' complex channels out.

    Parameters
    ----------
    table : ToneTable
    clocks : sequence of TagClock
        In the order in which the table was designed.
    averaging_s : float
        Ta of the waveform.
    bins : ndarray of int
        Occupied FFT bins; the others are ignored and come out as zeros.
    sample_rate_hz : float, optional
        Given when the tones come derotated (``ToneTable.derotation``).
    """

    def __init__(self, table, clocks, averaging_s, bins, sample_rate_hz=None):
        self.table = table
        self._line_gain = 1.0
        if sample_rate_hz is not None:
            self._line_gain = 1 / table.symbol_gain(sample_rate_hz)[:, None]
        self._mixer = self._make_mixer(table)
        self.bins = np.asarray(bins)
        self.group_period_s = table.group_length * table.snapshot_period_s
        self._tags = [TrackedTag(table, i, clock, averaging_s) for i, clock in enumerate(clocks)]
        self._jointly = any(
            likelihood_bias(table, tag.likelihood, tag.clock, averaging_s) > _LARGEST_BIAS
            for tag in self._tags
        )
        self.acquisition_groups = max(
            _ACQUIRE_GROUPS, int(np.ceil(_ACQUIRE_S / self.group_period_s))
        )
        self._reference_gain = harmonics(1, clocks[0].clock_hz * averaging_s)[0] ** 2
        self._noise = None
        self._noise_groups = 0
        self._noise_memory = max(32, int(_NOISE_MEMORY_S / self.group_period_s))
        self._misfits, self._latest = deque(maxlen=_STEP_GROUPS), deque(maxlen=_STEP_GROUPS)
        self._held = []
        self._started = False

    @property
    def ends(self):
        """Number of ends, 2 per tag."""
        return 2 * len(self._tags)

    def process(self, group, tones, missing=0, partial=None):
        """Takes one group; gives the groups that are ready, in order.

        Parameters
        ----------
        group : int
            Group index on the grid of the run.
        tones : ndarray of complex, shape (M, 64)
        missing : int
            Snapshots absent.
        partial : PartialWeights, optional
            Weights with which the tones of an incomplete group were made; without them such a
            group cannot be used.

        Returns
        -------
        list of (GroupState, ndarray of complex, shape (2S, 64))
            Empty while groups are held back for acquisition.
        """
        item = self._prepare(group, tones, missing, partial)
        if self._started:
            return [self._separate(item)]
        self._held.append(item)
        if len(self._held) < self.acquisition_groups:
            return []
        return self.flush()

    def flush(self):
        """Ends the acquisition with the groups at hand and gives them all."""
        held, self._held = self._held, []
        if not held:
            return []
        self._started = True
        self._start([item for item in held if item.usable])
        return [self._separate(item, fresh=False) for item in held]

    def _make_mixer(self, weights):
        """What derotated tones make of waveforms: a real matrix, imaginary part below."""
        mixer = self._line_gain * weights.weights
        return np.vstack([mixer.real, mixer.imag])

    def _prepare(self, group, tones, missing, partial):
        tones = np.asarray(tones)[:, self.bins].astype(complex)
        usable = bool(np.isfinite(tones.sum()) and tones.any())
        weights, times, mixer, loss = self.table, self.table.times_s, self._mixer, 1.0
        if partial is not None:
            weights, times = partial, times[partial.mask]
            mixer = self._make_mixer(partial)
            loss = len(partial.mask) / len(times)
        elif missing:
            usable = False
        whitener = weights.whitener
        white = whitener @ tones if usable else None
        center_s = (group + 0.5) * self.group_period_s
        return GroupTones(
            group, center_s, tones, whitener, white, mixer, times, missing, loss, usable
        )

    def _start(self, usable):
        """Acquires every tag over the groups held back.

        More than once: the noise, and what other tags put into a tag's lines, are known only
        after a first time.
        """
        usable = without_loud(usable)
        if len(usable) < 2:
            return
        self._set_noise(np.mean([item.power() for item in usable], axis=0), usable)
        for _ in range(2 if len(self._tags) == 1 else 3):
            for tag in self._tags:
                self._try(tag, usable)
            self._take_residuals(usable)
        if self._jointly and self._locked:
            self._refine(usable)
            for tag in self._locked:
                if tag.delay and not tag.overlapping:
                    self._doubt_delay(tag, usable)
        self._noise_groups = len(usable)

    @property
    def _locked(self):
        return [tag for tag in self._tags if tag.tracker is not None]

    def _refine(self, items):
        """Fits all clocks to a block of groups by the whole model, from where they are."""
        for _ in range(_REFINEMENTS):
            self._step_clocks(items)
            self._take_residuals(items)

    def _take_residuals(self, items):
        """What a block of groups leaves unexplained is noise, but for accidents."""
        residuals = np.array([self._solve(item)[2] for item in items])
        levels = residuals.mean(axis=1)
        fitting = residuals[levels <= _UNUSUAL * np.median(levels)]
        self._set_noise(fitting.mean(axis=0), items)

    def _doubt_delay(self, tag, items):
        """Takes clock 2 for nominal unless the whole model, too, speaks for its delay."""
        delayed, noise = [copy(each.tracker) for each in self._locked], self._noise
        tag.tracker.likelihood = tag.likelihood
        self._refine(items)
        freedom = len(items) * len(self.bins) * (len(self.table.tones) - self.ends)
        evidence = freedom * (self._noise_level / np.mean(noise) - 1)
        if evidence > DELAY_EVIDENCE:
            for each, tracker in zip(self._locked, delayed, strict=True):
                each.tracker = tracker
            self._set_noise(noise, items)

    def _step_clocks(self, items):
        """A Gauss-Newton step of the phases and offsets of all clocks over a block of groups."""
        count = len(self._locked)
        gradient, information = np.zeros(2 * count), np.zeros((2 * count, 2 * count))
        excess = np.zeros(2 * count)
        for item in items:
            told = self._phase_information(item, self._fit(item))
            elapsed = np.array([1.0, item.center_s - self._locked[0].tracker.time_s])
            gradient += np.kron(elapsed, told[0])
            information += np.kron(np.outer(elapsed, elapsed), told[1])
            excess += np.kron(elapsed**2, told[2])
        errors, variances = phase_errors(gradient, information, excess)
        for i, tag in enumerate(self._locked):
            own = [i, count + i]
            tag.tracker.correct(errors[own], variances[own])

    def _set_noise(self, noise, items):
        floor = _NOISE_FLOOR * max(item.level() for item in items)
        self._noise = np.maximum(noise, max(floor, 1e-300))
        self._inverse_noise = 1 / self._noise
        self._noise_level = float(self._noise.sum()) / len(self._noise)

    def _try(self, tag, items):
        """Acquires one tag over a block of usable groups; returns whether it is there."""
        alone = len(self._tags) == 1
        fits = [None if alone else self._fit(item) for item in items]
        covariances = np.array(
            [self._covariance(tag, item, fit) for item, fit in zip(items, fits, strict=True)]
        )
        times = np.array([item.center_s for item in items])
        fit = acquire(
            times, covariances, tag.likelihood, tag.rate, tag.clock.tolerance_ppm, len(self.bins)
        )
        if fit.found:
            tag.start(fit, times, len(self.bins), self._noise_level)
        else:
            tag.drop()
        return fit.found

    def _covariance(self, tag, item, fit):
        """What a tag's likelihood needs of a group, the other tags taken out."""
        tones = item.tones
        if fit is not None:
            foreign = (fit.rows < tag.rows.start) | (fit.rows >= tag.rows.stop)
            tones = tones - fit.mixing[:, foreign] @ fit.ends[foreign]
        return tag.likelihood.covariance(tones, self._noise * item.loss)

    def _separate(self, item, fresh=True):
        if fresh and item.usable:
            self._follow(item)
        ends, gain, residual = self._solve(item)
        clocks = tuple(tag.state(item) for tag in self._tags)
        misfit = self._misfit(residual, item)
        if fresh and item.usable and not item.missing:
            self._learn_noise(residual, misfit, item)
        # What does not fit is alike on all subcarriers, as noise is not.
        gain = gain * (1 + len(self.bins) * max(0.0, misfit - _NOTABLE))
        vectors = np.zeros((self.ends, 64), complex)
        vectors[:, self.bins] = ends
        noise = np.ones(len(self.bins)) if self._noise is None else self._noise
        snr = self._snr_db(ends, gain)
        return GroupState(item.group, item.missing, clocks, noise, gain, snr), vectors

    def _misfit(self, residual, item):
        """What the model leaves of a group over what noise would; 1 when all is well.

        A press that changes inside the group, on this sensor or another, does not fit the model
        and disturbs every end by about as much.
        """
        if self._noise is None or not item.usable:
            return 1.0
        return float(residual @ self._inverse_noise) / len(residual)

    def _follow(self, item):
        if self._noise is None:
            self._set_noise(item.power(), [item])
        predicted = self._fit(item) if len(self._tags) > 1 or self._jointly else None
        measured = self._measure_phases(item, predicted) if self._jointly else {}
        for tag in self._tags:
            if tag.tracker is not None and item.center_s - tag.last_seen_s > _BRIDGED_S:
                tag.drop()
            if tag.tracker is None:
                self._await(tag, item)
                continue
            covariance = self._covariance(tag, item, predicted)
            coefficients = tag.tracker.likelihood.coefficients(covariance)
            told = measured.get(tag)
            if tag.tracker.update(item.center_s, coefficients, self._noise_level, told):
                tag.last_seen_s = item.center_s
            elif item.center_s - tag.last_seen_s > _LOST_S:
                tag.drop()

    def _measure_phases(self, item, fit):
        """(error, variance) of the phase predicted for each locked tag."""
        if not self._locked:
            return {}
        found = phase_errors(*self._phase_information(item, fit))
        return dict(zip(self._locked, zip(*found, strict=True), strict=True))

    def _phase_information(self, item, fit):
        slopes = self._mixed(item, [tag.slopes(item) for tag in self._locked])
        return phase_information(
            fit.white, fit.solver, item.whitener @ slopes, fit.ends, fit.left, self._inverse_noise
        )

    def _mixed(self, item, waveforms):
        """What the group's weights make of waveforms; complex, shape (M, 2 tags)."""
        mixed = item.mixer @ np.hstack(waveforms)
        return mixed[: len(item.tones)] + 1j * mixed[len(item.tones) :]

    def _await(self, tag, item):
        """Tries to acquire a tag over the latest groups."""
        tag.waiting.append(item)
        del tag.waiting[: -self.acquisition_groups]
        if len(tag.waiting) < self.acquisition_groups:
            return
        if self._try(tag, without_loud(tag.waiting)):
            tag.waiting = []

    def _fit(self, item):
        """Least squares over the locked tags at their clocks."""
        locked = self._locked
        if not locked or not item.usable:
            none = np.zeros(0, int)
            return GroupFit(
                none, np.zeros((len(item.tones), 0)), np.zeros((0, len(self.bins))), none
            )
        rows = np.concatenate([np.arange(self.ends)[tag.rows] for tag in locked])
        mixing = self._mixed(item, [tag.waveforms(item) for tag in locked])
        white = item.whitener @ mixing
        adjoint = white.conj().T
        inverse = inverse_of(adjoint @ white)
        solver = inverse @ adjoint
        ends = solver @ item.white
        left = item.white - white @ ends
        return GroupFit(rows, mixing, ends, inverse.diagonal().real, left, white, solver)

    def _solve(self, item):
        """Ends, their gain, and the noise left; unlocked ends are zero with infinite gain."""
        ends = np.zeros((self.ends, len(self.bins)), complex)
        gain = np.full(self.ends, np.inf)
        if not item.usable:
            return ends, gain, np.zeros(len(self.bins))
        fit = self._fit(item)
        if not len(fit.rows):
            return ends, gain, item.power()
        ends[fit.rows] = fit.ends
        # In units of the whole group: a perfect end would have 1/N.
        usable = fit.gain * self.table.group_length < _WORST_GAIN
        gain[fit.rows] = np.where(usable, fit.gain, np.inf)
        freedom = max(len(fit.left) - len(fit.rows), 1)
        return ends, gain, power_of(fit.left).sum(axis=0) / freedom

    def _learn_noise(self, residual, misfit, item):
        self._misfits.append(misfit)
        self._latest.append(item)
        full = len(self._misfits) == _STEP_GROUPS
        if full and min(self._misfits) > _UNUSUAL:
            # Noise that has risen, or a clock that is held at a wrong phase: found anew, from
            # groups none of which was as before.
            self._misfits.clear()
            self._start(list(self._latest))
            for tag in self._tags:
                tag.waiting = [] if tag.tracker else list(self._latest)
            return
        if misfit > _UNUSUAL:
            return
        usual = sorted(self._misfits)[len(self._misfits) // 2]
        if full and not 1 / _STEP < usual < _STEP and usual <= _UNUSUAL:
            # Its level has changed; its course over the subcarriers is still the best known.
            self._misfits.clear()
            self._noise_groups = min(self._noise_groups, _STEP_GROUPS)
            self._set_noise(usual * self._noise, [item])
            return
        self._noise_groups = min(self._noise_groups + 1, self._noise_memory)
        self._set_noise(self._noise + (residual - self._noise) / self._noise_groups, [item])

    def _snr_db(self, ends, gain):
        snr = np.full(len(ends), np.nan)
        for i in np.flatnonzero(np.isfinite(gain)):
            power = np.vdot(ends[i], ends[i]).real / len(self.bins) - gain[i] * self._noise_level
            ratio = self._reference_gain * power / self._noise_level
            snr[i] = 10 * math.log10(max(ratio, 1e-12))
        return snr
