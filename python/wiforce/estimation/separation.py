# SPDX-License-Identifier: GPL-3.0-or-later
"""Separation of the tags' ends: from a group's tones to one complex number per end and subcarrier.

Every group passes three steps: the tags' clocks are tracked (``clock_tracker``), the tones are
solved for the ends at those clocks (``least_squares``), and the residual gives the noise
(``noise``). Unknown clocks are acquired first (``clock_search``).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from ..signal.switching import harmonics
from ..signal.waveform import Waveform
from ..signal.weights import ToneTable
from .clock_search import ClockSearch
from .coherence import CoherentResidual
from .group_tones import GroupTones
from .groups import Array, Groups
from .least_squares import ToneModel
from .noise import STEP_GROUPS, NoiseEstimate, Verdict
from .tracked_tag import TagClock, TrackedTag

# A tag that was not received for this long is acquired again, because its clock may have restarted.
_LOST_S = 0.5
# Longest gap over which a clock is predicted: drifting by 0.5 ppm/s it may then be wrong by
# d t^2 / 2 = 0.1 cycles at 1 kHz.
_BRIDGED_S = 20.0
# Ratio of a group's residual to the noise above which it raises the stated uncertainty. The ratio
# of noise alone has a standard deviation of 3.4 % (14 x 62 degrees of freedom): 4.4 of them.
_SIGNIFICANT_RESIDUAL = 1.15


class EndSeparator:
    """Separates the tones of each group into the complex channels of the ends.

    Groups are held back until the clocks are acquired.

    Parameters
    ----------
    table : ToneTable
        Weights of the run.
    clocks : sequence of TagClock
        In the order in which the table was designed.
    waveform : Waveform
        As it was sent.
    derotated : bool
        Whether the tones are derotated (``ToneTable.derotation``).
    others : sequence of TagClock
        Tags that a survey has found, behind ``clocks`` in the table. They are tracked and solved
        for, but not given.

    Raises
    ------
    InputError
        When a tag's own lines do not determine its clock's phase, or its ends.

    Notes
    -----
    V = (M^H C^-1 M)^-1 M^H C^-1 P with the mixing matrix M at the tracked clocks
    (docs/estimation.md, step 3).

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> plan = wiforce.plan("demo")
    >>> separator = EndSeparator(plan.table, plan.clocks, plan.waveform)
    >>> rng = np.random.default_rng(1)  # noise, no tag
    >>> tones = rng.standard_normal((12, 24, 62)) + 1j * rng.standard_normal((12, 24, 62))
    >>> groups = separator.process(Groups(np.arange(12), tones))
    >>> groups.ends.shape, bool(groups.locked.any())
    ((12, 2, 62), False)
    """

    def __init__(
        self,
        table: ToneTable,
        clocks: Sequence[TagClock],
        waveform: Waveform,
        derotated: bool = True,
        others: Sequence[TagClock] = (),
    ) -> None:
        averaging_s = waveform.averaging_s
        every = enumerate((*clocks, *others))
        tags = [TrackedTag(table, i, clock, averaging_s) for i, clock in every]
        self._tags = len(clocks)
        self._model = ToneModel(table, tags, waveform.sample_rate_hz if derotated else None)
        self._noise = NoiseEstimate(self._model.group_period_s)
        self._coherence = CoherentResidual(2 * len(tags))
        self._search = ClockSearch(self._model, self._noise, averaging_s)
        # The SNR is defined by line 1 of end 1.
        self._line_power = harmonics(1, clocks[0].clock_hz * averaging_s)[0] ** 2
        self._held: list[Groups] = []
        self._latest: deque[GroupTones] = deque(maxlen=STEP_GROUPS)
        self._started = False

    def process(self, groups: Groups) -> Groups:
        """Take a batch; give the groups that are ready.

        Parameters
        ----------
        groups : Groups
            With ``tones``.

        Returns
        -------
        Groups
            With ``ends``, ``gain``, ``noise``, ``snr_db`` and the clocks, without ``tones``; empty
            while groups are held back for acquisition.
        """
        if self._started:
            return self._separate(groups)
        wanted = self._search.groups - sum(map(len, self._held))
        self._held.append(groups[:wanted])
        if len(groups) < wanted:
            return groups[:0]
        return Groups.concatenate([self.flush(), self._separate(groups[wanted:])])

    def flush(self) -> Groups:
        """Acquire the clocks in the groups held back, and give them all."""
        held, self._held = Groups.concatenate(self._held), []
        if not len(held):
            return held
        self._started = True
        self._search.run(self._model.prepare(held))
        return self._separate(held, update=False)

    def _separate(self, groups: Groups, update: bool = True) -> Groups:
        """Separate groups; ``update`` clocks and noise unless they were acquired from these."""
        if not len(groups):
            return groups
        count, tags = len(groups), self._model.tags
        subcarriers = groups.tones.shape[2]
        ends = np.zeros((count, 2 * len(tags), subcarriers), complex)
        gain = np.full((count, 2 * len(tags)), np.inf)
        white = gain.copy()
        noise = np.ones((count, subcarriers))
        raised = np.ones((count, subcarriers))
        clocks = np.zeros((5, count, len(tags)))
        disturbed = np.zeros((count, len(tags)), bool)
        for row, item in enumerate(self._model.prepare(groups)):
            if update and item.usable:
                self._track(item)
            ends[row], own_gain, residual, fit = self._model.solve(item)
            for i, tag in enumerate(tags):
                clocks[:, row, i] = _clock_of(tag, item)
            gain[row] = white[row] = own_gain
            if item.usable and self._noise.known:
                inverse = self._noise.inverse
                if fit is not None:
                    freedom = max(len(fit.residual) - len(fit.rows), 1)
                    raised[row] = self._noise.raised(residual, freedom)
                    inverse = inverse / raised[row]
                ratio = float(residual @ inverse) / subcarriers
                if fit is not None:
                    factor = self._coherence.update(fit, inverse)
                    if ratio > _SIGNIFICANT_RESIDUAL:
                        factor = np.maximum(factor, ratio)
                    gain[row, fit.rows] *= factor
                    disturbed[row] = self._coherence.disturbed.reshape(-1, 2).any(axis=1)
                if update and not item.missing:
                    self._learn(residual, ratio, item, raised[row])
            if self._noise.known:
                noise[row] = self._noise.variance
        locked, phase, offset_ppm, delay, overlapping = clocks[:, :, : self._tags]
        ends, gain, white = (each[:, : 2 * self._tags] for each in (ends, gain, white))
        lost = np.mean(1 - 1 / raised, axis=1)
        return groups.having(
            tones=None,
            snapshot_weights=None,
            ends=ends,
            gain=gain,
            noise=noise * raised,
            raised=raised,
            interference=groups.interference + (1 - groups.interference) * lost,
            snr_db=self._snr_db(ends, white, noise),
            locked=locked > 0,
            clock_phase=phase,
            clock_offset_ppm=offset_ppm,
            clock2_delay=delay,
            overlapping=overlapping > 0,
            disturbed=disturbed[:, : self._tags],
        )

    def _track(self, item: GroupTones) -> None:
        """Track every clock to a group, and search for tags whose clock is not known."""
        if not self._noise.known:
            self._noise.set(item.power(), [item])
        tags = self._model.tags
        jointly = self._search.jointly
        predicted = self._model.fit(item, jointly) if len(tags) > 1 or jointly else None
        measured = self._search.measure_phases(predicted) if jointly else {}
        for tag in tags:
            if tag.tracker is not None and item.center_s - tag.last_seen_s > _BRIDGED_S:
                tag.drop()
            if tag.tracker is None:
                self._search.retry(tag, item)
                continue
            tones = self._model.without_others(tag, item, predicted)
            inverse_noise, level = self._noise.inverse / item.weights.loss, self._noise.level
            error = measured.get(tag)
            if tag.tracker.update(item.center_s, tones, inverse_noise, level, error):
                tag.last_seen_s = item.center_s
            elif item.center_s - tag.last_seen_s > _LOST_S:
                tag.drop()

    def _learn(self, residual: Array, ratio: float, item: GroupTones, raised: Array) -> None:
        self._latest.append(item)
        if self._noise.learn(residual, ratio, item, raised) is Verdict.MODEL_LOST:
            # Clocks and noise are acquired again, from groups that all differ from the model.
            self._search.run(self._latest)
            self._coherence.reset()
            for tag in self._model.tags:
                tag.waiting = [] if tag.tracker else list(self._latest)

    def _snr_db(self, ends: Array, gain: Array, noise: Array) -> Array:
        level = noise.mean(axis=1)[:, None]
        with np.errstate(invalid="ignore"):
            power = np.mean(ends.real**2 + ends.imag**2, axis=2) - gain * level
            ratio = np.maximum(self._line_power * power / level, 1e-12)
        return np.where(np.isfinite(gain), 10 * np.log10(ratio), np.nan)


def _clock_of(tag: TrackedTag, item: GroupTones) -> tuple[float, float, float, float, float]:
    """Locked, phase, offset in ppm, delay of clock 2, and whether the switches overlap."""
    received = tag.last_seen_s >= item.center_s - 1e-9
    if tag.tracker is None or not (received and item.usable):
        return 0.0, 0.0, 0.0, 0.0, 0.0
    phase, rate = tag.tracker.predict(item.center_s)
    stated = 2 * np.pi * tag.clock.stated_hz
    ppm = 1e6 * (tag.rate - stated + rate) / stated
    return 1.0, phase % (2 * np.pi), ppm, tag.clock2_delay, float(tag.overlapping)
