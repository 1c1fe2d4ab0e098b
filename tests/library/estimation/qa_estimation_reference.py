# SPDX-License-Identifier: GPL-3.0-or-later
"""What an end's channel is compared with, and the average over subcarriers and groups."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.estimation.phases.reference import ConjugateDifference, SubcarrierAverage
from long_cases import cases
from plain import (
    WAVEFORM,
    errors_deg,
    make_air,
    make_plan,
    normal,
    random_tag,
    run_chain,
    stated_deg,
)

K = len(WAVEFORM.bins)


def group_of(index, ends, gain, noise=1.0):
    """One separated group; ``ends`` (2S, K) or a number, ``gain`` (2S,)."""
    return Groups(
        [index],
        ends=np.broadcast_to(ends, (1, len(gain), K)),
        gain=np.array([gain], float),
        noise=np.broadcast_to(noise, (1, K)),
    )


def averaged(groups, difference):
    """Groups with their ratios, given one after the other."""
    average = SubcarrierAverage()
    return Groups.concatenate(average.process(difference.process(group)) for group in groups)


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


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("noise", [0.0, 1e-320, np.inf, np.nan])
def test_average_of_a_group_without_noise_or_finite_noise_has_no_phase_and_no_warning(noise):
    """A warning of NumPy would be printed for every such group."""
    group = group_of(0, 1.0, [1.0, 1.0], noise).having(
        changes=np.ones((1, 2, K), complex),
        reference_gain=np.ones((1, 2)),
        reference_power=np.ones((1, 2)),
    )
    assert np.all(np.isinf(SubcarrierAverage().process(group).phase_std_deg))


def test_reference_discarded_group_is_not_replaced_by_a_later_one():
    """Else each would bias every reading by a part of the touch, here 90 / 4 deg."""
    channel = normal(np.random.default_rng(12), 2, K)
    groups = [
        group_of(g, channel * (1j if g >= 4 else 1), [np.inf if g in (0, 2) else 1e-9, 1e-9])
        for g in range(8)
    ]
    angles = np.angle(averaged(groups, ConjugateDifference(2, 4)).ratios[:, 0], deg=True)
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
