# SPDX-License-Identifier: GPL-3.0-or-later
"""The model of one carrier: a curve at each location, and how to go between locations."""

import numpy as np

from ..sensor import curves, line
from ..sensor.location import learn_interpolation
from ..signal.carrier import wrap_deg
from .data import compared_forces
from .fit import CurveFitter, noise_and_misfit
from .hysteresis import find_hysteresis

# No press is so wide that it moves a short by more than this beyond what the line does.
_LARGEST_EXTENT_MM = 30.0


def fit_carrier(data, form, knots, length_mm, permittivity):
    """A :class:`.curves.Carrier` of one carrier's data."""
    fitter = CurveFitter(form, knots, [(c.force_n, c.added_deg) for c in data.all_curves()])
    fits = [[fitter.fit(c.force_n, c.added_deg) for c in port] for port in data.curves]
    quality = [noise_and_misfit(port) for port in fits]
    coefficients = np.array([[fit.coefficients for fit in port] for port in fits])
    covariance = np.array(
        [
            [noise**2 * fit.unit_covariance for fit in port]
            for port, (noise, _) in zip(fits, quality, strict=True)
        ]
    )
    interpolation = interpolate(
        data, coefficients, covariance, form, knots, length_mm, data.location_mm
    )
    difference_n = find_hysteresis(
        data.all_curves(), [fit for port in fits for fit in port], fitter
    )
    untouched = data.untouched_deg
    if untouched is None:
        psi = line.open_phase_deg(length_mm, data.frequency_hz, permittivity)
        untouched = (float(wrap_deg(psi)),) * 2
    return curves.Carrier(
        frequency_hz=data.frequency_hz,
        untouched_deg=untouched,
        location_mm=data.location_mm,
        force_span_n=np.array(
            [
                [
                    max(port[j].force_n[0] for port in data.curves),
                    min(port[j].force_n[-1] for port in data.curves),
                ]
                for j in range(len(data.location_mm))
            ]
        ),
        coefficients_deg=coefficients,
        covariance_deg2=covariance,
        noise_deg=tuple(noise for noise, _ in quality),
        misfit_deg=tuple(misfit for _, misfit in quality),
        interpolation=interpolation.transitions,
        hysteresis_n=None if difference_n is None else difference_n / 2,
    )


def interpolate(data, coefficients, covariance, form, knots, length_mm, location_mm):
    """How to go between some of the locations, from coefficients (2, J, K) and their covariance."""
    basis = curves.force_basis(form, knots)(compared_forces(data))
    values = np.einsum("pjk,fk->pjf", coefficients, basis)
    noise = np.mean(np.einsum("fk,pjkm,fm->pjf", basis, covariance, basis))
    slope = line.round_trip_deg_per_mm(data.frequency_hz)
    physical = np.ptp(values, axis=1).max() < _LARGEST_EXTENT_MM * slope
    return learn_interpolation(location_mm, length_mm, values, noise, physical)
