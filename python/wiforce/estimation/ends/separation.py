# SPDX-License-Identifier: GPL-3.0-or-later
"""Separation of the tags' ends: from a group's tones to one complex number per end and subcarrier.

A kernel (``end_separation.h``) takes one group after the other: it corrects the tags' clocks,
solves the tones for the ends at those clocks, learns the noise from the residual, and raises the
gain of ends whose own channel the residual holds. Unknown clocks are acquired first
(``clock_search``).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from ...signal.switching import harmonics
from ...signal.waveform import Waveform
from ...signal.weights import ToneTable
from ...wiforce_kernels import STEP_GROUPS, end_separation, noise_estimate
from ..clocks.clock_search import ClockSearch
from ..clocks.tracked_tag import TagClock, TrackedTag
from ..groups import Array, Groups, GroupTones
from .least_squares import ToneModel, spread_lines_of

# Error of a phase, in rad, that noise does not explain: 0.003 deg (1024 and 4096 samples, SNR
# 60 dB, symbol of 0.05 of the tag's period; tests/models/waveform_captures.py).
_LEAST_ERROR = 6e-5


class EndSeparator:
    """Separates the tones of each group into the complex channels of the ends.

    V = (M^H C^-1 M)^-1 M^H C^-1 P with the mixing matrix M at the tracked clocks (docs/theory.md,
    Ends). ``table`` was designed for ``clocks``, then ``others``, which a survey has found: these
    are solved for, but not given. InputError where a tag's own lines do not determine clock or
    ends.
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
        rate_hz = waveform.sample_rate_hz if derotated and waveform.is_derotated else None
        # Of channels that another device measured, only the residual tells the noise.
        is_long = derotated and not waveform.is_derotated
        spread = spread_lines_of(waveform, table) if derotated else None
        self._model = ToneModel(table, tags, rate_hz, waveform.symbol_length, spread)
        profile = waveform.noise_profile if is_long else None
        self._noise = noise_estimate(self._model.group_period_s, profile)
        self._search = ClockSearch(self._model, self._noise, averaging_s)
        self._kernel = end_separation(
            len(tags),
            table.group_length,
            averaging_s,
            self._search.jointly,
            # The SNR is defined by line 1 of end 1.
            harmonics(1, clocks[0].clock_hz * averaging_s)[0] ** 2,
            _LEAST_ERROR if is_long else 0.0,
            *self._search.limits_s,
        )
        self._held: list[Groups] = []
        # The latest groups that the noise was learned from: a run, and the row in it.
        self._latest: deque[tuple[GroupTones, int]] = deque(maxlen=STEP_GROUPS)
        self._started = False
        self._slipped = False  # before the next usable group

    @property
    def acquisition_groups(self) -> int:
        """Number of groups that are held back until the clocks are acquired."""
        return self._search.groups

    def process(self, groups: Groups) -> Groups:
        """Replace ``tones`` by ends, noise and clocks; empty while groups are held back."""
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
        groups, usable = self._model.prepare(held)
        for first in held.index[held.slipped].tolist():
            self._find_slip(groups[np.flatnonzero(usable)], first)
            groups, usable = self._model.prepare(held)
        self._search.run(groups[np.flatnonzero(usable)])
        return self._separate(held, update=False)

    def _find_slip(self, groups: GroupTones, first: int) -> None:
        """Correct the times from a group on, before the clocks are known."""
        behind = groups.group >= first
        self._slipped |= not behind.any()
        if behind.any() and not behind.all():
            self._model.slips.append((first, self._search.late_s(groups, first)))

    def _separate(self, groups: Groups, update: bool = True) -> Groups:
        """Separate groups; ``update`` clocks and noise unless they were acquired from these."""
        if not len(groups):
            return groups
        tones, usable = self._model.prepare(groups)
        parts: list[dict[str, Array]] = []
        count, first = len(tones), 0
        slips = groups.slipped.tolist() if update else [False] * count
        while first < count:
            self._slipped |= slips[first]
            if self._slipped and usable[first] and update:
                late_s = self._search.late_by_clocks_s(tones[first : first + 1])
                self._model.slips.append((int(tones.group[first]), late_s))
                tones.center_s[first:] += late_s
                self._slipped = False
            # A run of groups that are all usable, or of which none is, up to a slip.
            stop = first + 1
            while stop < count and usable[stop] == usable[first] and not slips[stop]:
                stop += 1
            run = tones[first:stop]
            part = self._separate_run(run, update) if usable[first] else self._without_ends(run)
            parts.append(part)
            first += len(part["gain"])
        arrays = parts[0]
        if len(parts) > 1:
            arrays = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
        if self._tags < len(self._model.tags):
            # Tags found by a survey are solved for, but not given.
            for name in arrays.keys() - {"noise", "noise_rise", "raised"}:
                each = 2 if name in ("ends", "gain", "snr_db") else 1
                arrays[name] = arrays[name][:, : each * self._tags]
        raised = arrays.pop("raised")
        arrays["interference"] = groups.interference + (1 - groups.interference) * raised
        return groups.having(tones=None, snapshot_weights=None, timed=None, **arrays)

    def _separate_run(self, groups: GroupTones, update: bool) -> dict[str, Array]:
        """Separate the first of some usable groups: as many as have the same tags and noise."""
        if not self._noise.known:
            if not update:
                return self._without_ends(groups)
            first = groups[:1]
            self._noise.set(first.power()[0], float(first.level[0]))
        if update:
            groups = self._search.renew(groups)
            if self._search.timed:
                groups = groups[:1]
                self._search.follow(groups)
        complete = [missing == 0 for missing in groups.missing.tolist()]
        arrays = self._model.separate(self._kernel, groups, complete, self._noise, update)
        if update:
            learned = [row for row in range(len(arrays["gain"])) if complete[row]]
            self._latest += [(groups, row) for row in learned[-STEP_GROUPS:]]
        if arrays.pop("lost"):
            self._search_again()
            arrays["noise"][-1] = self._noise.variance * arrays["noise_rise"][-1]
        return arrays

    def _without_ends(self, groups: GroupTones) -> dict[str, Array]:
        """Separate groups whose tones cannot be used."""
        (count, _, subcarriers), ends = groups.tones.shape, 2 * len(self._model.tags)
        nothing = np.zeros((count, len(self._model.tags)))
        noise = self._noise.variance if self._noise.known else np.ones(subcarriers)
        return {
            "locked": nothing > 0,
            "clock_phase": nothing,
            "clock_offset_ppm": nothing,
            "clock2_delay": nothing,
            "overlapping": nothing > 0,
            "ends": np.zeros((count, ends, subcarriers), complex),
            "gain": np.full((count, ends), np.inf),
            "noise": np.tile(noise, (count, 1)),
            "noise_rise": np.ones((count, subcarriers)),
            "raised": np.zeros(count),
            "snr_db": np.full((count, ends), np.nan),
            "disturbed": nothing > 0,
        }

    def _search_again(self) -> None:
        """Acquire clocks and noise again, from groups that all differ from the model."""
        latest = [groups[row : row + 1] for groups, row in self._latest]
        self._search.run(GroupTones.concatenate(latest))
        self._kernel.reset()
        for tag in self._model.tags:
            tag.waiting = [] if tag.tracker else list(latest)
