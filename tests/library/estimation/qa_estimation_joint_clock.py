# SPDX-License-Identifier: GPL-3.0-or-later
"""Clock phases from the whole model of a group, where a tag's own lines alone mislead."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.clocks.joint_clock import likelihood_bias, phase_errors
from gnuradio.wiforce.estimation.clocks.likelihood import PhaseLikelihood
from gnuradio.wiforce.estimation.clocks.tracked_tag import TagClock
from gnuradio.wiforce.wiforce_kernels import end_fit, phase_expansion
from plain import TA, bound_of, errors_deg, make_air, make_plan, random_tag, run_chain, stated_deg


def normal(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def test_phase_expansion_information_equals_that_of_joint_least_squares():
    """Against differences of what is left when the ends are solved anew at other phases."""
    rng = np.random.default_rng(1)
    mixing, slopes = normal(rng, 14, 4), normal(rng, 14, 4)
    inverse_noise = 1e4 * rng.uniform(0.5, 2, 6)
    tones = mixing @ normal(rng, 4, 6) + 1e-2 * normal(rng, 14, 6)

    def cost(phases):
        turned = mixing + slopes * np.repeat(phases, 2)
        residual = tones - turned @ np.linalg.pinv(turned) @ tones
        return float(np.sum(np.abs(residual) ** 2 @ inverse_noise))

    fit = end_fit(np.hstack([mixing, slopes])[None], tones[None])
    of_groups = phase_expansion(fit).information(inverse_noise)
    gradient, information, excess = (each[0] for each in of_groups)
    step = 1e-5
    for tag in range(2):
        turn = step * np.eye(2)[tag]
        slope = (cost(turn) - cost(-turn)) / (2 * step)
        assert gradient[tag] == pytest.approx(-slope, rel=1e-4)
    # of the information noise makes a hundred-thousandth: the curvature is that of the cost
    at_best = phase_errors(gradient, information, excess)[0]
    assert cost(at_best) < cost(np.zeros(2))
    both = information + np.diag(excess)
    for a, b in ((0, 0), (0, 1), (1, 1)):
        step, (i, j) = 1e-3, np.eye(2)[[a, b]]
        curved = sum(s * t * cost(step * (s * i + t * j)) for s in (1, -1) for t in (1, -1))
        assert both[a, b] == pytest.approx(curved / (4 * step**2), rel=0.05)


def test_phase_expansion_power_equals_the_residual_at_other_phases():
    """The noise is learned from it before the ends are solved at the tracked clocks."""
    rng = np.random.default_rng(2)
    mixing, slopes, shifts = normal(rng, 3, 14, 4), normal(rng, 3, 14, 4), [[1e-4, -2e-4]] * 3
    tones = mixing @ normal(rng, 3, 4, 6) + 1e-2 * normal(rng, 3, 14, 6)
    fit = end_fit(np.concatenate([mixing, slopes], axis=2), tones)
    expansion = phase_expansion(fit)
    turned = mixing + slopes * np.repeat(shifts, 2, axis=1)[:, None]
    residual = tones - turned @ (np.linalg.pinv(turned) @ tones)
    exact = np.sum(np.abs(residual) ** 2, axis=1)
    found = expansion.power_at(np.array(shifts))
    # The shifts change the residual by far more than the expansion is wrong.
    assert np.max(np.abs(exact - fit.power()) / exact) > 0.02
    assert found == pytest.approx(exact, rel=1e-3)
    np.testing.assert_array_equal(expansion.power_at(np.array(shifts[:2])), found[:2])


def test_phase_errors_without_information_are_zero():
    errors, variances = phase_errors(np.ones(2), np.diag([4.0, 0.0]), np.zeros(2))
    assert np.all(errors == 0) and np.all(np.isinf(variances))
    errors, variances = phase_errors(np.array([2.0, 3.0]), np.diag([4.0, 9.0]), np.zeros(2))
    assert errors == pytest.approx([1 / 2, 1 / 3]) and variances == pytest.approx([1 / 4, 1 / 9])


@pytest.mark.parametrize(
    "clocks_hz, group_length, least_deg, most_deg",
    [
        ((1000.0,), 625, 0.0, 0.05),  # whole periods
        ((1000.0,), 125, 0.3, 1.0),
        ((1000.0, 1335.71), 625, 3.0, 8.0),  # line 14 aliases 3 Hz beside line 1
    ],
)
def test_likelihood_bias_is_predicted_from_the_weights(
    clocks_hz, group_length, least_deg, most_deg
):
    plan = make_plan(clocks_hz, group_length=group_length)
    tag, clock = len(clocks_hz) - 1, TagClock(clocks_hz[-1])
    likelihood = PhaseLikelihood(plan.table, tag, clock.clock_hz * TA)
    bias_deg = np.degrees(likelihood_bias(plan.table, likelihood, clock, TA))
    assert least_deg <= bias_deg <= most_deg


@pytest.mark.parametrize("clocks_hz", [(1000.0, 1002.58), (1000.0, 502.19), (1000.0, 1335.71)])
def test_phases_of_nearly_coinciding_lines_match_their_stated_errors(clocks_hz):
    """By their own lines alone readings are off by .3 to 1 deg and state .02."""
    plan, rng = make_plan(clocks_hz), np.random.default_rng(2)
    tags = [random_tag(rng, clock_hz=hertz) for hertz in clocks_hz]
    results = run_chain(plan, make_air(625, tags, 3, 30.0, static_db=60), 40)
    errors = errors_deg(results, tags)
    stated = stated_deg(results)
    readable = np.isfinite(stated)
    assert np.mean(readable) > 0.9 and np.median(stated) < 0.04
    # largest of 112
    assert np.max(np.abs(errors / stated)[readable]) < 4.5


def test_phases_of_groups_without_whole_periods_reach_the_bound():
    plan = make_plan(group_length=125, reference_groups=60)
    tags = [random_tag(np.random.default_rng(4))]
    air = make_air(125, tags, 5, 60.0, static_db=60)
    errors = errors_deg(run_chain(plan, air, 160), tags, 60)
    bound = bound_of(air, 60, 125)
    assert np.max(np.sqrt(np.mean(errors**2, axis=0)) / bound) < 1.3
