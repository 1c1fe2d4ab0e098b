# SPDX-License-Identifier: GPL-3.0-or-later
"""The receiver's stages on channel snapshots that come from no capture."""

import numpy as np
from gnuradio.wiforce.estimation.estimators import RatioUnfolder, estimator_named
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.estimation.phases.average import SubcarrierAverage
from gnuradio.wiforce.signal.weights import tones_of


class SnapshotChain:
    """Snapshots of the channel in, ratios R out: the receiver without samples and sensors.

    ``derotated``: whether tones that are given were stopped from turning within a symbol.
    """

    def __init__(self, plan, derotated=False):
        self.table = plan.table
        estimator = estimator_named(plan.estimator)
        self.separator = estimator.separation(
            plan.table, plan.clocks, plan.waveform, derotated, plan.others
        )
        self.difference = estimator.difference(
            len(plan.clocks), plan.reference_groups, plan.waveform
        )
        self.average = SubcarrierAverage()
        self.unfolder = RatioUnfolder(estimator.ratios)

    def process(self, index, snapshots, present=None):
        """Take H (N, K) of one group; give the Groups that are ready, with ``ratios``.

        ``present`` (N,) bool says which snapshots there are.
        """
        if present is None or np.all(present):
            return self.process_tones(
                Groups([index], tones_of(self.table.weights, snapshots)[None])
            )
        partial = self.table.for_present(present)
        tones = np.zeros((len(self.table.tones), snapshots.shape[1]), complex)
        if partial is not None:
            tones = partial.apply(snapshots[present])
        missing = np.array([np.sum(~present)])
        return self.process_tones(
            Groups([index], tones[None], missing, snapshot_weights=present[None])
        )

    def process_tones(self, groups):
        """As `process`, of a batch with tones (G, M, K)."""
        return self._onward(self.separator.process(groups))

    def flush(self):
        """Give the groups still held back."""
        ready = self._onward(self.separator.flush())
        return Groups.concatenate([ready, self._finish(self.difference.flush())])

    def _onward(self, groups):
        return self._finish(self.difference.process(groups))

    def _finish(self, groups):
        return self.unfolder.process(self.average.process(groups))
