# SPDX-License-Identifier: GPL-3.0-or-later
"""What reflective off states of the switches are worth: the bound against errors of draws."""

import dataclasses

import numpy as np
import pytest
from gnuradio import wiforce
from gnuradio.wiforce.planning.expected import expect, phase_std_deg
from gnuradio.wiforce.planning.off_states import off_states, turn_std_deg
from scipy.optimize import least_squares

FORCE_N, LOCATION_MM = 4.0, 40.0


def plan_of(*off):
    pairs = [[each.real, each.imag] for each in map(complex, off)]
    sensor = {"name": "arm", "model": "line-900mhz", "off_reflection": pairs}
    return wiforce.plan({"sensors": [sensor], "simulation": {"snr_db": 10}})


def judged(*off):
    plan = plan_of(*off)
    (found,) = off_states(plan, phase_std_deg(plan))
    return found


def test_off_states_that_differ_read_a_press_while_the_tag_turns():
    found = judged(0.3, -0.3)
    assert (found.force_n, found.location_mm) == (FORCE_N, LOCATION_MM)
    assert found.force_std_n < found.free_std_n < 0.15
    assert 0 < found.known_to < 0.01
    assert "while the tag turns" in str(found) and found.report()["free_std_n"] == found.free_std_n


def test_equal_off_states_do_not_and_a_better_pair_is_named():
    found = judged(0.3, 0.3)
    assert found.free_std_n == np.inf and found.report()["free_std_n"] is None
    assert found.better_std_n < 0.1 and "cannot be distinguished from force" in str(found)
    assert judged(*found.better).better is None


def test_switches_without_reflection_are_not_mentioned():
    plan = plan_of(0.0, 0.0)
    assert not list(off_states(plan, phase_std_deg(plan)))


@pytest.mark.parametrize("wrong", [False, True])
def test_bound_is_the_spread_of_readings_of_a_tag_that_turns(wrong):
    """Of noise; and of off states that are wrong by what is stated to add as much."""
    off = np.array([0.3, -0.3])
    plan, found = plan_of(*off), judged(*off)
    model, rng = plan.sensors[0].model, np.random.default_rng(5)
    noise = np.radians(phase_std_deg(plan)[0])
    untouched = np.exp(1j * np.radians(model.untouched_deg()))

    def ends(press, other):
        psi = np.radians(np.ravel(model.phases_deg(press[0], press[1])))
        return (np.exp(1j * psi) - other) / (untouched - other)

    errors = []
    for _ in range(200):
        turn = np.exp(rng.normal(0, 0.05) + 1j * rng.uniform(-0.7, 0.7))
        parts = rng.standard_normal((2, 2))
        is_off = off + wrong * found.known_to * (parts[0] + 1j * parts[1])
        size = np.abs(untouched - off)
        received = turn * ends((FORCE_N, LOCATION_MM), is_off)
        if not wrong:
            received = received + noise / size * turn * (parts[0] + 1j * parts[1])

        def residual(x, received=received, size=size):
            apart = (ends(x[:2], off) * np.exp(x[2] + 1j * x[3]) - received) * size / noise
            return np.concatenate([apart.real, apart.imag])

        start = np.array([FORCE_N, LOCATION_MM, np.log(abs(turn)), np.angle(turn)])
        errors.append(least_squares(residual, start, x_scale=[1, 1, 0.01, 0.01]).x - start)
    assert np.std(errors, axis=0)[0] == pytest.approx(found.free_std_n, rel=0.2)
    sensor = dataclasses.replace(plan.sensors[0], off_reflection_std=wrong * found.known_to)
    press, std_deg = np.array([[FORCE_N, LOCATION_MM]]), np.degrees(noise)
    turn_std = turn_std_deg(sensor, 900e6, press, std_deg)
    if wrong:  # noise, of which these draws have none, adds as much
        turn_std = turn_std / np.sqrt(2)
    assert np.std(errors, axis=0)[3] == pytest.approx(np.radians(turn_std[0]), rel=0.2)


def test_expected_errors_of_a_moving_tag_are_small_where_off_states_show_the_motion():
    """A scene whose readings have errors of .09 N (gr-wiforce evaluate moving_tag_off_states)."""
    moving, by_off_states = (
        expect(wiforce.plan(scene))[0] for scene in ("moving_tag", "moving_tag_off_states")
    )
    assert moving.force_error_n > 1 and moving.phase_error_deg[0] > 1
    assert 0.05 < by_off_states.force_error_n < 0.15
    assert by_off_states.phase_error_deg[0] < 0.1
