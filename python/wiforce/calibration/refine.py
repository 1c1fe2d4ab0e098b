# SPDX-License-Identifier: GPL-3.0-or-later
"""Refinement of a calibrated model by a few taps of known force and location over the air.

The phases of a sensor on the bench and over the air differ by several degrees, by a constant and by
a part that is largest at low forces. This difference is the prior of the curves' coefficients,
which the taps update (Bayesian linear regression with Student-t noise, by iteratively reweighted
least squares).
"""

import datetime
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from ..errors import InputError
from ..sensor import curves
from ..sensor.tracker import NOISE_FREEDOM
from ..signal.carrier import same_carrier, wrap_deg
from .data import check_table, untouched_phases
from .mistakes import stated_suspicions, suspicions
from .tables import CalibrationTable

# Prior standard deviation of the difference between bench and air per location: a constant, and a
# part that varies over the forces as touch-down does. The published wireless readings differ from
# the VNA curves by several degrees, most below 3.5 N.
_OFFSET_STD_DEG, _SHAPE_STD_DEG = 10.0, 10.0
# Smallest noise of a tap, in degrees, and rounds of the reweighting.
_LEAST_NOISE_DEG = 0.05
_ROUNDS = 20


def refine(
    model: curves.CurveModel, table: CalibrationTable, name: str | None = None
) -> curves.CurveModel:
    """Refine a model of the bench by a few taps; untouched rows replace its untouched phases."""
    if not isinstance(model, curves.CurveModel):
        raise InputError("sensor", "must have calibrated curves to be refined", model.name)
    check_table(table, model.length_mm)
    carriers = list(model.carriers)
    for frequency in np.unique(table.frequency_hz):
        try:
            index = model.carrier_index(frequency)
        except InputError as error:
            where = table.at(int(np.argmax(table.frequency_hz == frequency)))
            raise InputError(where, f"must be at a carrier of the model ({error})") from error
        rows = table.take(same_carrier(table.frequency_hz, model.frequencies_hz[index]))
        carriers[index] = _refined_carrier(model, index, rows)
    spans = np.concatenate([carrier.force_span_n for carrier in carriers])
    provenance = dict(model.provenance)
    provenance["source"] = f"{provenance['source']}; refined by taps of {table.source}"
    provenance["date"] = datetime.date.today().isoformat()
    found = suspicions(table, model.length_mm, model.permittivity)
    provenance |= stated_suspicions([*provenance.get("suspicions", ()), *found])
    return replace(
        model,
        name=name or model.name,
        carriers=tuple(carriers),
        force_span_n=(float(spans[:, 0].min()), float(spans[:, 1].max())),
        provenance=provenance,
        # The taps' prior is far wider than what a transfer between carriers leaves open.
        transferred_from_hz=None,
        transfer_std_deg=None,
    )


def _refined_carrier(
    model: curves.CurveModel, index: int, rows: CalibrationTable
) -> curves.Carrier:
    carrier = model.carriers[index]
    taps = rows.take(~rows.untouched)
    low, high = model.location_span_mm
    for i in np.flatnonzero((taps.location_mm < low) | (taps.location_mm > high)):
        rule = f"must lie within the model's {low:g} to {high:g} mm"
        raise InputError(f"{taps.at(i)}: location_mm", rule, float(taps.location_mm[i]))
    freedom = _bench_to_air(model, carrier)
    coefficients, covariance, noise = zip(
        *(
            _update_port(model, index, port, taps.take(taps.port == port + 1), freedom)
            for port in (0, 1)
        ),
        strict=True,
    )
    span = carrier.force_span_n.copy()
    for j, place in enumerate(carrier.location_mm):
        here = taps.force_n[np.abs(taps.location_mm - place) < 1.0]
        if here.size:
            span[j] = min(span[j, 0], here.min()), max(span[j, 1], here.max())
    return replace(
        carrier,
        untouched_deg=untouched_phases(rows) or carrier.untouched_deg,
        force_span_n=span,
        coefficients_deg=np.array(coefficients),
        covariance_deg2=np.array(covariance),
        noise_deg=noise,
    )


def _bench_to_air(model: curves.CurveModel, carrier: curves.Carrier) -> np.ndarray:
    """Prior covariance (K, K) of the coefficients' difference between bench and air."""
    force = np.geomspace(carrier.force_span_n.min(), carrier.force_span_n.max(), 40)
    basis = curves.force_basis(model.form, model.knots_n)(force)
    shape = curves.touch_down(force)
    shape = (shape - shape.mean()) / np.ptp(shape)
    modes = np.column_stack([np.full(len(force), _OFFSET_STD_DEG), _SHAPE_STD_DEG * shape])
    projected = np.linalg.lstsq(basis, modes, rcond=None)[0]
    return projected @ projected.T


def _update_port(
    model: curves.CurveModel,
    index: int,
    port: int,
    taps: CalibrationTable,
    freedom: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Coefficients (J, K), their covariances (J, K, K) and the noise (deg) of one port."""
    carrier = model.carriers[index]
    count, size = carrier.coefficients_deg.shape[1:]
    prior = block_diag(*(carrier.covariance_deg2[port] + freedom))
    basis = curves.force_basis(model.form, model.knots_n)(taps.force_n)
    weights = model.interpolation(index).weights(taps.location_mm, port)
    design = (weights[:, :, None] * basis[:, None, :]).reshape(len(basis), -1)
    expected = model.short_deg(taps.force_n, taps.location_mm, index)[:, port]
    difference = wrap_deg(taps.phase_deg - expected)
    noise = max(carrier.noise_deg[port], 1.0)
    weight = np.ones(len(difference))
    for _ in range(_ROUNDS):
        total = design @ prior @ design.T + np.diag(noise**2 / weight)
        gain = np.linalg.solve(total, design @ prior).T
        step = gain @ difference
        residual = difference - design @ step
        # The fit reduces the residuals; the noise is corrected for it.
        kept = max(1.0 - np.trace(design @ gain) / max(len(residual), 1), 0.1)
        square = (residual / noise) ** 2
        weight = (NOISE_FREEDOM + 1) / (NOISE_FREEDOM + square)
        noise = max(float(np.sqrt(np.mean(weight * residual**2) / kept)), _LEAST_NOISE_DEG)
    covariance = prior - gain @ design @ prior
    blocks = covariance.reshape(count, size, count, size)
    diagonal = np.arange(count)
    return (
        carrier.coefficients_deg[port] + step.reshape(count, size),
        blocks[diagonal, :, diagonal, :],
        noise,
    )
