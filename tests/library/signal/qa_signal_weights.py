# SPDX-License-Identifier: GPL-3.0-or-later
"""Weights that extract the tags' tones from a group, against least squares."""

import re

import numpy as np
import pytest
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.signal.lines import clutter_basis, tag_lines
from gnuradio.wiforce.signal.weights import design_weights
from plain import T, normal

# Weights are rounded to single precision (24 bits): relative error of a sum about 1e-7.
SINGLE = 3e-7


def plain_model(table, clutter_hz):
    """Lines about the group's centre, then clutter, one column at a time."""
    n = np.arange(table.group_length)
    middle = (table.group_length - 1) / 2
    columns = [np.exp(2j * np.pi * t.frequency_hz * T * (n - middle)) for t in table.tones]
    columns += list(clutter_basis(table.group_length, T, clutter_hz).T)
    return np.stack(columns, axis=1)


@pytest.mark.parametrize(
    "clocks, length, clutter, harmonics",
    [
        ((1000,), 625, 0, 8),
        ((1000,), 125, 60, 8),
        ((1000, 1400), 625, 250, 16),
        ((1790,), 63, 0, 4),
    ],
)
def test_weights_applied_give_least_squares_solution(clocks, length, clutter, harmonics):
    table = design_weights(clocks, length, T, clutter, harmonics)
    snapshots = normal(np.random.default_rng(1), length, 5)
    solution = [
        np.linalg.lstsq(plain_model(table, clutter), column, rcond=1e-12)[0]
        for column in snapshots.T
    ]
    expected = np.array(solution).T[: len(table.tones)]
    # Worst noise gain of these tables is 30: errors of the weights grow alike.
    assert np.max(np.abs(table.weights @ snapshots - expected)) < 30 * SINGLE


@pytest.mark.parametrize("doppler_hz", [0.0, 7.3, -31.0, 120.0, 249.0])
def test_weights_clutter_in_band_is_rejected(doppler_hz):
    table = design_weights([1000.0], 625, T, 250.0)
    path = np.exp(2j * np.pi * doppler_hz * table.times_s)
    # -118 dB at the band's edge, less inside; a plain DFT leaks -41 dB.
    assert np.max(np.abs(table.weights @ path)) < 10 ** (-115 / 20)


@pytest.mark.parametrize("length, cost_db", [(625, 0.07), (250, 0.31), (125, 0.93)])
def test_weights_clutter_band_costs_line_1_stated_noise(length, cost_db):
    table = design_weights([1000.0], length, T, 250.0)
    gain = np.sum(np.abs(table.weights) ** 2, axis=1) * length
    lines = [tone.owners[0][1] for tone in table.tones]
    assert 10 * np.log10(gain[lines.index(1)]) == pytest.approx(cost_db, abs=0.02)
    assert 10 * np.log10(gain[lines.index(4)]) < 0.1


@pytest.mark.parametrize("length, hertz", [(625, 30.0), (63, 5.0), (40, 0.01)])
def test_clutter_basis_holds_sequences_of_scipy(length, hertz):
    basis = clutter_basis(length, T, hertz)
    half_bandwidth = max(hertz * length * T, 0.1)
    # SciPy's signal package takes long to import, and all workers collect this file.
    from scipy.signal.windows import dpss

    expected = dpss(length, half_bandwidth, basis.shape[1]).T
    signs = np.sign(np.sum(basis * expected, axis=0))
    assert np.allclose(basis * signs, expected, atol=1e-9)


def test_tag_lines_shared_by_two_tags_are_one_tone():
    tones = tag_lines([1000.0, 1400.0], T, 625)
    shared = {t.frequency_hz: t.owners for t in tones if len(t.owners) > 1}
    assert shared == {7000.0: ((0, 7), (1, 5)), -7000.0: ((0, -7), (1, -5))}


@pytest.mark.parametrize("clutter_hz", [0.0, 60.0])
@pytest.mark.parametrize("pattern", ["snapshots", "bursts", "gap"])
def test_for_present_equals_pseudo_inverse_and_rejects_strong_static_path(pattern, clutter_hz):
    """With bursts of Wi-Fi nearby, every group is solved in this way, under any static path."""
    rng = np.random.default_rng(6)
    table = design_weights([1000.0, 1400.0], 625, T, clutter_hz)
    mask = {
        "snapshots": rng.random(625) > 0.6,
        "bursts": np.repeat(rng.random(25) > 0.5, 25),
        "gap": np.abs(np.arange(625) - 312) > 150,
    }[pattern]
    partial = table.for_present(mask)
    exact = np.linalg.pinv(table.basis[mask], rcond=1e-12)[: len(table.tones)]
    gain, least = (np.sum(np.abs(w) ** 2) for w in (partial.weights, exact))
    assert gain == pytest.approx(least, rel=1e-9)
    assert np.max(np.abs(partial.weights - exact)) < 1e-8 * np.max(np.abs(exact))
    static = np.full(mask.sum(), 10 ** (80 / 20))
    # The clutter basis itself holds a constant to -160 dB.
    assert np.max(np.abs(partial.weights @ static)) < (1e-5 if clutter_hz else 1e-10)
    snapshots = normal(rng, int(mask.sum()), 64)
    np.testing.assert_allclose(partial.apply(snapshots), partial.weights @ snapshots, atol=1e-12)
    white = partial.whitener @ partial.parts
    assert np.max(np.abs(white @ white.T - np.eye(len(white)))) < 1e-9
    assert np.array_equal(partial.times_s, table.times_s[mask])


@pytest.mark.parametrize("present", [0, 10, 25])
def test_for_present_too_few_snapshots_returns_none(present):
    table = design_weights([1000.0], 625, T, 60.0)
    assert table.for_present(np.arange(625) < present) is None


@pytest.mark.parametrize(
    "arguments, message",
    [
        (([2200.0], 625, T), "clocks_hz[0]: must be above 0, and 4 times it below half the"),
        (([-5.0], 625, T), "clocks_hz[0]"),
        (([1.035], 625, T), "clocks_hz[0]: must exceed 20.8 Hz for groups of 625 snapshots"),
        (([1000.0], 625, T, 990.0), "clutter_hz: must lie more than 20.8 Hz below every clock"),
        (([1000.0], 625, T, 0.0, 3), "harmonics: must be at least 4, got 3"),
        (([1000.0], 15, T), "group_length: must exceed the 15 lines"),
        (([1000.0], 48, T, 200.0), "group_length: is too short to separate"),
        # 8 x 390 Hz is the rate of 3125 Hz within the resolution: line 5 falls on line -3 ...
        (([390.0], 125, 320e-6), "clocks_hz[0]: must leave the tag a line"),
    ],
)
def test_design_weights_unreadable_setting_names_parameter(arguments, message):
    with pytest.raises(InputError, match=re.escape(message)):
        design_weights(*arguments)


@pytest.mark.parametrize("error", [np.linalg.LinAlgError, SystemError])
def test_partial_weights_do_not_depend_on_the_svd_that_lapack_gives_up(monkeypatch, error):
    """A live reader ended because LAPACK failed for one group."""
    table = design_weights([1000.0], 625, T, 30.0)
    mask = np.arange(625) < 600
    expected = table.for_present(mask).weights

    def give_up(*_, **__):
        raise error("SVD did not converge")

    def no_factor(_):
        raise np.linalg.LinAlgError("Matrix is not positive definite")

    monkeypatch.setattr(np.linalg, "cholesky", no_factor)
    monkeypatch.setattr(np.linalg, "pinv", give_up)
    found = table.for_present(mask).weights
    assert np.allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
