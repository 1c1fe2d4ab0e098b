# SPDX-License-Identifier: GPL-3.0-or-later
"""The switches' off state: taken out when given, found from presses when not."""

import numpy as np
import pytest
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.phases.off_state import (
    corrected_phase_deg,
    estimate_off_reflection,
)
from gnuradio.wiforce.signal.carrier import wrap_deg
from plain import errors_deg, make_air, make_plan, normal, run_chain
from wiforce_app.bench.air import TagOnAir


def ratio(psi_deg, untouched_deg, off):
    """R of an end by definition."""
    untouched, now = np.exp(1j * np.radians(untouched_deg)), np.exp(1j * np.radians(psi_deg))
    return (now - off) / (untouched - off)


@pytest.mark.parametrize("off", [0.0, 0.11, 0.3j, -0.33 + 0.1j])
def test_correction_undoes_the_off_state(off):
    psi = np.linspace(-179, 180, 50)
    ratios = np.stack([ratio(psi, 30.0, off), ratio(psi, -110.0, off)], axis=-1)
    phases, _ = corrected_phase_deg(ratios, (30.0, -110.0), off)
    assert np.max(np.abs(wrap_deg(phases - psi[:, None]))) < 1e-9
    assert np.all((phases > -180) & (phases <= 180))


@pytest.mark.parametrize("angle_deg", [0.0, 77.0, -140.0])
def test_a_leaky_switch_that_the_scene_states_leaves_no_bias(angle_deg):
    """G_off/rho = .3: left out, it would err by 20 deg."""
    off = 0.3 * np.exp(1j * np.radians(angle_deg))
    tag = TagOnAir(
        offset_ppm=50.0,
        untouched_deg=(20.0, -130.0),
        touched_deg=(110.0, -60.0),
        off_reflection=off,
    )
    results = run_chain(make_plan(), make_air(625, [tag], 1, 50.0, static_db=60), 40)
    touched = np.mean(results.ratios[results.index >= 12], axis=0)
    phases, _ = corrected_phase_deg(touched, tag.untouched_deg, off)
    assert np.max(np.abs(wrap_deg(phases - tag.touched_deg))) < 0.1
    ignored = np.mean(errors_deg(results, [tag]), axis=0)
    assert np.max(np.abs(ignored)) > 5


@pytest.mark.parametrize("off", [0.0, 0.15 * np.exp(2.1j), -0.3, 0.3j])
def test_presses_of_unknown_force_give_the_off_state_away(off):
    rng = np.random.default_rng(2)
    psi = 25.0 + rng.uniform(40, 130, 60)
    noisy = ratio(psi, 25.0, off) + 0.002 * np.sqrt(2) * normal(rng, 60)
    estimate, std = estimate_off_reflection(noisy, 25.0, np.degrees(0.002))
    assert abs(estimate - off) < 4 * std < 0.02


def test_presses_that_change_inside_a_group_are_outvoted():
    """Such a group lies inside the circle, not on it."""
    off = 0.15 * np.exp(2.1j)
    ratios = ratio(25.0 + np.linspace(40, 130, 60), 25.0, off)
    ratios[[10, 30, 50]] *= 0.8
    estimate, _ = estimate_off_reflection(ratios, 25.0, 0.1)
    assert abs(estimate - off) < 0.01


@pytest.mark.parametrize(
    ("turns_deg", "noise", "message"),
    [((40, 90), 0.2, "off_reflection"), ((2, 20), 0.0, "needs presses that turn the phase")],
)
def test_presses_too_noisy_or_too_small_to_decide_are_refused(turns_deg, noise, message):
    rng = np.random.default_rng(3)
    ratios = ratio(25.0 + rng.uniform(*turns_deg, 20), 25.0, 0.1) + noise * normal(rng, 20)
    with pytest.raises(InputError, match=message):
        estimate_off_reflection(ratios, 25.0, np.degrees(0.2))
