# SPDX-License-Identifier: GPL-3.0-or-later
"""Presses followed over time: better than single readings, and never surer than they may be."""

import numpy as np
import pytest
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.sensor import PressTracker, load_sensor

PERIOD_S = 0.036


@pytest.fixture(scope="module")
def model():
    return load_sensor("line-900mhz-calibrated")


def a_press(rng, count=40):
    """Force that rises and wanders, and a place."""
    peak = rng.uniform(3, 6)
    wander = peak + np.cumsum(rng.normal(0, 0.15, count - 8))
    return np.clip(np.r_[np.linspace(1.5, peak, 8), wander], 1.0, 8.0), rng.uniform(22, 58)


def followed(model, phases, std):
    tracker = model.tracker(PERIOD_S)
    return np.array([tracker.update(pair, std)[:4] for pair in phases]).T


def grid_filter(model, phases, std, walk_n, start_n, start_std_n):
    """The same believed, on a plain grid of force and location: posterior means over time."""
    forces, places = np.arange(0.9, 9.7, 0.04), np.arange(28.0, 40.0, 0.1)
    grid = model.phases_deg(np.maximum(forces, 0.9)[:, None], places)
    variance = std**2 + model.model_std_deg(forces[:, None], places) ** 2
    belief = np.exp(-0.5 * ((forces - start_n) / start_std_n) ** 2)[:, None] * np.ones(len(places))
    spread = np.exp(-0.5 * ((forces[:, None] - forces) / walk_n) ** 2)
    spread /= spread.sum(axis=0)
    means = []
    for i, pair in enumerate(phases):
        belief = spread @ belief if i else belief
        away = ((pair - grid + 180) % 360 - 180) ** 2 / variance
        likelihood = (1 + away.sum(-1) / 4.0) ** (-(4.0 + 2) / 2)  # of four degrees of freedom
        belief = belief * likelihood / np.sqrt(variance.prod(-1))
        belief /= belief.sum()
        means.append((belief.sum(1) @ forces, belief.sum(0) @ places))
    return np.array(means).T


def test_the_tracker_equals_a_grid_filter(model):
    rng = np.random.default_rng(1)
    force, place = a_press(rng, 25)
    place = 34.0
    phases = model.phases_deg(force, place) + 0.7 * rng.standard_normal((25, 2))
    start = model.onset_force_n + 1.1
    expected = grid_filter(model, phases, 0.7, 4.0 * np.sqrt(PERIOD_S), start, 1.1)
    found = followed(model, phases, 0.7)
    # Gaussian in force, and a coarse grid of places at first, against neither: half of the
    # standard deviation of 0.3 N
    assert np.abs(found[0] - expected[0])[3:].max() < 0.15
    assert np.abs(found[2] - expected[1])[3:].max() < 0.1


def test_following_beats_single_readings_and_smoothing_beats_both(model):
    rng = np.random.default_rng(2)
    errors = []
    for _ in range(4):
        force, place = a_press(rng)
        phases = model.phases_deg(force, place) + 1.0 * rng.standard_normal((len(force), 2))
        tracked, smooth = followed(model, phases, 1.0), model.tracker(PERIOD_S).smooth(phases, 1.0)
        assert np.mean(np.abs(smooth.force_n - force) <= 2 * smooth.force_std_n) >= 0.8
        for found in (model.invert(phases, 1.0).force_n, tracked[0], smooth.force_n):
            errors.append(np.abs(found - force))
    single, tracked, smoothed = np.median(np.reshape(errors, (4, 3, -1)), axis=(0, 2))
    assert smoothed < tracked < 0.85 * single


def test_what_the_model_errs_by_is_not_averaged_away():
    """Forty readings of a sensor that is not quite the model's."""
    model, line = load_sensor("line-900mhz-calibrated"), load_sensor("line-900mhz")
    rng = np.random.default_rng(3)
    z_force, z_place = [], []
    for _ in range(3):
        force, place = a_press(rng)
        phases = line.phases_deg(force, place) + 0.1 * rng.standard_normal((len(force), 2))
        found = followed(model, phases, 0.1)
        smooth = model.tracker(PERIOD_S).smooth(phases, 0.1)
        z_force.append(np.abs(found[0] - force) / found[1])
        z_place.append(np.abs(smooth.location_mm - place) / smooth.location_std_mm)
    assert np.mean(np.concatenate(z_force) <= 2) >= 0.9
    assert np.mean(np.concatenate(z_place) <= 2) >= 0.8


def test_an_outlier_does_not_carry_the_press_away(model):
    rng = np.random.default_rng(4)
    force = np.full(40, 4.0)
    phases = model.phases_deg(force, 35.0) + 0.3 * rng.standard_normal((40, 2))
    phases[25] += [25.0, -30.0]
    found = followed(model, phases, 0.3)
    assert np.abs(found[0][26:] - 4.0).max() < 0.6
    assert np.abs(found[2][25:] - 35.0).max() < 0.3


def test_a_press_ends_with_touch_and_the_next_is_elsewhere(model):
    rng = np.random.default_rng(5)
    tracker = model.tracker(PERIOD_S)
    for place in (25.0, 55.0):
        for force in np.linspace(2, 5, 15):
            phases = model.phases_deg(force, place) + 0.2 * rng.standard_normal(2)
            found = tracker.update(phases, 0.2)
        assert found[2] == pytest.approx(place, abs=0.2) and found[4] == ()
        found = tracker.update(model.untouched_deg(), 0.2, touched=False)
        assert np.all(np.isnan(found[:4])) and found[4] == ()


def test_a_press_that_jumps_without_release_is_found_again_and_one_without_phases_bridged(model):
    tracker = model.tracker(PERIOD_S)
    flags = set()
    for place in (25.0,) * 10 + (50.0,) * 10:
        found = tracker.update(model.phases_deg(4.0, place), 0.2)
        flags.update(found[4])
    assert found[2] == pytest.approx(50.0, abs=0.2) and "inconsistent" in flags
    bridged = tracker.update([np.nan, np.nan], 0.2)
    assert bridged[0] == pytest.approx(found[0], abs=1e-6) and bridged[1] > found[1]


def test_settings_that_cannot_be_are_refused(model):
    for settings in ({"group_period_s": 0.0}, {"group_period_s": 1.0, "force_walk_n": -1.0}):
        with pytest.raises(InputError, match="must be positive"):
            PressTracker(model, **settings)
    with pytest.raises(InputError, match=r"phases_deg: must have shape \(2,\)"):
        model.tracker(1.0).update([1.0, 2.0, 3.0], 0.1)
    with pytest.raises(InputError, match="std_deg"):
        model.tracker(1.0).update([1.0, 2.0], -0.1)
    with pytest.raises(InputError, match="phases_deg: must hold a reading"):
        model.tracker(PERIOD_S).smooth(np.empty((0, 2)), 1.0)
