# SPDX-License-Identifier: GPL-3.0-or-later
"""phase_group_doppler against a plain matrix product in double precision."""

import numpy as np
import pmt
import pytest
from device_times import tag_at
from gnuradio import wiforce
from press_capture import Run, array_source


def run_over(snapshots, doppler, indices=None, chunk=None):
    """A run over snapshots with these indices, and P (groups, M, 64)."""
    indices = np.arange(len(snapshots)) if indices is None else np.asarray(indices)
    jumps = [n for n in range(len(indices)) if n == 0 or indices[n] != indices[n - 1] + 1]
    tags = [tag_at(n, "snapshot", pmt.from_uint64(int(indices[n]))) for n in jumps]
    run = Run(array_source(np.asarray(snapshots, np.complex64), tags, chunk), doppler)
    return run, run.items.reshape(-1, doppler.rows(), 64)


@pytest.mark.parametrize("key", ["snapshot", "slipped", "noise", "saturated", "retuned"])
@pytest.mark.parametrize(
    "value", [pmt.PMT_NIL, pmt.intern("x"), pmt.from_long(-1), pmt.init_u64vector(1, [3])], ids=str
)
def test_tags_of_another_type_than_ours_are_ignored(key, value):
    """A block of somebody else that makes a tag of this name ended the flowgraph."""
    snapshots, doppler = random_complex(100, 64), wiforce.phase_group_doppler(TABLES["any"], 50)
    tags = [tag_at(0, "snapshot", pmt.from_uint64(0)), tag_at(7, key, value)]
    run = Run(array_source(snapshots.astype(np.complex64), tags), doppler)
    assert run.tags["group"] == {0: 0, 1: 1} and "slipped" not in run.tags


def tones(snapshots, weights):
    """sum_n w[m, n] h[n, k] of every whole group, in double precision."""
    group_length = weights.shape[1]
    whole = len(snapshots) // group_length * group_length
    return weights @ np.asarray(snapshots[:whole], complex).reshape(-1, group_length, 64)


def random_complex(*shape, seed=1):
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


def tone_weights(group_length, harmonics):
    """Least-squares weights of tones beside a constant: rows sum to zero."""
    n = np.arange(group_length)
    tones = np.exp(2j * np.pi * np.outer(n, harmonics) * 0.0576)
    return np.linalg.pinv(np.column_stack([tones, np.ones(group_length)]))[: len(harmonics)]


def test_tag_static_is_the_mean_of_the_snapshots_that_are_there():
    """Without it a chain held steps of the receiver for presses, as no tone shows them."""
    snapshots = random_complex(100, 64)
    kept = np.delete(np.arange(100), [60, 61, 75])
    doppler = wiforce.phase_group_doppler(random_complex(2, 50, seed=2), 50)
    run, _ = run_over(snapshots[kept], doppler, kept)
    wanted = [snapshots[:50].mean(axis=0), snapshots[kept[50:]].mean(axis=0)]
    # Items have single precision.
    assert np.allclose([*run.tags["static"].values()], wanted, rtol=0, atol=1e-6)


TABLES = {
    "any": random_complex(5, 50),
    "one row": random_complex(1, 50),
    "real rows": random_complex(3, 50).real + 0j,
    "conjugate pairs": tone_weights(50, [1, 2, 3, 4, -1, -2, -3, -4]),
    "pairs and singles": tone_weights(50, [0.5, 1, -1, 2.5, 4]),
    "a row twice": np.repeat(random_complex(1, 50), 2, 0),
    "zeros": np.zeros((1, 50)),
}


@pytest.mark.parametrize("chunk", [None, 7])
@pytest.mark.parametrize("table", TABLES)
def test_tones_are_the_weighted_sums_whatever_the_table_and_packet_size(table, chunk):
    snapshots, weights = random_complex(4 * 50 + 13, 64, seed=2), TABLES[table]
    doppler = wiforce.phase_group_doppler(weights, 50)
    run, found = run_over(snapshots, doppler, chunk=chunk)
    want = tones(snapshots.astype(np.complex64), weights)
    assert found.shape == want.shape == (4, len(weights), 64)
    np.testing.assert_allclose(found, want, atol=1e-6 * np.abs(want).max())
    assert run.tags["group"] == {0: 0, 1: 1, 2: 2, 3: 3}
    assert "missing" not in run.tags and run.incomplete == []
    assert (doppler.groups(), doppler.incomplete_groups()) == (4, 0)


