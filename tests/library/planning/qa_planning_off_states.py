# SPDX-License-Identifier: GPL-3.0-or-later
"""What reflective off states of the switches are worth: the bound against errors of draws."""

import dataclasses

import numpy as np
import pytest
from gnuradio import wiforce
from gnuradio.wiforce.planning.expected import (
    PressedLine,
    error_map,
    expect,
    phase_std_deg,
)
from scipy.optimize import least_squares

FORCE_N, LOCATION_MM = 4.0, 40.0
PRESS = np.array([[FORCE_N, LOCATION_MM]])


def plan_of(*off, std=None, model="line-900mhz"):
    pairs = [[each.real, each.imag] for each in map(complex, off)]
    sensor = {"name": "arm", "model": model, "off_reflection": pairs}
    if std is not None:
        sensor["off_reflection_std"] = std
    return wiforce.plan({"sensors": [sensor], "simulation": {"snr_db": 10}})


def test_errors_of_off_states_are_counted():
    """They were not: a pair known to 0.01 was said to read 4 N to 0.05 N while the tag turns."""
    plans = [plan_of(0.3, -0.3, std=std, model="line-900mhz-calibrated") for std in (0, 0.005)]
    errors = [expect(plan)[0].force_error_n for plan in plans]
    assert errors[1] > 1.5 * errors[0]
    limits = [expect(plan)[0].limited_by for plan in plans]
    assert limits == ["calibration", "off states"] and "off_reflection_std" in str(
        expect(plans[1])[0]
    )
    maps = [error_map(plan, 0, np.array([4.0]), np.array([40.0]))[0, 0, 0] for plan in plans]
    assert maps[1] > 1.5 * maps[0]


@pytest.mark.parametrize("wrong", [False, True])
def test_bound_is_the_spread_of_readings_of_a_tag_that_turns(wrong):
    """Of noise; and of off states that are wrong by what is stated to add as much."""
    off = np.array([0.3, -0.3])
    plan = plan_of(*off, std=0)
    model, rng = plan.sensors[0].model, np.random.default_rng(5)
    noise = np.radians(phase_std_deg(plan)[0])
    line = PressedLine(plan.sensors[0], 900e6, PRESS)
    free_std_n = line.stds(off, noise, 0.0)[0, 0]
    known_to = free_std_n / line.stds(off, 0 * noise, 1.0)[0, 0]
    untouched = np.exp(1j * np.radians(model.untouched_deg()))

    def ends(press, other):
        psi = np.radians(np.ravel(model.phases_deg(press[0], press[1])))
        return (np.exp(1j * psi) - other) / (untouched - other)

    errors = []
    for _ in range(200):
        turn = np.exp(rng.normal(0, 0.05) + 1j * rng.uniform(-0.7, 0.7))
        parts = rng.standard_normal((2, 2))
        is_off = off + wrong * known_to * (parts[0] + 1j * parts[1])
        size = np.abs(untouched - off)
        received = turn * ends((FORCE_N, LOCATION_MM), is_off)
        if not wrong:
            received = received + noise / size * turn * (parts[0] + 1j * parts[1])

        def residual(x, received=received, size=size):
            apart = (ends(x[:2], off) * np.exp(x[2] + 1j * x[3]) - received) * size / noise
            return np.concatenate([apart.real, apart.imag])

        start = np.array([FORCE_N, LOCATION_MM, np.log(abs(turn)), np.angle(turn)])
        errors.append(least_squares(residual, start, x_scale=[1, 1, 0.01, 0.01]).x - start)
    assert np.std(errors, axis=0)[0] == pytest.approx(free_std_n, rel=0.2)
    sensor = dataclasses.replace(plan.sensors[0], off_reflection_std=wrong * known_to)
    turn_std = PressedLine(sensor, 900e6, PRESS).turn_std_deg(np.degrees(noise))
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
