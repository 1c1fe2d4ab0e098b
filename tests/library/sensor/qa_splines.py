# SPDX-License-Identifier: GPL-3.0-or-later
"""Splines of calibrated sensors, against those of SciPy."""

import numpy as np
import pytest
from gnuradio import wiforce
from gnuradio.wiforce.sensor.splines import CubicSpline, basis_splines
from scipy import interpolate


def test_cubic_spline_is_that_of_scipy():
    """Phases between calibrated locations are read from these."""
    rng = np.random.default_rng(1)
    nodes, values = np.sort(rng.uniform(0, 5, 12)), rng.standard_normal((12, 3, 2))
    at = np.concatenate([rng.uniform(nodes[0], nodes[-1], 40), nodes]).reshape(4, 13)
    expected = interpolate.CubicSpline(nodes, values)(at)
    np.testing.assert_allclose(CubicSpline(nodes, values)(at), expected, atol=1e-12)


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


def test_model_that_inverts_has_values_and_slopes_of_the_bicubic_spline():
    """Every inverted reading is interpolated from its table."""
    model = wiforce.load_sensor("line-900mhz-calibrated")
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
