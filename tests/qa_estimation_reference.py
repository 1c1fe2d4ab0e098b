# SPDX-License-Identifier: GPL-3.0-or-later
"""What an end's channel is compared with, and the average over subcarriers and groups."""

import numpy as np
import pytest
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.average import AdaptiveAverage, SubcarrierAverage
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.estimation.reference import ConjugateDifference, subcarrier_weights
from long_cases import cases
from plain import WAVEFORM, T, errors_deg, make_air, make_plan, random_tag, run_chain, stated_deg
from wiforce_app.bench.snapshots.air import TagOnAir
from wiforce_app.bench.snapshots.chain import SnapshotChain

K = len(WAVEFORM.bins)


def group_of(index, ends, gain, noise=1.0):
    """One separated group; ``ends`` (2S, K) or a number, ``gain`` (2S,)."""
    return Groups(
        [index],
        ends=np.broadcast_to(ends, (1, len(gain), K)),
        gain=np.array([gain], float),
        noise=np.broadcast_to(noise, (1, K)),
    )


def normal(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def averaged(groups, difference, smoothing_groups=1, tare_at=None):
    """Groups with their ratios, given one after the other; a tare before group ``tare_at``."""
    average, ready = SubcarrierAverage(smoothing_groups), []
    for group in groups:
        if group.index[0] == tare_at:
            difference.tare()
        ready.append(average.process(difference.process(group)))
    return Groups.concatenate(ready)


def angles_of(groups, end=0):
    """arg R in degrees of one end."""
    return np.degrees(np.angle(groups.ratios[:, end]))


def test_subcarrier_weights_are_those_of_maximum_ratio_combining():
    noise = np.array([1.0, 4.0, 0.5])
    assert subcarrier_weights(noise) == pytest.approx(np.array([1, 0.25, 2]) / 3.25)


def test_ratio_equals_the_weighted_conjugate_product_over_the_reference():
    """R = sum w V conj(V_ref) / (sum w |V_ref|^2 - its noise), in loops."""
    rng = np.random.default_rng(1)
    noise, gain = rng.uniform(0.5, 2, K) * 1e-4, [0.02, 0.03]
    values = [normal(rng, 2, K) for _ in range(7)]
    groups = [group_of(g, value, gain, noise) for g, value in enumerate(values)]
    results = averaged(groups, ConjugateDifference(2, 3))
    for g in range(7):
        for end in range(2):
            reference = sum(values[r][end] for r in range(3)) / 3
            top = sum(values[g][end][k] * np.conj(reference[k]) / noise[k] for k in range(K))
            bottom = sum(abs(reference[k]) ** 2 / noise[k] for k in range(K)) - K * gain[end] / 3
            assert results.ratios[g, end] == pytest.approx(top / bottom, rel=1e-9)
            assert results.in_reference[g, end] == (g < 3)


def test_reference_discarded_group_is_not_replaced_by_a_later_one():
    """Else each would bias every reading by a part of the touch, here 90 / 4 deg."""
    channel = normal(np.random.default_rng(12), 2, K)
    groups = [
        group_of(g, channel * (1j if g >= 4 else 1), [np.inf if g in (0, 2) else 1e-9, 1e-9])
        for g in range(8)
    ]
    angles = angles_of(averaged(groups, ConjugateDifference(2, 4)))
    assert angles == pytest.approx([0] * 4 + [90] * 4, abs=1e-6)


def test_reference_incomplete_holds_groups_up_to_twice_its_length():
    difference = ConjugateDifference(2, 4)
    counts = [len(difference.process(group_of(g, 1.0, [np.inf, np.inf]))) for g in range(8)]
    assert counts == [0] * 7 + [8]
    counts = [len(difference.process(group_of(g, 1.0, [0.01, 0.01]))) for g in range(8, 14)]
    assert counts == [1] * 6


def test_reference_of_a_late_tag_is_taken_when_it_appears():
    rng = np.random.default_rng(2)
    channel = normal(rng, 2, K)
    groups = [group_of(g, channel * (g >= 7), [np.inf if g < 7 else 1e-6] * 2) for g in range(12)]
    results = averaged(groups, ConjugateDifference(2, 3))
    references = results.in_reference.all(axis=1).tolist()
    assert references == [False] * 7 + [True] * 3 + [False] * 2
    assert results.late_reference.all(axis=1).tolist() == [False] * 7 + [True] * 5
    assert np.all(np.isinf(results.phase_std_deg[:7])) and np.all(results.ratios[:7] == 0)
    assert results.ratios[-1] == pytest.approx([1, 1], abs=1e-6)


def test_reference_after_a_tare_is_not_late():
    groups = [group_of(g, 1.0, [1e-6, np.inf if g < 3 else 1e-6]) for g in range(10)]
    late = averaged(groups, ConjugateDifference(2, 2), tare_at=6).late_reference.tolist()
    assert late == [[False, True]] * 8 + [[False, False]] * 2


def test_reference_after_a_tare_is_taken_from_the_groups_that_follow():
    rng = np.random.default_rng(3)
    channel = normal(rng, 2, K)
    turned = channel * np.exp(1j * np.radians(30.0))
    groups = [group_of(g, turned if g >= 4 else channel, [1e-9, 1e-9]) for g in range(10)]
    results = averaged(groups, ConjugateDifference(2, 2), tare_at=6)
    assert angles_of(results) == pytest.approx([0, 0, 0, 0, 30, 30, 30, 30, 0, 0], abs=1e-6)
    assert np.flatnonzero(results.new_reference).tolist() == [0, 8]
    assert np.flatnonzero(results.in_tare).tolist() == [6, 7]


def test_reference_that_is_discarded_leaves_the_former_one():
    channel = normal(np.random.default_rng(3), 2, K)
    turned = channel * np.exp(1j * np.radians(30.0))
    groups = [group_of(g, turned if g >= 4 else channel, [1e-9, 1e-9]) for g in range(10)]
    difference = ConjugateDifference(2, 2)
    before = averaged(groups[:7], difference, tare_at=6)
    assert difference.completes(8) and not difference.completes(7)
    difference.discard()
    results = Groups.concatenate([before, averaged(groups[7:], difference)])
    assert angles_of(results) == pytest.approx([0] * 4 + [30] * 6, abs=1e-6)
    assert np.flatnonzero(results.new_reference).tolist() == [0]


def test_reference_of_an_end_that_is_not_received_survives_a_tare():
    """A tag that is off during a tare must not lose its reference."""
    channel = normal(np.random.default_rng(3), 2, K)
    turned = channel * np.exp(1j * np.radians(30.0))
    groups = [
        group_of(g, turned if g >= 4 else channel, [1e-9, np.inf if 5 <= g < 9 else 1e-9])
        for g in range(12)
    ]
    results = averaged(groups, ConjugateDifference(2, 2), tare_at=6)
    assert angles_of(results, 0)[8:] == pytest.approx([0] * 4, abs=1e-6)
    assert angles_of(results, 1)[9:] == pytest.approx([30] * 3, abs=1e-6)
    assert not results.late_reference.any()


def test_average_after_a_tare_excludes_the_groups_before():
    channel = normal(np.random.default_rng(3), 2, K)
    # Less than the noise that is stated would let show.
    turned = channel * np.exp(1j * np.radians(1.0))
    groups = [group_of(g, turned if 2 <= g < 8 else channel, [0.1, 0.1]) for g in range(10)]
    results = averaged(groups, ConjugateDifference(2, 2), smoothing_groups=5, tare_at=6)
    angles = angles_of(results)
    assert angles[7] > 0.5 and angles[8:] == pytest.approx([-1, -1], abs=1e-3)


def test_reference_previous_group_gives_steps_across_a_lost_group():
    rng = np.random.default_rng(4)
    channel = normal(rng, 2, K)
    groups = [
        group_of(g, channel * turn * (g != 3), [np.inf if g == 3 else 1e-9] * 2)
        for g, turn in enumerate(np.exp(1j * np.radians([0.0, 10.0, 25.0, 25.0, 40.0])))
    ]
    angles = angles_of(averaged(groups, ConjugateDifference(2, 1, "previous")))
    assert angles == pytest.approx([0, 10, 15, 0, 15], abs=1e-6)


@pytest.mark.parametrize(
    "arguments, message",
    [((2, 0), "reference_groups: must be at least 1"), ((2, 1, "first"), "against")],
)
def test_reference_invalid_setting_is_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        ConjugateDifference(*arguments)


def test_average_over_no_group_is_refused():
    with pytest.raises(InputError, match="smoothing_groups: must be at least 1, got 0"):
        SubcarrierAverage(0)


@pytest.mark.parametrize(
    "gamma_db, group_length", cases((-15, 625), (0, 125), long=((0, 625), (20, 625)))
)
def test_ratios_stated_standard_deviation_matches_the_errors(gamma_db, group_length):
    """90 to 99 % of errors within two of them, and their size right on average."""
    groups = 12 * 625 // group_length
    plan = make_plan(group_length=group_length, reference_groups=groups)
    relative = []
    for seed in range(2):
        tags = [random_tag(np.random.default_rng([5, seed]))]
        air = make_air(group_length, tags, [6, seed], gamma_db)
        results = run_chain(plan, air, groups + 80)
        relative.append(errors_deg(results, tags, groups) / stated_deg(results, groups))
    relative = np.concatenate(relative)
    # 320 values: the fraction is known to 2.5 %, the root mean square to 8 %.
    assert 0.90 <= np.mean(np.abs(relative) < 2) <= 0.99
    assert np.sqrt(np.mean(relative**2)) == pytest.approx(1.0, abs=0.15)


def smoothed(length, ratios, variance=1e-4):
    average = AdaptiveAverage(length)
    values = [average.update(r, np.full(len(r), variance)) for r in ratios]
    return np.array([v[0] for v in values]), np.array([v[1] for v in values])


def test_average_of_steady_groups_spans_the_window():
    rng = np.random.default_rng(7)
    ratios = np.exp(1j * np.array([0.3, -2.0])) + 1e-2 * normal(rng, 600, 2)
    mean, variance = smoothed(5, ratios)
    expected = np.array([ratios[g - 4 : g + 1].mean(axis=0) for g in range(4, 600)])
    whole = np.isclose(variance[4:, 0], 1e-4 / 5)
    # Chance shortens the window now and then; it must stay rare.
    assert np.mean(whole) > 0.9
    assert np.max(np.abs(mean[4:] - expected)[whole]) < 1e-12
    spread = np.std(np.angle(mean[4:] / np.exp(1j * np.array([0.3, -2.0]))))
    assert spread == pytest.approx(1e-2 / np.sqrt(2 * 5), rel=0.1)


def test_average_follows_a_step_at_once():
    rng = np.random.default_rng(8)
    phase = np.where(np.arange(40) < 20, 0.0, np.radians(60))
    ratios = np.exp(1j * phase)[:, None] + 1e-2 * normal(rng, 40, 2)
    mean, variance = smoothed(5, ratios)
    assert np.abs(np.degrees(np.angle(mean[20:])) - 60).max() < 1.5
    assert variance[20] == pytest.approx([1e-4, 1e-4])


def test_average_of_a_slow_press_lags_less_than_the_noise():
    """A quarter of a standard deviation per group: lag stays within the noise."""
    rng = np.random.default_rng(9)
    phase = 0.25 * 7e-3 * np.arange(800)
    ratios = np.exp(1j * phase)[:, None] + 1e-2 * normal(rng, 800, 1)
    mean, variance = smoothed(5, ratios)
    error = np.angle(mean[:, 0] * np.exp(-1j * phase))[5:]
    std = np.sqrt(variance[5:, 0] / 2)
    assert np.mean(np.abs(error) < 2 * std) > 0.75
    assert np.sqrt(np.mean(error**2)) < 7e-3


def test_average_weighs_groups_by_their_variance():
    average = AdaptiveAverage(5)
    average.update(np.array([1.0 + 0j]), np.array([4e-4]))
    mean, variance = average.update(np.array([1.01 + 0j]), np.array([1e-4]))
    assert mean == pytest.approx([(1.0 / 4 + 1.01) / 1.25]) and variance == pytest.approx([8e-5])


def test_average_excludes_absent_groups():
    average = AdaptiveAverage(5)
    average.update(np.array([1.0 + 0j]), np.array([1e-4]))
    mean, variance = average.update(np.array([0j]), np.array([np.inf]))
    assert mean == [0] and np.isinf(variance[0])
    mean, variance = average.update(np.array([1.1 + 0j]), np.array([1e-4]))
    assert mean == pytest.approx([1.1]) and variance == pytest.approx([1e-4])


def test_average_of_short_groups_follows_a_touch_and_reaches_the_bound():
    """60 deg in 20 ms at gamma 10 dB, 139 readings a second: 5 deg within 15 ms of the end."""
    length, groups = 125, 70
    period = length * T
    plan = make_plan(group_length=length, reference_groups=groups, smoothing_groups=5)
    steady = []
    for seed in range(2):
        tag = TagOnAir(
            offset_ppm=70.0,
            drift_ppm_per_s=0.5,
            start_cycles=0.4,
            untouched_deg=(10.0, -50.0),
            touched_deg=(70.0, 10.0),
        )
        air = make_air(length, [tag], [10, seed], 10.0)
        start = (groups + 20.3) * period
        chain, ready = SnapshotChain(plan), []
        for g in range(groups + 100):
            share = np.clip((air.times_s(g) - start) / 0.02, 0, 1)
            ready.append(chain.process(g, air.group(g, share)))
        results = Groups.concatenate(ready)
        errors = np.degrees(np.angle(results.ratios)) - 60
        time = (results.index + 0.5) * period
        assert np.max(np.abs(errors[time > start + 0.02 + 0.015])) < 5.0
        steady.append(errors[time > start + 0.02 + 0.1])
    # The bound at N_g = 625 and gamma 10 dB is .17 deg, reference included; 1 dB is 12 %.
    assert np.sqrt(np.mean(np.square(np.concatenate(steady)))) < 0.17 * 1.12 * 1.15
