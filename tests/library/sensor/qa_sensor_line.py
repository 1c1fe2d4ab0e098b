# SPDX-License-Identifier: GPL-3.0-or-later
"""Lines by their physics: what is pressed in simulations, and what is to be built."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest
import scipy.constants  # noqa: F401  scikit-rf uses it without importing it
from gnuradio.wiforce._config import DATA_DIR
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.sensor import load_sensor
from gnuradio.wiforce.sensor.line import ContactLaw
from gnuradio.wiforce.sensor.microstrip import (
    Microstrip,
    strips_impedance_ohm,
    tag_timer,
)

NAMES = {"line-900mhz": 900e6, "line-2400mhz": 2400e6}
LAW = ContactLaw(decay_length_mm=3.95, asymmetry=0.68, fade_mm=7.0)


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
    for force in (0.95, 2.0, 5.0, 12.0):
        half = 40.0 - LAW.shorting_points_mm(force, 40.0, 80.0, 0.9)
        assert half[0] == half[1]
        u = half[0] / 3.95
        # deflected by the gap at the edge of the short
        assert math.exp(-u) * (math.cos(u) + math.sin(u)) == pytest.approx(0.9 / force, rel=1e-8)
    # A press by the end shorts the connector, and no further.
    assert LAW.shorting_points_mm(8.0, 3.0, 80.0, 0.9)[0] == 0.0


@pytest.mark.parametrize("name", ["line-900mhz", "line-900mhz-calibrated", "plain-trace-900mhz"])
def test_phases_of_an_unknown_force_are_unknown_rather_than_untouched(name):
    model = load_sensor(name)
    known = model.phases_deg([4.0, 0.0], 45.0)
    phases = model.phases_deg([np.nan, 4.0, 0.0], 45.0)
    assert np.isnan(phases[0]).all() and np.array_equal(phases[1:], known)


@pytest.mark.parametrize(
    ("ratio", "permittivity", "ohm"),
    [(0.5, 1.05, 164.152), (0.5, 9.8, 66.5385), (3.97, 1.05, 56.9254), (3.97, 9.8, 21.0555)],
)
def test_impedance_over_a_wide_ground_is_that_of_scikit_rf(ratio, permittivity, ohm):
    """Its MLine, of Hammerstad and Jensen, who state 0.03 % in air; 40 heights leave 0.15 %."""
    line = Microstrip(ratio, 1.0, 1000.0, permittivity=permittivity)
    assert line.impedance_ohm == pytest.approx(ohm, rel=3e-3)


def test_strips_narrower_than_high_equal_two_wires():
    """A flat strip acts as a wire of a quarter of its width: 120 ln(4 h / w) ohm for far strips."""
    found = strips_impedance_ohm(0.01, 0.01, 1.0)
    assert found == pytest.approx(119.917 * np.log(4 / 0.01), rel=1e-4)


def test_reflection_equals_that_of_a_line_of_scikit_rf():
    import skrf

    line, hertz = Microstrip(permittivity=2.0), np.linspace(50e6, 3e9, 60)
    frequency = skrf.Frequency.from_f(hertz, unit="Hz")
    gamma = 2j * np.pi * hertz * np.sqrt(line.effective_permittivity) / 299_792_458
    own = np.full(len(hertz), line.impedance_ohm)
    media = skrf.media.DefinedGammaZ0(frequency, z0_port=50.0, z0=own, gamma=gamma)
    s11 = media.line(80e-3, unit="m").s[:, 0, 0]
    assert line.reflection_db(hertz) == pytest.approx(20 * np.log10(np.abs(s11)), abs=1e-6)
    assert line.matched().reflection_db(hertz).max() < -100
    with pytest.raises(InputError, match="impedance: is reached at no height"):
        line.matched(1000.0)


def test_best_match_lies_where_the_published_field_simulations_have_it():
    published = {}
    with open(Path(DATA_DIR) / "data" / "paper" / "hfss_s11.csv") as stream:
        for row in csv.DictReader(stream):
            curve = published.setdefault((float(row["ground_width_mm"]), row["freq_mhz"]), [])
            curve.append((float(row["s11_db"]), float(row["width_to_height_ratio"])))
    optima = {key: min(curve)[1] for key, curve in published.items()}
    found = {ground: 2.5 / Microstrip(ground_mm=ground).matched().height_mm for ground in (2.5, 6)}
    for (ground, mhz), ratio in optima.items():
        # Connectors, which are not in the formulas, shift the optimum with the carrier.
        assert ratio == pytest.approx(found[ground], abs=0.4 if mhz == "900" else 0.85)
    assert found[2.5] - found[6] == pytest.approx(optima[2.5, "900"] - optima[6.0, "900"], abs=0.1)


@pytest.mark.parametrize("clock_hz", [50.0, 139.0, 165.0, 765.0, 1000.0, 1035.0, 1400.0, 3800.0])
def test_timer_is_within_one_percent_of_the_clock(clock_hz):
    found = tag_timer(clock_hz)
    divisor = {1: 1, 2: 8, 3: 64}[found.prescaler]
    assert found.clock_hz == pytest.approx(4e6 / (16 * found.steps * divisor), rel=1e-12)
    assert abs(found.clock_hz / clock_hz - 1) < 0.01
    assert found.steps <= 256 and found.steps * divisor >= 64
    with pytest.raises(InputError, match="clock_hz: is not within reach"):
        tag_timer(100 * clock_hz)
