# SPDX-License-Identifier: GPL-3.0-or-later
"""Inversion: its splines, the right press, its standard deviation, and flags."""

import numpy as np
import pytest
from gnuradio.wiforce.calibration.calibrate import calibrate
from gnuradio.wiforce.calibration.tables import CalibrationTable, measure_vna
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.sensor import load_sensor
from gnuradio.wiforce.sensor.splines import CubicSpline, basis_splines, node_slopes
from scipy import interpolate
from scipy.optimize import fsolve
from sensor_laws import wrap

PLACES = (20, 30, 40, 50, 60)


@pytest.fixture(scope="module")
def model():
    return load_sensor("line-900mhz-calibrated")


@pytest.fixture(scope="module")
def both():
    """One model of two carriers."""
    tables = [
        measure_vna(load_sensor(f"line-{mhz}mhz"), PLACES, np.arange(1, 8.1, 0.25), 0.2, seed=mhz)
        for mhz in (900, 2400)
    ]
    return calibrate(CalibrationTable.joined(tables), "both")


def presses(count, seed=1, span=(1.5, 7.5), places=(21, 59)):
    rng = np.random.default_rng(seed)
    return rng.uniform(*span, count), rng.uniform(*places, count), rng


def slopes(model, force_n, location_mm):
    """Changes (2, 2) of both phases, in degrees per N and per mm."""
    force = model.phases_deg(force_n + 0.01, location_mm) - model.phases_deg(
        force_n - 0.01, location_mm
    )
    place = model.phases_deg(force_n, location_mm + 0.05) - model.phases_deg(
        force_n, location_mm - 0.05
    )
    return np.column_stack([force / 0.02, place / 0.1])


def test_invert_compact_posterior_is_the_solution_with_its_covariance(model):
    force, place, rng = presses(300)
    phases = model.phases_deg(force, place) + rng.normal(0, 0.1, (300, 2))
    found = model.invert(phases, 0.1)
    for i in range(0, 300, 10):
        # the posterior is compact here: two phases have one solution, which is its mode
        exact = fsolve(lambda at, i=i: model.phases_deg(*at) - phases[i], (force[i], place[i]))
        assert found.force_n[i] == pytest.approx(exact[0], abs=1e-3)
        assert found.location_mm[i] == pytest.approx(exact[1], abs=1e-3)
        back = np.linalg.inv(slopes(model, *exact))
        variance = 0.1**2 + model.model_std_deg(*exact) ** 2
        expected = back @ np.diag(variance) @ back.T
        # slopes from differences are within 1 % of those of the tables, and enter squared
        assert found.covariance[i] == pytest.approx(expected, rel=0.03, abs=1e-4)


def test_invert_batch_equals_single_readings(model):
    force, place, rng = presses(60, span=(0.95, 9.5), places=(16, 64))
    phases = model.phases_deg(force, place) + rng.normal(0, 0.5, (60, 2))
    std = rng.uniform(0.1, 2.0, (60, 2))
    batch = model.invert(phases, std)
    for i in range(60):
        one = model.invert(phases[i : i + 1], std[i])
        for name in ("force_n", "force_std_n", "location_mm", "location_std_mm", "covariance"):
            assert np.all(getattr(one, name)[0] == getattr(batch, name)[i])
        assert one.flags[0] == batch.flags[i]


def test_invert_outside_the_calibration_is_extrapolated(model):
    phases = model.phases_deg([4.0, 9.3, 4.0, 4.0], [40.0, 40.0, 63.0, 17.0])
    flags = model.invert(phases, 0.1).flags
    assert flags[0] == () and all("extrapolated" in flag for flag in flags[1:])


@pytest.mark.parametrize("name", ["paper-900mhz", "paper-2400mhz"])
@pytest.mark.parametrize("noise_deg", [0.2, 1.0, 3.0])
def test_invert_unobservable_force_is_never_confident(name, noise_deg):
    model, rng = load_sensor(name), np.random.default_rng(3)
    force = rng.uniform(1.0, 7.9, 4000)
    force = force[model.in_span(force, 40.0)]
    phases = model.phases_deg(force, 40.0)
    found = model.invert(phases + rng.normal(0, noise_deg, phases.shape), noise_deg)
    unobservable = np.array(["force-unobservable" in flags for flags in found.flags])
    error = np.abs(found.force_n - force)
    assert np.mean(unobservable) >= 0.999
    # Forces are uniform here, and log-uniform in the posterior: where 3 deg hide nearly all of
    # them, low ones are too likely.
    hidden = (name, noise_deg) == ("paper-2400mhz", 3.0)
    assert np.mean(error <= 2 * found.force_std_n) >= (0.98 if hidden else 0.99)
    exceeded = error[~unobservable] > 3 * found.force_std_n[~unobservable]
    assert np.count_nonzero(exceeded) <= (1 if hidden else 0)


