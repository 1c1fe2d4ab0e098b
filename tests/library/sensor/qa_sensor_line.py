# SPDX-License-Identifier: GPL-3.0-or-later
"""The physical line: what is pressed in simulations."""

import math
from pathlib import Path

import numpy as np
import pytest
from gnuradio.wiforce._config import DATA_DIR
from gnuradio.wiforce.calibration.tables import read_vna_csv
from gnuradio.wiforce.sensor import load_sensor
from gnuradio.wiforce.sensor.line import ContactLaw, round_trip_deg_per_mm, shorting_points_mm

NAMES = {"line-900mhz": 900e6, "line-2400mhz": 2400e6}


def movement_mm(name, location):
    """How far both shorting points move towards their ends from 2 to 8 N, out of the phases."""
    model = load_sensor(name)
    phases = model.phases_deg(np.linspace(2, 8, 61), location)
    turned = np.unwrap(np.radians(phases), axis=0)
    two_beta = 4 * math.pi * NAMES[name] / 299_792_458 / 1000
    return (turned[-1] - turned[0]) / two_beta


@pytest.mark.parametrize("name", NAMES)
def test_the_short_moves_with_force_as_its_file_says(name):
    near, far = movement_mm(name, 20.0)
    assert 4.4 <= near <= 5.2 and 0.8 <= far <= 1.2
    assert movement_mm(name, 60.0)[::-1] == pytest.approx([near, far], abs=1e-6)
    middle = movement_mm(name, 40.0)
    assert middle[0] == pytest.approx(middle[1], abs=1e-6) and far < middle[0] < near


@pytest.mark.parametrize("name", NAMES)
def test_phases_are_those_of_a_short_and_of_an_open_line(name):
    model = load_sensor(name)
    degrees_per_mm = 720 * NAMES[name] / 299_792_458e3
    assert model.untouched_deg() == pytest.approx(
        [(-degrees_per_mm * 80 + 180) % 360 - 180] * 2, abs=1e-9
    )
    # at the onset the short has no width: it is where the press is
    phases = model.phases_deg(model.onset_force_n, 30.0)
    expected = [180 - degrees_per_mm * d for d in (30.0, 50.0)]
    assert np.abs(np.exp(1j * np.radians(phases - expected)) - 1).max() < 1e-6


def test_below_the_onset_the_line_is_untouched():
    model = load_sensor("line-900mhz")
    phases = model.phases_deg([0.0, 0.89, 0.9, 0.91], 35.0)
    assert np.allclose(phases[:2], model.untouched_deg())
    assert np.abs(phases[2] - phases[1]).min() > 20


def test_the_contact_solves_the_beam_on_its_foundation():
    law = ContactLaw(0.9, 3.95, 0.68, 7.0)
    for force in (0.95, 2.0, 5.0, 12.0):
        half = law.extents_mm(force, 40.0, 80.0)
        assert half[0] == half[1]
        u = half[0] / 3.95
        # deflected by exactly the gap at the edge of the short
        assert math.exp(-u) * (math.cos(u) + math.sin(u)) == pytest.approx(0.9 / force, rel=1e-9)


def test_published_short_moves_further_than_that_of_the_line_as_docs_say():
    """`line-*` is no fit: who compares simulated errors with the paper's must know by how much."""
    moved = {}
    for mhz in (900, 2400):
        table = read_vna_csv(Path(DATA_DIR) / "data" / "paper" / "vna.csv", mhz * 1e6)
        for place, port in {*zip(table.location_mm, table.port, strict=True)}:
            own = table.take((table.location_mm == place) & (table.port == port))
            phase = np.unwrap(own.phase_deg, period=360)
            first_n = max(2.0, own.force_n.min())
            change = np.diff(np.polyval(np.polyfit(own.force_n, phase, 3), [first_n, 7.65]))[0]
            moved[mhz, int(place), int(port)] = change / round_trip_deg_per_mm(mhz * 1e6)
    near, far = [moved[900, 20, 1], moved[900, 60, 2]], [moved[900, 20, 2], moved[900, 60, 1]]
    assert near == pytest.approx([8.1, 7.5], abs=0.06)
    assert far == pytest.approx([-0.7, 0.1], abs=0.06)
    middle = [moved[mhz, 40, port] for mhz in (900, 2400) for port in (1, 2)]
    assert middle == pytest.approx([3.1, 2.8, 4.4, 4.4], abs=0.06)
    assert moved[2400, 20, 1] == pytest.approx(5.1, abs=0.06)
    law = load_sensor("line-900mhz").contact
    for place, expected in ((20.0, [4.7, 1.0]), (40.0, [2.9, 2.9])):
        low, high = shorting_points_mm(law, [2.0, 7.65], place, 80.0)
        assert low - high == pytest.approx(expected, abs=0.06)


def test_a_press_by_the_end_shorts_the_connector_and_no_further():
    law = ContactLaw(0.9, 3.95, 0.68, 7.0)
    assert shorting_points_mm(law, 8.0, 3.0, 80.0)[0] == 0.0


@pytest.mark.parametrize("name", ["line-900mhz", "line-900mhz-calibrated", "plain-trace-900mhz"])
def test_phases_of_an_unknown_force_are_unknown_rather_than_untouched(name):
    model = load_sensor(name)
    known = model.phases_deg([4.0, 0.0], 45.0)
    phases = model.phases_deg([np.nan, 4.0, 0.0], 45.0)
    assert np.isnan(phases[0]).all() and np.array_equal(phases[1:], known)
