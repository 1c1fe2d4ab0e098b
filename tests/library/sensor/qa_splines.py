# SPDX-License-Identifier: GPL-3.0-or-later
"""Splines of calibrated sensors, against those of SciPy."""

import numpy as np
import pytest
from gnuradio import wiforce
from gnuradio.wiforce.sensor.inversion import ForwardMap
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


def test_inversion_table_has_values_and_slopes_of_the_bicubic_spline():
    """Every inverted reading is interpolated from this table."""
    model = wiforce.load_sensor("line-900mhz-calibrated")
    forward = ForwardMap(model, (0,))
    table, logs = forward.table(), np.log(forward.force_n)
    for phase in (0, 1):
        plane = forward.phase_deg[..., phase]
        spline = interpolate.RectBivariateSpline(logs, forward.location_mm, plane, s=0)
        for column, (force, location) in enumerate([(0, 0), (1, 0), (0, 1), (1, 1)]):
            expected = spline(logs, forward.location_mm, dx=force, dy=location)
            limit = 1e-9 * np.abs(expected).max()
            assert np.abs(table[:, :, phase, column] - expected).max() < limit