def test_invert_known_location_is_kept(model):
    force, place, rng = presses(400)
    place = np.round(place, -1)
    phases = model.phases_deg(force, place) + rng.normal(0, 0.3, (400, 2))
    known = model.invert(phases, 0.3, location_mm=place)
    free = model.invert(phases, 0.3)
    some = model.invert(phases, 0.3, location_mm=np.where(np.arange(400) % 2, place, np.nan))
    for name in ("force_n", "force_std_n", "location_mm", "location_std_mm"):
        expected = np.where(np.arange(400) % 2, getattr(known, name), getattr(free, name))
        assert np.array_equal(getattr(some, name), expected)
    assert known.location_mm == pytest.approx(place) and np.all(known.location_std_mm == 0)
    # the two ends tell force and place nearly apart here: knowing the place gains some per cent
    assert np.mean(known.force_std_n / free.force_std_n) < 1.0
    assert 0.9 <= np.mean(np.abs(known.force_n - force) <= 2 * known.force_std_n) <= 0.99
    for i in range(5):
        forces = np.arange(0.95, 9.5, 0.002)
        away = wrap(phases[i] - model.phases_deg(forces, place[i])) ** 2
        weight = 1 / (0.3**2 + model.model_std_deg(forces, place[i]) ** 2)
        best = forces[np.argmin(np.sum(weight * away - np.log(weight), axis=1))]
        assert known.force_n[i] == pytest.approx(best, abs=0.01)
    with pytest.raises(InputError, match="location_mm: must lie from"):
        model.invert(phases[:1], 0.3, location_mm=79.5)


def test_invert_two_carriers_beat_either(both):
    force, place, rng = presses(40, seed=7)
    low = both.phases_deg(force, place, 900e6) + rng.normal(0, 1.0, (40, 2))
    high = both.phases_deg(force, place, 2400e6) + rng.normal(0, 1.0, (40, 2))
    fused = both.invert(np.hstack([low, high]), 1.0)
    alone = [both.invert(low, 1.0, frequency_hz=900e6), both.invert(high, 1.0, frequency_hz=2400e6)]
    error = np.abs(fused.force_n - force)
    assert np.median(error) < min(np.median(np.abs(a.force_n - force)) for a in alone) * 1.1
    assert np.mean(error <= 2 * fused.force_std_n) >= 0.85
    assert np.all(fused.force_std_n <= 1.05 * np.minimum(*(a.force_std_n for a in alone)))
    # phases of different presses at the two carriers fit none
    mixed = np.hstack([low[:1], both.phases_deg(force[:1], place[:1] + 8.0, 2400e6)])
    assert "inconsistent" in both.invert(mixed, 0.3).flags[0]


def test_invert_bad_arguments_are_refused_but_no_phases_are_none(model):
    assert model.invert(np.zeros((0, 2)), 0.1).force_n.shape == (0,)
    with pytest.raises(InputError, match="phases_deg: must have 2 columns"):
        model.invert([[1.0, 2.0, 3.0]])
    for std in (-0.1, np.nan, np.inf):
        for phases in ([[1.0, 2.0]], [[1.0, 2.0], [3.0, 4.0]]):
            with pytest.raises(InputError, match="std_deg: must be finite"):
                model.invert(phases, std)


def test_cubic_spline_is_that_of_scipy():
    """Phases between calibrated locations are read from these."""
    rng = np.random.default_rng(1)
    nodes, values = np.sort(rng.uniform(0, 5, 12)), rng.standard_normal((12, 3, 2))
    at = np.concatenate([rng.uniform(nodes[0], nodes[-1], 40), nodes]).reshape(4, 13)
    expected = interpolate.CubicSpline(nodes, values)(at)
    found = CubicSpline(nodes, values, node_slopes(nodes))(at)
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("derivative", [0, 1, 2])
def test_basis_splines_are_those_of_scipy(derivative):
    """The curves of a sensor file of form `spline` are sums of these."""
    rng = np.random.default_rng(2)
    inner = np.sort(rng.uniform(0, 5, 9))
    knots = np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])
    at = np.concatenate([rng.uniform(inner[0], inner[-1], 40), inner])
    spline = interpolate.BSpline(knots, np.eye(11), 3)
    expected = spline.derivative(derivative)(at) if derivative else spline(at)
    found = basis_splines(knots, at, derivative)
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


def test_model_that_inverts_has_values_and_slopes_of_the_bicubic_spline(model):
    """Every inverted reading is interpolated from its table."""
    inverter, rng = model.inverter(), np.random.default_rng(3)
    nodes = inverter.force_n, inverter.location_mm
    force, location = (rng.uniform(*each[[0, -1]], 50) for each in nodes)
    found, logs = inverter.at(force, location), np.log(force)
    planes = model.short_deg(nodes[0][:, None], nodes[1], 0)
    for phase in (0, 1):
        spline = interpolate.RectBivariateSpline(np.log(nodes[0]), nodes[1], planes[..., phase])
        np.testing.assert_allclose(found[0, :, phase], spline.ev(logs, location), rtol=1e-9)
        by_log_force = force * found[1, :, phase]
        np.testing.assert_allclose(by_log_force, spline.ev(logs, location, dx=1), atol=1e-7)
        np.testing.assert_allclose(found[2, :, phase], spline.ev(logs, location, dy=1), atol=1e-7)
