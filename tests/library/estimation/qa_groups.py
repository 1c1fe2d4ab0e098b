# SPDX-License-Identifier: GPL-3.0-or-later
"""Groups: batches of phase groups, cut and put together without losing what is known of them."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.groups import Groups


def batch(first, count, **arrays):
    """Groups with consecutive indices whose tones tell which they are."""
    index = np.arange(first, first + count)
    tones = index[:, None, None] * np.ones((1, 4, 3), complex)
    return Groups(index, tones, **arrays)


def test_groups_concatenated_are_the_groups_that_were_cut():
    weights = np.random.default_rng(1).random((6, 5)) > 0.5
    whole = batch(0, 6, missing=np.arange(6), snapshot_weights=weights)
    joined = Groups.concatenate([whole[:1], whole[1:4], whole[4:4], whole[4:]])
    for name in ("index", "tones", "missing", "saturated", "retuned", "snapshot_weights"):
        assert np.array_equal(getattr(joined, name), getattr(whole, name))
    assert joined.ends is None


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_groups_concatenated_complete_groups_weigh_every_snapshot(order):
    """An incomplete group in one batch must not make those of another incomplete."""
    mask = np.array([[True, False, True, True, False]])
    parts = [batch(0, 2), batch(2, 1, missing=np.array([2]), snapshot_weights=mask)]
    joined = Groups.concatenate(parts[i] for i in order)
    incomplete = joined.missing > 0
    assert joined.snapshot_weights.shape == (3, 5)
    assert joined.snapshot_weights[~incomplete].all()
    assert np.array_equal(joined.snapshot_weights[incomplete], mask)


def test_groups_are_incomplete_without_snapshots_for_any_reason():
    """Tones of a part of the snapshots must not be whitened as those of all."""
    weights = np.ones((4, 5))
    weights[3, 2] = 0
    rows = {"missing": np.array([1, 0, 0, 0]), "interference": np.array([0, 0.2, 0, 0])}
    groups = batch(0, 4, snapshot_weights=weights, **rows)
    assert groups.incomplete.tolist() == [True, True, False, True]
    assert not batch(0, 2).incomplete.any()


def test_groups_concatenated_empty_batches_are_omitted():
    """They come from stages that hold groups back, before anything is known."""
    empty, known = Groups(np.zeros(0, int)), batch(0, 2, ratios=np.ones((2, 2), complex))
    joined = Groups.concatenate([empty, known, empty, known[:1]])
    assert joined.ratios.shape == (3, 2)
    assert len(Groups.concatenate([empty, empty])) == len(Groups.concatenate([])) == 0
