# SPDX-License-Identifier: GPL-3.0-or-later
"""Separation of the tags' ends: from a group's tones to one complex number per end and subcarrier.

The weights of a run are fixed. What they make of each tag's two square waves at the tracked clock,
M = W [s1, s2], is computed per group and inverted for all tags together, so that aliases, the
clock's offset and lines that tags share cost almost nothing.
"""

from dataclasses import dataclass

import numpy as np

from .clock import ClockTracker, PhaseLikelihood, acquire
from .state import ClockState, GroupState
from .tag_clock import harmonics, switch_averages

# Acquisition: at least so many groups and so much time.
_ACQUIRE_GROUPS = 8
_ACQUIRE_S = 0.4
# A tag is there when its waveforms explain so much more than noise would, per dimension, ...
_ENERGY_RATIO = 1.25
# ... and the groups agree on the clock by so many standard deviations.
_AGREEMENT = 5.0
_NOISE_MEMORY_S = 2.0
# A tag not seen for so long has to be acquired anew: its clock may have restarted.
_LOST_S = 0.5
# Smallest noise, relative to the mean tone, that counts as noise rather than rounding.
_NOISE_FLOOR = 1e-14
# Residual of a group over the usual noise: below it is chance; above, noise has not become so.
_NOTABLE = 1.15
_UNUSUAL = 3.0
# A mixing matrix that amplifies noise above this cannot separate its ends.
_WORST_GAIN = 100.0


@dataclass(frozen=True)
class TagClock:
    """Nominal clock of one tag: fs and how far off it may be."""

    clock_hz: float
    tolerance_ppm: float = 100.0