@pytest.mark.parametrize("clutter_db", [None, 60])
def test_accuracy_holds_beside_static_clutter(clutter_db):
    """Tones within 1e-5 of the largest without clutter; -90 dB of the tag beside +60 dB."""
    group_length, harmonics = 625, [m for k in range(1, 9) for m in (k, -k)]
    n = np.arange(2 * group_length)
    tag = np.exp(2j * np.pi * 0.0576 * n)[:, None] * np.exp(1j * np.arange(64))
    snapshots = tag + 1e-2 * random_complex(len(n), 64)
    if clutter_db is not None:
        snapshots = snapshots + 10 ** (clutter_db / 20) * np.exp(0.3j * np.arange(64))
    items = snapshots.astype(np.complex64)  # the block's accuracy, not that of its input
    weights = tone_weights(group_length, harmonics)
    _, found = run_over(items, wiforce.phase_group_doppler(weights, group_length))
    want = tones(items, weights)
    error = np.abs(found - want).max() / np.abs(want).max()
    assert error < (1e-5 if clutter_db is None else 10 ** (-90 / 20))


@pytest.mark.parametrize("mode", ["real rows", "pairs and singles", "spectrum"])
def test_incomplete_groups_are_announced_and_their_snapshots_given(mode):
    length = 50
    if mode in TABLES:
        weights = TABLES[mode]
        doppler = wiforce.phase_group_doppler(weights, length)
    else:
        weights = np.exp(-2j * np.pi * np.outer(np.arange(length), np.arange(length)) / length)
        weights /= length
        doppler = wiforce.phase_group_doppler.spectrum(length)
    # Group 0: its first ones and one inside; group 2 from its middle to the end; group 3
    # wholly; group 4: more than a block of sums; group 5: values that are not finite, the
    # first one too.
    present = np.ones(6 * length, bool)
    present[[0, 1, 2, 30, *range(2 * 50 + 25, 4 * 50 + 35)]] = False
    kept = np.flatnonzero(present)
    snapshots = random_complex(len(present), 64, seed=5)
    sent = snapshots.copy()
    sent[[250, 260, 299], 17] = np.nan, np.inf, -np.inf * 1j
    run, found = run_over(sent[kept], doppler, kept, chunk=40)
    present[[250, 260, 299]] = False
    snapshots[~present] = 0
    want = tones(snapshots.astype(np.complex64), weights)
    emitted = [0, 1, 2, 4, 5]
    np.testing.assert_allclose(found, want[emitted], atol=1e-6 * np.abs(want).max())
    groups = run.tags["group"]
    assert list(groups.values()) == emitted
    counts = {0: 4, 2: 25, 4: 35, 5: 3}
    assert {groups[offset]: n for offset, n in run.tags["missing"].items()} == counts
    assert [group for group, _, _ in run.incomplete] == list(counts)
    for group, mask, items in run.incomplete:
        part = slice(group * length, (group + 1) * length)
        np.testing.assert_array_equal(mask, present[part])
        np.testing.assert_array_equal(items, snapshots[part].astype(np.complex64))
    assert doppler.incomplete_groups() == 4


@pytest.mark.parametrize(
    ("indices", "groups", "missing"),
    [
        (range(130, 250), [2, 3, 4], {0: 30}),
        ([*range(0, 30), *range(20, 70)], [0, 0], {0: 20, 1: 20}),
    ],
    ids=["first snapshot is late", "index goes back"],
)
def test_groups_follow_the_grid_of_the_indices(indices, groups, missing):
    snapshots, weights = random_complex(len(indices), 64), TABLES["any"]
    run, found = run_over(snapshots, wiforce.phase_group_doppler(weights, 50), indices)
    assert list(run.tags["group"].values()) == groups and run.tags["missing"] == missing
    if len(groups) == 3:
        np.testing.assert_allclose(found[1:], tones(snapshots[20:], weights), atol=1e-4)
