# SPDX-License-Identifier: GPL-3.0-or-later
"""Loading and unloading: distinguished in a table, reported by calibrate, covered by readings."""

from dataclasses import replace

import numpy as np
import pytest
from gnuradio.wiforce.calibration.calibrate import calibrate
from gnuradio.wiforce.calibration.data import sweep_directions
from gnuradio.wiforce.calibration.tables import CalibrationTable, measure_vna
from gnuradio.wiforce.scene.effects import Beam
from gnuradio.wiforce.scene.simulated import Press
from gnuradio.wiforce.sensor import load_sensor
from gnuradio.wiforce.simulation.presses import press_force, shown_force

TRUE = load_sensor("line-900mhz")
PLACES_MM = (20.0, 30.0, 40.0, 50.0, 60.0)
NOISE_DEG = 0.2
TIMES_S = np.linspace(0.5, 19.5, 39)


def press(largest_n, place_mm):
    """A press that rises for ten seconds and falls for ten."""
    return Press(
        sensor="arm", start_s=0.0, rise_s=10.0, hold_s=0.0, force_n=largest_n,
        end_force_n=largest_n, location_mm=place_mm,
    )  # fmt: skip


def table(beam, times_s=TIMES_S):
    """What a VNA shows of presses up to 8 N at five locations, row by row in time."""
    rng = np.random.default_rng(3)
    untouched = measure_vna(TRUE, [40.0], [2.0], NOISE_DEG)
    rows = []
    for place in PLACES_MM:
        one = press(8.0, place)
        force, shown = press_force(one, times_s), shown_force(one, times_s, beam)
        phases = TRUE.phases_deg(shown, place)
        phases = phases + NOISE_DEG * rng.standard_normal(phases.shape)
        for port in (1, 2):
            for f, phase in zip(force, phases[:, port - 1], strict=True):
                rows.append((0, 900e6, place, port, f, phase, ""))
    touched = CalibrationTable.from_rows("bench", rows)
    return CalibrationTable.joined([untouched.take(untouched.untouched), touched])


@pytest.fixture(scope="module")
def soft():
    return calibrate(table(Beam(hysteresis=0.06, creep=0.0)), "soft")


def rigid(model):
    """The same calibration without what it knows of hysteresis."""
    return replace(model, carriers=tuple(replace(c, hysteresis_n=None) for c in model.carriers))


def within_two_std(model, beam):
    """Share of forces inside two standard deviations, loading and unloading, up to 6 N."""
    inside = []
    for place in (25.0, 36.0, 45.0, 54.0):
        one = press(6.0, place)
        force = press_force(one, TIMES_S)
        phases = TRUE.phases_deg(shown_force(one, TIMES_S, beam), place)
        found = model.invert(phases, NOISE_DEG)
        inside.append((np.abs(found.force_n - force) <= 2 * found.force_std_n)[force > 1.2])
    return np.mean(np.concatenate(inside))


@pytest.mark.parametrize(
    ("force_n", "expected"),
    [
        (np.r_[1:9, 7:0:-1], [1] * 8 + [-1] * 7),
        (np.r_[1:9, 1:9], [1] * 8 + [0] + [1] * 7),
        # the readings of a load cell while the force hardly changes
        ([1, 2, 4, 3.9, 4.1, 6, 8, 7.9, 8, 5, 3, 3.1, 1], [1] * 9 + [-1] * 4),
        (np.random.default_rng(1).permutation(np.linspace(1, 8, 30)), [0] * 30),
    ],
)
def test_sweep_directions_follow_from_the_order_of_rows(force_n, expected):
    assert sweep_directions(np.array(force_n, float)).tolist() == expected


def test_calibrate_both_branches_finds_half_the_largest_difference(soft):
    # 4 h F (P - F) / P has its largest value h P at half of P
    assert soft.carriers[0].hysteresis_n == pytest.approx(0.06 * 8 / 2, rel=0.15)


def test_readings_of_a_soft_beam_lie_inside_their_standard_deviations(soft):
    beam = Beam(hysteresis=0.06, creep=0.0)
    assert within_two_std(soft, beam) >= 0.95
    assert within_two_std(rigid(soft), beam) < 0.85


def test_one_branch_says_nothing_about_hysteresis():
    loading = table(Beam(hysteresis=0.06, creep=0.0), TIMES_S[:20])
    assert calibrate(loading, "loaded").carriers[0].hysteresis_n is None


def test_an_elastic_beam_shows_no_difference():
    model = calibrate(table(Beam(hysteresis=0.0, creep=0.0)), "elastic")
    assert model.carriers[0].hysteresis_n == 0.0
