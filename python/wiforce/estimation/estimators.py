# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimators that a scene can select, and the settings that each of them implies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..signal.waveform import PacketWaveform, Waveform
from ..signal.weights import ToneTable
from .clocks.tracked_tag import TagClock
from .ends.paper import LineSeparator
from .ends.separation import EndSeparator
from .groups import Array, Groups
from .phases.reference import ConjugateDifference


class Estimator(NamedTuple):
    """How the ends' phases are estimated."""

    # Makes the stage from tones to the ends' channels.
    separator: Callable[..., EndSeparator | LineSeparator]
    # Tones are plain Fourier sums over the group instead of the scene's weights.
    rectangular: bool = False
    against: str = "untouched"  # the reference: the ``untouched`` sensor or the ``previous`` group
    # The ``change`` against the untouched sensor, a ``step`` from group to group, or a ``square``
    # of the change.
    ratios: str = "change"

    def separation(
        self,
        table: ToneTable,
        clocks: Sequence[TagClock],
        waveform: Waveform,
        derotated: bool,
        others: Sequence[TagClock] = (),
    ) -> EndSeparator | LineSeparator:
        """Make the stage that separates the ends; only :class:`.EndSeparator` knows ``others``."""
        more = {"others": others} if others else {}
        return self.separator(table, clocks, waveform, derotated, **more)

    def difference(
        self, tags: int, reference_groups: int, waveform: Waveform
    ) -> ConjugateDifference:
        """Make the stage that compares the ends of S tags with their reference."""
        # The channels of packets are ratios of antennas, which no few delays describe.
        if isinstance(waveform, PacketWaveform):
            return ConjugateDifference(2 * tags, reference_groups, self.against)
        linear = self.against == "untouched" and self.ratios == "change"
        return ConjugateDifference(
            2 * tags, reference_groups, self.against, waveform if linear else None
        )


ESTIMATORS = {
    "harmonic": Estimator(EndSeparator),
    "sideband": Estimator(partial(LineSeparator, squared=True), ratios="square"),
    "paper": Estimator(LineSeparator, rectangular=True, against="previous", ratios="step"),
}


def estimator_named(name: str) -> Estimator:
    """Look up one of ``ESTIMATORS``; an InputError names the others."""
    if name not in ESTIMATORS:
        raise InputError("estimator", f"must be one of {', '.join(ESTIMATORS)}", name)
    return ESTIMATORS[name]


class RatioUnfolder:
    """Converts the ratios of any estimator to changes against the untouched sensor.

    Steps are accumulated. Of the two roots of a square the one nearer to the previous group is
    taken. Steps contain no magnitude, which becomes 1.
    """

    def __init__(self, ratios: str) -> None:
        if ratios not in ("change", "step", "square"):
            raise InputError("ratios", "must be 'change', 'step' or 'square'", ratios)
        self._ratios = ratios
        self._last: Array | None = None

    def process(self, groups: Groups) -> Groups:
        """Convert the ratios of a batch, their variances and standard deviations."""
        if self._ratios == "change" or not len(groups):
            return groups
        received = np.isfinite(groups.phase_std_deg) & (np.abs(groups.ratios) > 0)
        unfolded = np.empty_like(groups.ratios)
        for row, restarts in enumerate(groups.new_reference.tolist()):
            if restarts or self._last is None:  # the group counts as untouched
                self._last = np.ones(groups.ratios.shape[1], complex)
            unfold = self._add_step if self._ratios == "step" else self._take_root
            unfolded[row] = unfold(groups.ratios[row], received[row], self._last)
        folds = 2 if self._ratios == "square" else 1
        return groups.having(ratios=unfolded, phase_std_deg=groups.phase_std_deg / folds)

    def _add_step(self, ratios: Array, received: Array, last: Array) -> Array:
        steps = np.where(received, ratios, 1.0)
        self._last = last * steps / np.abs(steps)
        return np.where(received, self._last, 0.0)

    def _take_root(self, ratios: Array, received: Array, last: Array) -> Array:
        roots = np.sqrt(np.asarray(ratios, complex))
        roots = np.where((roots * last.conj()).real < 0, -roots, roots)
        self._last = np.where(received, roots, last)
        return roots