class _Tag:
    """Everything that the separator keeps about one tag."""

    def __init__(self, table, index, clock, averaging_s):
        self.clock = clock
        self.index = index
        self.rate = 2 * np.pi * clock.clock_hz
        self.averaging_phase = clock.clock_hz * averaging_s
        self.half_window = np.pi * self.averaging_phase
        self.clock2_delay = 0.0
        self.likelihood = PhaseLikelihood(table, index, self.averaging_phase)
        self.overlapping = False
        self.tracker = None
        self.last_seen_s = None
        self.waiting = []

    def drop(self):
        self.tracker = None
        self.waiting = []

    def waveforms(self, times_s, center_s):
        """s1 and s2 of every snapshot; ``times_s`` counts from the group's centre."""
        phase, rate = self.tracker.predict(center_s)
        phases = phase + (self.rate + rate) * times_s
        scale = 1 + rate / self.rate
        return switch_averages(phases, self.half_window * scale, self.clock2_delay)

    def state(self, center_s):
        if self.tracker is None:
            return ClockState(False)
        phase, rate = self.tracker.predict(center_s)
        ppm = 1e6 * rate / self.rate
        wrapped = float(phase % (2 * np.pi))
        return ClockState(True, wrapped, float(ppm), self.clock2_delay, self.overlapping)


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
        self._line_gain = np.ones((len(table.tones), 1))
        if sample_rate_hz is not None:
            self._line_gain /= table.symbol_gain(sample_rate_hz)[:, None]
        self.bins = np.asarray(bins)
        self.group_period_s = table.group_length * table.snapshot_period_s
        self._tags = [_Tag(table, i, clock, averaging_s) for i, clock in enumerate(clocks)]
        self.acquisition_groups = max(
            _ACQUIRE_GROUPS, int(np.ceil(_ACQUIRE_S / self.group_period_s))
        )
        self._reference_gain = harmonics(1, self._tags[0].averaging_phase)[0] ** 2
        self._noise = None
        self._noise_groups = 0
        self._noise_memory = max(32, int(_NOISE_MEMORY_S / self.group_period_s))
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
        self._start(held)
        return [self._separate(item, fresh=False) for item in held]

    def _prepare(self, group, tones, missing, partial):
        table, times = self.table, self.table.times_s
        if partial is not None:
            table, times = partial, times[partial.mask]
        tones = np.asarray(tones)[:, self.bins].astype(complex)
        usable = bool(np.all(np.isfinite(tones)) and np.any(tones))
        usable = usable and (partial is not None or not missing)
        center_s = (group + 0.5) * self.group_period_s
        return _Group(group, center_s, tones, table.weights, table.whitener, times, missing, usable)

    def _start(self, held):
        """Acquires every tag over the held groups, twice: the noise is known only after once."""
        usable = [item for item in held if item.usable]
        if len(usable) < 2:
            return
        self._noise = self._floored(np.mean([item.power() for item in usable], axis=0), usable)
        for _ in range(2):
            for tag in self._tags:
                self._try(tag, usable)
            residuals = [self._solve(item)[2] for item in usable]
            self._noise = self._floored(np.mean(residuals, axis=0), usable)
        self._noise_groups = len(usable)

    def _floored(self, noise, items):
        floor = _NOISE_FLOOR * np.mean([item.power().mean() for item in items])
        return np.maximum(noise, max(floor, 1e-300))

    def _try(self, tag, items):
        """Acquires one tag over a block of usable groups; returns whether it is there."""
        likelihood = tag.likelihood
        pairs = [likelihood.coefficients(item.tones, self._noise) for item in items]
        q = np.array([pair[0] for pair in pairs])
        energies = np.array([pair[1] for pair in pairs])
        times = np.array([item.center_s for item in items])
        subcarriers = len(self.bins)
        fit = acquire(
            times, q, energies, tag.rate, tag.clock.tolerance_ppm, subcarriers, likelihood
        )
        if not _believable(fit, q, len(likelihood.lines), subcarriers):
            tag.tracker = None
            return False
        tag.tracker = ClockTracker(
            likelihood, tag.rate, fit, len(items), self.group_period_s, subcarriers
        )
        for time, coefficients in zip(times, q, strict=True):
            tag.tracker.absorb(time, coefficients)
        tag.last_seen_s = times[-1]
        return True

    def _separate(self, item, fresh=True):
        if fresh and item.usable:
            self._follow(item)
        ends, gain, residual = self._solve(item)
        misfit = self._misfit(residual, item)
        if fresh and item.usable and not item.missing:
            self._learn_noise(residual / max(1.0, misfit / _UNUSUAL), item)
        # What does not fit is alike on all subcarriers, as noise is not.
        gain = gain * (1 + len(self.bins) * max(0.0, misfit - _NOTABLE))
        vectors = np.zeros((self.ends, 64), complex)
        vectors[:, self.bins] = ends
        clocks = tuple(self._clock_state(tag, item) for tag in self._tags)
        noise = np.ones(len(self.bins)) if self._noise is None else self._noise
        snr = self._snr_db(ends, gain, noise)
        return GroupState(item.group, item.missing, clocks, noise.copy(), gain, snr), vectors

    def _misfit(self, residual, item):
        """What the model leaves of a group over what noise would; 1 when all is well.

        A press that changes inside the group, on this sensor or another, does not fit the model
        and disturbs every end by about as much.
        """
        if self._noise is None or not item.usable:
            return 1.0
        return float(np.mean(residual / self._noise))

    def _clock_state(self, tag, item):
        seen = tag.tracker is not None and tag.last_seen_s >= item.center_s - 1e-9
        return tag.state(item.center_s) if seen and item.usable else ClockState(False)

    def _follow(self, item):
        if self._noise is None:
            self._noise = self._floored(item.power(), [item])
        for tag in self._tags:
            q, _ = tag.likelihood.coefficients(item.tones, self._noise)
            if tag.tracker is not None:
                if tag.tracker.update(item.center_s, q):
                    tag.last_seen_s = item.center_s
                elif item.center_s - tag.last_seen_s > _LOST_S:
                    tag.drop()
                continue
            tag.waiting.append(item)
            del tag.waiting[: -self.acquisition_groups]
            if len(tag.waiting) == self.acquisition_groups and self._try(tag, tag.waiting):
                tag.waiting = []

    def _solve(self, item):
        """Least squares over the locked tags; unlocked ends are zero with infinite gain."""
        locked = [tag for tag in self._tags if tag.tracker is not None]
        ends = np.zeros((self.ends, len(self.bins)), complex)
        gain = np.full(self.ends, np.inf)
        if not item.usable:
            return ends, gain, np.zeros(len(self.bins))
        white = item.whitener @ item.tones
        if not locked:
            return ends, gain, np.mean(np.abs(white) ** 2, axis=0)
        waveforms = np.hstack([tag.waveforms(item.times_s, item.center_s) for tag in locked])
        mixing = item.whitener @ (self._line_gain * (item.weights @ waveforms))
        rows = np.concatenate([[2 * tag.index, 2 * tag.index + 1] for tag in locked])
        gram = np.linalg.pinv(mixing.conj().T @ mixing, rcond=1e-9, hermitian=True)
        solution = gram @ (mixing.conj().T @ white)
        ends[rows] = solution
        # In units of the whole group: a perfect end would have 1/N.
        gain[rows] = np.diag(gram).real
        gain[gain * self.table.group_length > _WORST_GAIN] = np.inf
        left = white - mixing @ solution
        freedom = max(len(white) - len(rows), 1)
        return ends, gain, np.sum(np.abs(left) ** 2, axis=0) / freedom

    def _learn_noise(self, residual, item):
        self._noise_groups = min(self._noise_groups + 1, self._noise_memory)
        updated = self._noise + (residual - self._noise) / self._noise_groups
        self._noise = self._floored(updated, [item])

    def _snr_db(self, ends, gain, noise):
        with np.errstate(divide="ignore", invalid="ignore"):
            finite = np.where(np.isfinite(gain), gain, 0.0)
            power = np.mean(np.abs(ends) ** 2, axis=1) - finite * noise.mean()
            ratio = self._reference_gain * np.maximum(power, 0.0) / noise.mean()
            return np.where(np.isfinite(gain), 10 * np.log10(np.maximum(ratio, 1e-12)), np.nan)


@dataclass(frozen=True)
class _Group:
    group: int
    center_s: float
    tones: np.ndarray
    weights: np.ndarray
    whitener: np.ndarray
    times_s: np.ndarray
    missing: int
    usable: bool

    def power(self):
        """Mean power per tone and subcarrier in units of the noise in H; shape (K,)."""
        return np.mean(np.abs(self.whitener @ self.tones) ** 2, axis=0)


def _believable(fit, q, lines, subcarriers):
    """Whether a fit is a tag: more energy than noise explains, and groups that agree on it."""
    dimensions = subcarriers * len(q)
    explained = fit.energy / (2 * dimensions)
    rest = (fit.total - fit.energy) / ((lines - 2) * dimensions)
    spread = np.sqrt(2 * np.sum(np.abs(q[:, 1:]) ** 2))
    agreement = (fit.energy - np.sum(q[:, 0].real)) / max(spread, 1e-300)
    return explained > _ENERGY_RATIO * rest and agreement > _AGREEMENT
