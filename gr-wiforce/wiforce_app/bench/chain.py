# SPDX-License-Identifier: GPL-3.0-or-later
"""The reader's estimation without its blocks: channel snapshots in, ratios R out."""

import numpy as np
from gnuradio.wiforce.estimation.average import SubcarrierAverage
from gnuradio.wiforce.estimation.estimators import RatioUnfolder, estimator_named
from gnuradio.wiforce.estimation.reference import ConjugateDifference


class SnapshotChain:
    """What a reader of the same plan computes after its channel estimator.

    Parameters
    ----------
    plan : planning.plan.Plan
    derotated : bool
        Whether tones that are given were stopped from turning within a symbol.
    """

    def __init__(self, plan, derotated=False):
        waveform = plan.waveform
        self.table, self._bins = plan.table, waveform.bins
        upper = self.table.weights[len(self.table.tones) // 2 :]
        self._upper = np.concatenate([upper.real, upper.imag])
        estimator, ends = estimator_named(plan.estimator), 2 * len(plan.clocks)
        self.separator = estimator.separator(
            plan.table,
            plan.clocks,
            waveform.averaging_s,
            waveform.bins,
            waveform.sample_rate_hz if derotated else None,
        )
        self.difference = ConjugateDifference(
            ends, waveform.bins, plan.reference_groups, estimator.against
        )
        self.average = SubcarrierAverage(waveform.bins, plan.smoothing_groups)
        self.unfolder = RatioUnfolder(estimator.ratios, ends)

    def process(self, group, snapshots, present=None):
        """Takes H (N, K) of one group; gives (GroupState, R (2S,)) of the groups that are ready.

        ``present`` (N,) bool says which snapshots there are.
        """
        missing, partial = 0, None
        tones = np.zeros((len(self.table.tones), 64), complex)
        if present is None or np.all(present):
            tones[:, self._bins] = self._whole_group(snapshots)
        else:
            missing = int(np.sum(~present))
            partial = self.table.for_present(present)
            if partial is not None:
                tones[:, self._bins] = partial.weights @ snapshots[present]
        return self._onward(self.separator.process(group, tones, missing, partial))

    def process_tones(self, group, tones):
        """As `process`, of a whole group's tones (M, 64)."""
        return self._onward(self.separator.process(group, tones))

    def _whole_group(self, snapshots):
        """Tones by the table's weights, those of -m from the same sums as those of +m."""
        half = len(self._upper) // 2
        sums = self._upper @ np.ascontiguousarray(snapshots).view(float)
        real, imaginary = sums[:half].view(complex), 1j * sums[half:].view(complex)
        return np.concatenate([(real - imaginary)[::-1], real + imaginary])

    def flush(self):
        """Gives the groups still held back."""
        ready = self._onward(self.separator.flush())
        return ready + [self._finish(*item) for item in self.difference.flush()]

    def _onward(self, separated):
        return [
            self._finish(*item)
            for state, vectors in separated
            for item in self.difference.process(state, vectors)
        ]

    def _finish(self, state, vectors):
        return self.unfolder.process(*self.average.process(state, vectors))
