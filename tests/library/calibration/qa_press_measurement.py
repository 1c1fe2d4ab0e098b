# SPDX-License-Identifier: GPL-3.0-or-later
"""Measurements of a guided calibration are stored only when the press held still."""

from dataclasses import replace

import numpy as np
import pytest
from gnuradio.wiforce.calibration.session import (
    measure_press,
    measure_untouched,
    steady_deg,
)
from gnuradio.wiforce.errors import InputError
from guided_presses import HandHeldSensor

LARGEST_DEG = steady_deg(900e6)


@pytest.fixture
def sensor():
    held = HandHeldSensor()
    held.force_n = 3.0
    return held


def test_press_that_holds_still_gives_mean_phases_and_their_error(sensor):
    press = measure_press(sensor.readings(), 40.0, 3.0, LARGEST_DEG)
    error = np.array(press.phase_deg) - sensor.model.phases_deg(3.0, 40.0)
    assert np.all(np.abs(error) < 4 * np.array(press.phase_std_deg))
    assert press.phase_std_deg == pytest.approx((0.1 / 14**0.5,) * 2, rel=0.6)
    assert press.groups == 14 and not press.untouched


def test_press_near_the_wrap_of_the_angle_keeps_its_mean(sensor):
    readings = [
        replace(each, phase1_deg=(179.9, -179.9)[i % 2]) for i, each in enumerate(sensor.readings())
    ]
    press = measure_press(readings, 40.0, 3.0, LARGEST_DEG)
    assert abs(abs(press.phase_deg[0]) - 180) < 0.01


def test_steady_presses_with_more_noise_are_not_refused():
    """A user with a weak tag could not calibrate."""
    noisy = HandHeldSensor(noise_deg=1.0)
    noisy.force_n = 3.0
    for _ in range(200):
        measure_press(noisy.readings(), 40.0, 3.0, LARGEST_DEG)


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (lambda r: [*r[:-1], replace(r[-1], phase1_deg=r[-1].phase1_deg + 3)], "1 changed by 3"),
        (
            lambda r: [replace(x, phase2_deg=x.phase2_deg - 0.15 * i) for i, x in enumerate(r)],
            "port 2 changed by 1",
        ),
        (
            lambda r: [*r[:-3], *(replace(x, touch=0) for x in r[-3:])],
            "must be touched; no touch in 3 of 14 readings",
        ),
        (
            lambda r: [*r[:4], replace(r[4], touch=None, phase1_deg=None), *r[5:]],
            "the tag was not in 1 of 14 readings",
        ),
        (lambda r: r[5:10], "must have at least 8 readings, got 5"),
        (lambda r: [*r[:7], replace(r[7], flags=("gap",)), *r[8:]], "flagged; 'gap' in 1 of 14"),
        (lambda r: [*r[:7], replace(r[7], flags=("moved",)), *r[8:]], "the tag or an antenna mov"),
    ],
)
def test_press_that_is_not_measured_well_is_refused(sensor, change, rule):
    with pytest.raises(InputError, match=rule):
        measure_press(change(sensor.readings()), 40.0, 3.0, LARGEST_DEG)


@pytest.mark.parametrize("flag", ["inconsistent", "weak"])
def test_press_with_a_flag_of_the_provisional_model_is_measured(sensor, flag):
    """The model is what the calibration replaces: its opinion must not prevent that."""
    sensor.flags = (flag,)
    assert measure_press(sensor.readings(), 40.0, 3.0, LARGEST_DEG).groups == 14


def test_untouched_sensor_that_is_touched_or_disturbed_is_refused(sensor):
    with pytest.raises(InputError, match="must be released; a touch in 14 of 14"):
        measure_untouched(sensor.readings(), LARGEST_DEG)
    sensor.force_n, sensor.flags = 0.0, ("inconsistent",)
    with pytest.raises(InputError, match="reference was disturbed"):
        measure_untouched(sensor.readings(), LARGEST_DEG)


def test_press_whose_phases_scatter_is_refused():
    noisy = HandHeldSensor(noise_deg=8.0)
    noisy.force_n = 3.0
    with pytest.raises(InputError, match="must be received better"):
        measure_press(noisy.readings(), 40.0, 3.0, LARGEST_DEG)
