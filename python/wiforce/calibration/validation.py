# SPDX-License-Identifier: GPL-3.0-or-later
"""Cross-validation of calibrated curves on forces, presses and locations that were left out."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..sensor import curves, line
from .carrier_fit import interpolate
from .data import CarrierData, ContactCurve, compared_forces
from .fit import CurveFitter, force_knots

# Blocks of neighbouring forces that are left out in turn: four of the six lie inside.
_BLOCKS = 6
# Fewest samples that a curve is fitted to when others are left out.
_LEAST_LEFT = 5


def validate_forms(data: Sequence[CarrierData]) -> dict[str, Any]:
    """Cross-validate each form of the curves.

    Where locations were pressed more than once, one press is left out at a time, otherwise a block
    of neighbouring forces. The first and the last block of a location are extrapolated.

    Returns dict: ``left_out`` (``press`` or ``forces``); ``best``, the form chosen by
    :func:`best_form`, ``auto`` without the extrapolated blocks and ``auto-beyond`` with them;
    ``forms``: for each form the rms errors in degrees and the number of samples predicted.
    """
    several = any(len(set(c.press)) > 1 for d in data for c in d.all_curves())
    squares = {
        form: [fold for d in data for fold in _fold_errors(d, form, several)]
        for form in curves.FORMS
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


def _root_mean(squares: Sequence[np.ndarray]) -> float:
    return round(float(np.sqrt(np.mean(np.concatenate(squares)))), 4)


def best_form(squares: Mapping[str, Sequence[np.ndarray]]) -> str:
    """Choose the simplest form that predicts as well as the best one.

    A form predicts as well as the best when their mean difference of squared errors over the folds
    is within its standard error (the one-standard-error rule, L. Breiman et al., *Classification
    and Regression Trees*, 1984, section 3.4.3).

    ``squares``: squared errors of each form, one array per fold.
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


def _fold_errors(data: CarrierData, form: str, by_press: bool) -> list[tuple[np.ndarray, bool]]:
    """Squared errors of each fold, and whether the fold is extrapolated."""
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


def _folds(curve: ContactCurve, by_press: bool) -> list[tuple[np.ndarray, bool]]:
    if by_press:
        return [(curve.press == press, False) for press in dict.fromkeys(curve.press)]
    block = np.minimum(np.arange(curve.force_n.size) * _BLOCKS // curve.force_n.size, _BLOCKS - 1)
    return [(block == b, b in (0, _BLOCKS - 1)) for b in range(_BLOCKS)]


def leave_locations_out(
    data: CarrierData,
    carrier: curves.Carrier,
    form: str,
    knots: np.ndarray | None,
    length_mm: float,
    ruler_std_mm: float = 0.0,
    permittivity: float = 1.0,
) -> list[dict[str, Any]]:
    """Predict each inner location from the others.

    Returns list of dict: ``frequency_mhz``, ``location_mm``, ``port``, ``rms_deg`` of the
    prediction and ``expected_deg``, which the interpolation states; by location and port.

    ``carrier``: the curves fitted to it; ``ruler_std_mm``: standard deviation of the locations.
    """
    forces = compared_forces(data)
    basis = curves.force_basis(form, knots)(forces)
    rows = []
    ruler_deg = ruler_std_mm * line.round_trip_deg_per_mm(data.frequency_hz, permittivity)
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
            variance = interpolation.variance(
                np.full(len(forces), data.location_mm[j]), port, values[:, kept]
            )
            # The errors of the ruler at this location and at those that predict it.
            variance = variance + ruler_deg**2 * (1 + weights @ weights)
            rows.append(
                {
                    "frequency_mhz": round(data.frequency_hz / 1e6, 6),
                    "location_mm": float(data.location_mm[j]),
                    "port": port + 1,
                    "rms_deg": round(float(np.sqrt(np.mean(error**2))), 4),
                    "expected_deg": round(float(np.sqrt(np.mean(variance))), 4),
                }
            )
    return rows
