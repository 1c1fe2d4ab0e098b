# SPDX-License-Identifier: GPL-3.0-or-later
"""A tag's free-running clock: found without knowing phase, offset or channel, then followed."""

import numpy as np
import pytest
from gnuradio import wiforce
from gnuradio.wiforce.estimation.clocks.likelihood import PhaseLikelihood, acquire
from gnuradio.wiforce.signal.weights import design_weights
from gnuradio.wiforce.simulation.truth import read_truth
from gnuradio.wiforce.wiforce_kernels import phase_errors
from long_cases import cases
from plain import (
    TA,
    T,
    errors_deg,
    make_air,
    make_plan,
    random_tag,
    run_chain,
    stated_deg,
)
from wiforce_app.bench.air import TagOnAir

CLOCK_HZ = 1000.0
RATE = 2 * np.pi * CLOCK_HZ
SUBCARRIERS = 62


@pytest.fixture(scope="module")
def table():
    return design_weights([CLOCK_HZ], 625, T)


@pytest.fixture(scope="module")
def likelihood(table):
    return PhaseLikelihood(table, 0, CLOCK_HZ * TA)


def wrapped(radians):
    return (radians + np.pi) % (2 * np.pi) - np.pi


def found_clock(likelihood, table, air):
    """The clock in eleven groups, with the noise known."""
    times_s = (np.arange(11) + 0.5) * 625 * T - T / 2
    found = [likelihood.covariance(table.weights @ air.group(g), air.noise) for g in range(11)]
    return acquire(times_s, np.array(found), likelihood, RATE, 100.0, SUBCARRIERS)


def true_phase(tag, time_s):
    offset, drift = tag.offset_ppm * 1e-6, tag.drift_ppm_per_s * 1e-6
    cycles = tag.start_cycles + tag.clock_hz * (time_s * (1 + offset) + drift * time_s**2 / 2)
    return 2 * np.pi * cycles


@pytest.mark.parametrize("gamma_db, runs", [(-20.0, 40), (0.0, 10)])
def test_acquisition_is_never_off_by_half_a_cycle(table, likelihood, gamma_db, runs):
    """It would ruin end 2: lines 2 and 6 hold both ends, with the wrong sign."""
    for seed in range(runs):
        tag = random_tag(np.random.default_rng([1, seed]))
        fit = found_clock(likelihood, table, make_air(625, [tag], [2, seed], gamma_db))
        error = wrapped(fit.phase - true_phase(tag, fit.time_s))
        assert fit.found and abs(error) < 0.25


@pytest.mark.parametrize("seed", range(20))
def test_acquisition_without_a_tag_finds_no_clock(table, likelihood, seed):
    air = make_air(625, [], seed, 0.0, static_db=60)
    assert not found_clock(likelihood, table, air).found


@pytest.mark.parametrize("gamma_db, seed", [(-15.0, 1), (-15.0, 2), (20.0, 3)])
def test_acquisition_recognises_overlapping_pulses(table, likelihood, gamma_db, seed):
    """75 % about the same centres: inverted, and a quarter of Ts late."""
    tag = random_tag(np.random.default_rng(seed), clock2_delay_cycles=0.25)
    fit = found_clock(likelihood, table, make_air(625, [tag], seed, gamma_db))
    assert fit.found and fit.overlapping


def test_tracker_of_a_drifting_weak_clock_does_not_slip():
    tag = TagOnAir(offset_ppm=-3.0, drift_ppm_per_s=0.5, untouched_deg=(0.0, 90.0))
    results = run_chain(make_plan(), make_air(625, [tag], 4, -15.0), 400)
    assert results.locked.all()
    center_s = (results.index + 0.5) * 625 * T - T / 2
    errors = wrapped(results.clock_phase[:, 0] - true_phase(tag, center_s))
    # A slip is pi or more; phase noise at line 4 stays small against what separates the ends.
    assert np.max(np.abs(errors)) < 0.15
    assert np.degrees(np.sqrt(np.mean(np.square(errors)))) < 2.0
    assert results.clock_offset_ppm[-1, 0] == pytest.approx(-3.0 + 0.5 * 400 * 0.036, abs=2.0)


@pytest.mark.parametrize(
    ("wander_ppm", "seed"), cases((25, 2), long=((10, 1), (10, 3), (25, 1), (25, 3)))
)
def test_clock_that_wanders_as_those_of_switches_gives_no_wrong_reading(wander_ppm, seed, tmp_path):
    """Clocks of real switches were seen to wander by 10 to 25 ppm in seconds."""
    presses = [
        {"sensor": "arm", "start_s": 1.2 + 1.2 * n, "rise_s": 0.1, "hold_s": 0.7}
        | {"force_n": 2.0 + n, "end_force_n": 2.0 + n, "location_mm": 30.0 + 10 * n}
        for n in range(3)
    ]
    scene = {
        "radio": {"sample_rate_hz": 1.25e6, "center_frequency_hz": 915e6},
        "sounding": {"frame_length": 360},
        "phase_group": {"snapshots": 125},
        "sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 400}],
        "reference_s": 1.0,
        "simulation": {
            "truth_model": "line-900mhz",
            "duration_s": 4.8,
            "seed": seed,
            "snr_db": 10,
            "static_clutter_db": 50,
            "tags": [{"clock_wander_ppm_per_sqrt_s": wander_ppm}],
            "presses": presses,
        },
    }
    wiforce.simulate(scene, tmp_path / "a")
    readings, truth = wiforce.read(tmp_path / "a"), read_truth(tmp_path / "a.truth.csv")
    clear = (readings["flags"] == "").to_numpy()
    touched = np.array([row["touch"] for row in truth]) == 1
    assert (readings["touch"].to_numpy(float) == touched)[clear].all()
    assert np.mean(clear[touched]) > 0.8  # changes of the force are flagged
    true_n = np.array([row["force_n"] for row in truth])[clear & touched]
    read = readings[clear & touched]
    # The standard deviation of one in 190 readings would be exceeded threefold by chance.
    assert (np.abs(read["force_n"] - true_n) < 4 * read["force_std_n"]).all()


def test_phase_errors_are_the_step_and_its_variance_by_the_pseudo_inverse():
    """Of phases that the ends of two tags on one clock share, only the sum is known."""
    rng = np.random.default_rng(2)
    for rank in (4, 3):
        factor = rng.standard_normal((4, rank)) * [[1], [2], [30], [400]]
        gradient, information, excess = factor[:, 0], factor @ factor.T, rng.uniform(0.1, 1, 4)
        scale = np.sqrt(np.diag(information))
        scales = np.outer(scale, scale)
        inverse = np.linalg.pinv(information / scales, rcond=1e-9, hermitian=True) / scales
        errors, variances = phase_errors(gradient, information, excess)
        np.testing.assert_allclose(errors, inverse @ gradient, rtol=1e-6)
        spread = inverse @ (information + np.diag(excess)) @ inverse
        np.testing.assert_allclose(variances, np.diag(spread), rtol=1e-6)
    errors, variances = phase_errors(np.ones(2), np.diag([4.0, 0.0]), np.zeros(2))
    assert np.all(errors == 0) and np.all(np.isinf(variances))


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
