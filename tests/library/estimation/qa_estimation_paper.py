# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimators kept for comparison: the paper's, and half the angle of the sideband product."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.estimators import RatioUnfolder, estimator_named
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.signal.weights import design_weights
from plain import WAVEFORM, T, averaged_groups, errors_deg, make_air, make_plan, run_chain
from wiforce_app.bench.air import TagOnAir


def test_paper_tones_exclude_lost_snapshots():
    table = design_weights([1000.0], 625, T, rectangular=True)
    mask = np.arange(625) % 5 > 0
    partial = table.for_present(mask)
    assert partial.weights == pytest.approx(table.weights[:, mask] * 1.25)
    assert table.for_present(np.zeros(625, bool)) is None


def test_paper_with_clock_offset_rotates_the_phase():
    """A constant offset o turns end 1 by 2 pi fs o per second, end 2 by four times that."""
    tag = TagOnAir(offset_ppm=40.0, untouched_deg=(20.0, -70.0), touched_deg=(20.0, -70.0))
    results = run_chain(make_plan(estimator="paper"), make_air(625, [tag], 3, 40.0), 40)
    phases = np.unwrap(np.angle(results.ratios), axis=0)
    slopes = np.polyfit(results.index * 625 * T, phases, 1)[0]
    assert slopes == pytest.approx(2 * np.pi * 1000 * 40e-6 * np.array([1, 4]), rel=0.02)


@pytest.mark.parametrize("estimator, losses_db", [("paper", (7.6, 10.5)), ("sideband", (2.1, 4.7))])
def test_paper_and_sideband_losses_match_theory(estimator, losses_db):
    plan = make_plan(estimator=estimator, reference_groups=40)
    tag = TagOnAir(untouched_deg=(20.0, -70.0), touched_deg=(20.0, -70.0))
    air = make_air(625, [tag], 4, 10.0, coherence_hz=None)
    results = run_chain(plan, air, 240)
    phases = np.degrees(np.angle(results.ratios[results.index >= 40]))
    # The paper's phases add up; its error is that of a change from group to group.
    errors = np.diff(phases, axis=0) if estimator == "paper" else phases
    bound = np.degrees(np.sqrt(1 / (2 * 10 * 62 * 625 * np.array([0.158, 0.152]))))
    loss = 20 * np.log10(np.std(errors, axis=0) / bound)
    # 200 groups: +-.9 dB.
    assert loss == pytest.approx(losses_db, abs=1.0)


def test_sideband_cancels_the_clock_offset():
    tag = TagOnAir(
        offset_ppm=80.0, drift_ppm_per_s=0.5, untouched_deg=(20.0, -70.0), touched_deg=(75.0, -10.0)
    )
    results = run_chain(make_plan(estimator="sideband"), make_air(625, [tag], 5, 40.0), 40)
    assert np.max(np.abs(errors_deg(results, [tag]))) < 0.2


@pytest.mark.parametrize("estimator", ["paper", "sideband"])
def test_paper_and_sideband_invalid_group_is_empty(estimator):
    table = design_weights([1000.0], 625, T)
    plan = make_plan(estimator=estimator)
    separator = estimator_named(estimator).separator(table, plan.clocks, WAVEFORM)
    for broken in (np.zeros((1, 16, 62)), np.full((1, 16, 62), np.nan)):
        group = separator.process(Groups([0], broken))
        assert not group.locked.any() and np.all(np.isinf(group.gain)) and not group.ends.any()
    assert len(separator.flush()) == 0


def test_unfolder_steps_add_up_across_a_lost_group_and_begin_anew():
    steps = np.array([[1], [2j], [0], [1j], [1j]])
    std_deg, anew = np.array([[1, 1, np.inf, 1, 1]]).T, np.arange(5) == 4
    groups = averaged_groups(steps, phase_std_deg=std_deg, new_reference=anew)
    found = np.angle(RatioUnfolder("step").process(groups).ratios[[1, 3, 4], 0], deg=True)
    assert np.abs(found) == pytest.approx([90, 180, 90]) and found[0] > 0 < found[2]


def test_unfolder_square_root_stays_on_the_side_of_the_previous_group():
    turns = np.radians(np.arange(0, 400, 50.0))[:, None]
    squares = averaged_groups(0.8 * np.exp(2j * turns), phase_std_deg=np.full((8, 1), 3.0))
    unfolded = RatioUnfolder("square").process(squares)
    assert unfolded.ratios == pytest.approx(np.sqrt(0.8) * np.exp(1j * turns))
    assert np.all(unfolded.phase_std_deg == 1.5)
