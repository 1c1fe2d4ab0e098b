# SPDX-License-Identifier: GPL-3.0-or-later
"""What reflective off states of the switches are worth: the bound against errors of draws."""

import numpy as np
import pytest
from gnuradio import wiforce
from gnuradio.wiforce.planning.expected import phase_std_deg
from gnuradio.wiforce.planning.off_states import off_states
from scipy.optimize import least_squares

FORCE_N, LOCATION_MM = 4.0, 40.0


def plan_of(*off):
    pairs = [[each.real, each.imag] for each in map(complex, off)]
    sensor = {"name": "arm", "model": "line-900mhz", "off_reflection": pairs}
    return wiforce.plan({"sensors": [sensor], "simulation": {"snr_db": 10}})


def judged(*off):
    (found,) = off_states(plan_of(*off))
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
    assert not list(off_states(plan_of(0.0, 0.0)))


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

        start = [FORCE_N, LOCATION_MM, np.log(abs(turn)), np.angle(turn)]
        errors.append(least_squares(residual, start, x_scale=[1, 1, 0.01, 0.01]).x[0] - FORCE_N)
    assert np.std(errors) == pytest.approx(found.free_std_n, rel=0.2)
