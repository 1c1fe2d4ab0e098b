# SPDX-License-Identifier: GPL-3.0-or-later
"""Batches of phase groups: which of them lack snapshots."""

import numpy as np
from gnuradio.wiforce.estimation.groups import Groups


def test_groups_are_incomplete_without_snapshots_for_any_reason():
    """Tones of a part of the snapshots must not be whitened as those of all."""
    weights = np.ones((4, 5))
    weights[3, 2] = 0
    rows = {"missing": np.array([1, 0, 0, 0]), "interference": np.array([0, 0.2, 0, 0])}
    groups = Groups(np.arange(4), snapshot_weights=weights, **rows)
    assert groups.incomplete.tolist() == [True, True, False, True]
    assert not Groups(np.arange(2)).incomplete.any()
