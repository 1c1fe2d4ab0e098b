# SPDX-License-Identifier: GPL-3.0-or-later
"""Phases of an explanation where off states differ, and how exactly they are stated."""

import numpy as np
import pytest
from gnuradio import wiforce
from gnuradio.wiforce.press.explanations import PRESSED
from gnuradio.wiforce.wiforce_kernels import press_outcome, press_reading, sensor_group

MODEL = wiforce.load_sensor("line-900mhz")
OFF, UNTOUCHED_DEG, PSI_DEG = np.array([0.3, -0.2 + 0.2j]), (30.0, -110.0), (75.0, 100.0)


def ratio(psi_deg, off=OFF):
    """R of both ends by definition."""
    untouched, now = np.exp(1j * np.radians([UNTOUCHED_DEG, psi_deg]))
    return (now - off) / (untouched - off)


def read(ratios, std_deg=0.0, off_std=0.0, tag_ratio=0.0):
    """Phases and their standard deviations, deg."""
    reading = press_reading(
        MODEL.inverter(900e6).posterior,
        np.radians(UNTOUCHED_DEG),
        OFF,
        off_std,
        True,
        tag_ratio,
        0.0,
        [1] * 7,
        [9e9, 9e9, 0.01],
    )
    found = np.zeros(1, press_outcome)
    found["weight"], found["is"], found["known"] = 1, PRESSED, True
    found["mean"]["phase"], found["mean"]["amplitude"] = np.angle(ratios), np.log(np.abs(ratios))
    found["mean"]["variance"] = np.radians(std_deg) ** 2
    group = np.zeros(1, sensor_group)
    group["readable"] = True
    (row,) = reading.read(found, group, False)
    return row["phases_deg"], row["psi_std_deg"]


def turned_deg(psi_deg, off=OFF):
    """By how much arg R changes."""
    return np.degrees(np.angle(ratio(psi_deg, off) / ratio(PSI_DEG)))


@pytest.mark.parametrize("gain", [0.5, 1.0, 1.7])
def test_phase_where_off_states_differ_is_that_of_any_gain(gain):
    """A tag that turns changes |R| as well, which must not change the phase."""
    assert read(gain * ratio(PSI_DEG))[0] == pytest.approx(PSI_DEG)


def test_phase_std_contains_the_noise_and_the_error_of_the_off_states():
    step, off_step = 1e-3, 1e-5
    slope = turned_deg(np.add(PSI_DEG, step)) / step
    by_off = [turned_deg(PSI_DEG, OFF + off_step * part) / off_step for part in (1, 1j)]
    assert read(ratio(PSI_DEG), std_deg=0.1)[1] == pytest.approx(0.1 / slope, rel=1e-3)
    expected = 0.01 * np.hypot(*by_off) / slope
    assert read(ratio(PSI_DEG), off_std=0.01)[1] == pytest.approx(expected, rel=1e-3)
    both = read(ratio(PSI_DEG), std_deg=0.1, off_std=0.01)[1]
    assert both == pytest.approx(np.hypot(0.1 / slope, expected), rel=1e-3)


def test_phase_std_contains_what_a_ratio_of_antennas_bends():
    """By |1 - exp(j arg R)| times the tag, of which half the power lies along the phase."""
    step = 1e-3
    slope = turned_deg(np.add(PSI_DEG, step)) / step
    bend_deg = np.degrees(0.01 * np.abs(1 - np.exp(1j * np.angle(ratio(PSI_DEG)))) / np.sqrt(2))
    found = read(ratio(PSI_DEG), tag_ratio=0.01)[1]
    assert found == pytest.approx(np.abs(bend_deg / slope), rel=1e-3)


@pytest.mark.parametrize("correlated", [0.0, 0.8, -0.8])
@pytest.mark.parametrize("common_deg, apart_deg", [(0.5, 0.05), (0.05, 0.5), (0.3, 0.3)])
def test_force_std_follows_what_both_ends_share(common_deg, apart_deg, correlated):
    """Against presses whose untouched line was turned and parted by so much, seed 1."""
    off, untouched = np.zeros(2), MODEL.untouched_deg(900e6)
    psi = np.reshape(MODEL.phases_deg(3.0, 30.0, 900e6), 2)
    inverter = MODEL.inverter(900e6)
    reading = press_reading(
        inverter.posterior, np.radians(untouched), off, 0.0, False, 0.0, 0.0, [1] * 7, [9e9] * 3
    )
    found = np.zeros(1, press_outcome)
    found["weight"], found["is"], found["known"] = 1, PRESSED, True
    found["mean"]["phase"] = np.radians(psi - untouched)
    found["mean"]["variance"] = np.radians(0.02) ** 2
    found["common_variance"] = np.radians(common_deg) ** 2
    found["difference_variance"] = np.radians(apart_deg) ** 2
    found["covariance"] = correlated * np.radians(common_deg) * np.radians(apart_deg)
    group = np.zeros(1, sensor_group)
    group["readable"] = True
    (row,) = reading.read(found, group, True)
    common, apart = np.random.default_rng(1).normal(size=(2, 2000))
    apart = correlated * common + np.sqrt(1 - correlated**2) * apart
    common, apart = common_deg * common, apart_deg * apart
    drawn = inverter.invert(psi + np.stack([common + apart / 2, common - apart / 2], axis=1), 0.02)
    # 2000 draws tell a standard deviation to 1.6 %; that of a mode is of phases linear in force.
    assert row["force_std_n"] == pytest.approx(np.std(drawn.force_n), rel=0.15)
    assert row["location_std_mm"] == pytest.approx(np.std(drawn.location_mm), rel=0.15)
