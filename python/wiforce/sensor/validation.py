# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of calibrated curves on forces, presses and locations that they have not seen."""

import numpy as np

from . import curves
from .calibration_data import compared_forces
from .carrier_fit import interpolate
from .fit import CurveFitter, force_knots

_BLOCKS = 6
# Samples from which a curve is drawn when some are left out.
_LEAST_LEFT = 5


def validate_forms(data):
    """Errors of each form on data it has not seen.

    Where locations were pressed more than once, a press is left out at a time; else a block of
    neighbouring forces. The first and the last block of a location lie beyond what is left.

    Returns
    -------
    dict
        ``left_out`` (``press`` or ``forces``); ``best``, the form chosen by :func:`best_form`,
        ``auto`` without the blocks that lie beyond and ``auto-beyond`` with them; ``forms``: for
        each form the rms errors in degrees and the number of samples predicted.
    """
    several = any(len(set(c.press)) > 1 for d in data for c in d.all_curves())
    squares = {
        form: [fold for d in data for fold in _left_out(d, form, several)] for form in curves.FORMS
    }
    inside = {form: [s for s, rim in folds if not rim] for form, folds in squares.items()}
    everywhere = {form: [s for s, _ in folds] for form, folds in squares.items()}
    return {
        "left_out": "press" if several else "forces",
        "best": {"auto": best_form(inside), "auto-beyond": best_form(everywhere)},
        "forms": {
            form: {
                "inside_deg": _root_mean(inside[form]),
                "everywhere_deg": _root_mean(everywhere[form]),
                "samples": sum(map(len, everywhere[form])),
            }
            for form in curves.FORMS
            if inside[form]
        },
    }


def _root_mean(squares):
    return round(float(np.sqrt(np.mean(np.concatenate(squares)))), 4)


def best_form(squares):
    """The simplest form that does as well as the best on what it has not seen.

    As well: the mean difference of squared errors over what was left out is within its own standard
    error (the one-standard-error rule, L. Breiman et al., *Classification and Regression Trees*,
    1984, section 3.4.3).

    Parameters
    ----------
    squares : dict
        For each form a list of squared errors, an array for everything left out together.
    """
    means = {form: np.array([np.mean(s) for s in folds]) for form, folds in squares.items()}
    if not all(mean.size for mean in means.values()):
        return "power"
    best = min(means, key=lambda form: means[form].mean())
    for form in ("power", "cubic", "spline"):
        worse = means[form] - means[best]
        error = np.std(worse, ddof=1) / np.sqrt(worse.size) if worse.size > 1 else 0.0
        if worse.mean() <= error:
            return form
    return best


def _left_out(data, form, by_press):
    """Squared errors of everything left out in turn, and whether it lies beyond what is left."""
    knots = force_knots(form, np.concatenate([c.force_n for c in data.all_curves()]))
    samples = [(c.force_n, c.added_deg) for c in data.all_curves()]
    fitter = CurveFitter(form, knots, samples)
    folds = []
    for curve in data.all_curves():
        for out, rim in [] if curve.copied else _folds(curve, by_press):
            if not np.any(out) or np.count_nonzero(~out) < _LEAST_LEFT:
                continue
            fit = fitter.fit(curve.force_n[~out], curve.added_deg[~out])
            error = curve.added_deg[out] - fitter.value(fit, curve.force_n[out])
            folds.append((error**2, rim))
    return folds


def _folds(curve, by_press):
    if by_press:
        return [(curve.press == press, False) for press in dict.fromkeys(curve.press)]
    block = np.minimum(np.arange(curve.force_n.size) * _BLOCKS // curve.force_n.size, _BLOCKS - 1)
    return [(block == b, b in (0, _BLOCKS - 1)) for b in range(_BLOCKS)]


def leave_locations_out(data, carrier, form, knots, length_mm):
    """How well each inner location is predicted from the others: a row per location and port."""
    forces = compared_forces(data)
    basis = curves.force_basis(form, knots)(forces)
    rows = []
    for j in range(1, len(data.location_mm) - 1):
        kept = np.arange(len(data.location_mm)) != j
        interpolation = interpolate(
            data,
            carrier.coefficients_deg[:, kept],
            carrier.covariance_deg2[:, kept],
            form,
            knots,
            length_mm,
            data.location_mm[kept],
        )
        for port in (0, 1):
            values = basis @ carrier.coefficients_deg[port].T
            weights = interpolation.weights(data.location_mm[j], port)
            error = values[:, kept] @ weights - values[:, j]
            expected = np.sqrt(
                interpolation.variance(
                    np.full(len(forces), data.location_mm[j]), port, values[:, kept]
                )
            )
            rows.append(
                {
                    "frequency_mhz": round(data.frequency_hz / 1e6, 6),
                    "location_mm": float(data.location_mm[j]),
                    "port": port + 1,
                    "rms_deg": round(float(np.sqrt(np.mean(error**2))), 4),
                    "expected_deg": round(float(np.sqrt(np.mean(expected**2))), 4),
                }
            )
    return rows
