# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibration: from a table of known presses to a sensor model that states its own errors.

The phases of a sensor on the bench and over the air differ by several degrees, by a constant and by
a part that is largest at low forces: the prior of coefficients that a few taps update (Bayesian
linear regression with Student-t noise, by iteratively reweighted least squares).
"""

import datetime
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from ..errors import InputError, printable
from ..io.text.values import Choice, KeyPath, Number, Scope, ValueType
from ..sensor import curves
from ..sensor.line import MAX_FORCE_N, MAX_LENGTH_MM, MAX_PERMITTIVITY
from ..sensor.model import check_onset
from ..sensor.tracker import NOISE_FREEDOM
from ..signal.carrier import same_carrier, wrap_deg
from .data import by_carrier, carrier_data, check_table, untouched_phases
from .fit import fit_carrier
from .mistakes import stated_suspicions, suspicions
from .tables import CalibrationTable
from .validation import validate_forms
from .wrong_entries import (
    contradicting_locations,
    find_untouched_scatter,
    find_wrong_rows,
    wrong_location_text,
)

_SETTINGS: dict[str, ValueType] = {
    "length_mm": Number(low=0, above=True, high=MAX_LENGTH_MM),
    "onset_force_n": Number(low=0, above=True, high=MAX_FORCE_N, optional=True),
    "permittivity": Number(low=1, high=MAX_PERMITTIVITY),
    "form": Choice(words=("auto", "auto-beyond", *curves.FORMS)),
    "location_steps": Choice(words=("nearest", "given", "line")),
}


def calibrate(
    table: CalibrationTable,
    name: str,
    length_mm: float = 80.0,
    form: str = "auto",
    onset_force_n: float | None = None,
    location_steps: str = "nearest",
    mirror: bool = False,
    permittivity: float = 1.0,
    ruler_std_mm: float = 0.0,
    source: str | None = None,
    date: str | None = None,
) -> curves.CurveModel:
    """Make a sensor model from a calibration table.

    Parameters
    ----------
    table : CalibrationTable
        One or several carriers.
    name : str
        Of the sensor.
    length_mm : float
        Of the line.
    form : str
        ``cubic`` (the paper), ``power``, ``spline``; ``auto``: the form that predicts data left out
        best within the calibrated forces; ``auto-beyond``: the same, including forces slightly
        beyond them (:func:`validate_forms`).
    onset_force_n : float, optional
        Force at which the line is first shorted. By default midway between the last untouched and
        the first touched force where sweeps start before the contact, else half the least
        calibrated force.
    location_steps : str
        ``nearest``: multiples of 360 deg between locations are chosen to fit the physical line.
        ``given``: the phases of different locations are used as they are in the table.
        ``line``: only the change with force is taken from the table; at the middle of the common
        span of force every location has a short exactly at the press.
    mirror : bool
        Take locations that are missing at ``length - location`` from ``location`` with the ports
        swapped.
    permittivity : float
        Effective relative permittivity of the line.
    ruler_std_mm : float
        Standard deviation of the locations in the table.
    source, date : str, optional
        For the provenance; the table's source and today by default.

    Returns
    -------
    CurveModel
        Likely mistakes in the table (:func:`suspicions`), and a location that the others
        contradict, are in its ``provenance``, and repeated by whatever reads with it.

    Raises
    ------
    InputError
        Naming file, row, rule and value where the table does not support a model.

    Notes
    -----
    Phase over force is fitted per location and port, and interpolated over location along the
    physical line (paper, section 5.1; docs/sensors.md).

    Examples
    --------
    >>> import numpy as np
    >>> from gnuradio.wiforce.sensor import load_sensor
    >>> from gnuradio.wiforce.calibration.tables import measure_vna
    >>> true = load_sensor("line-900mhz")
    >>> table = measure_vna(true, [20.0, 30.0, 40.0, 50.0, 60.0], np.linspace(1, 8, 15), 0.2)
    >>> model = calibrate(table, "arm", form="power")
    >>> error_deg = model.phases_deg(4.0, 45.0) - true.phases_deg(4.0, 45.0)
    >>> bool(np.all(np.abs(error_deg) < 2.0))
    True
    """
    if not isinstance(table, CalibrationTable):
        rule = "must be a CalibrationTable, such as sensor.read_vna_csv gives"
        raise InputError("table", rule, table)
    given = (length_mm, onset_force_n, permittivity, form, location_steps)
    for (setting, kind), value in zip(_SETTINGS.items(), given, strict=True):
        kind.read(value, KeyPath(setting), Scope())
    Number(low=0, high=length_mm).read(ruler_std_mm, KeyPath("ruler_std_mm"), Scope())
    check_table(table, length_mm)
    assumed: list[str] = []
    settings = length_mm, permittivity, ruler_std_mm, mirror, location_steps, assumed
    data = [carrier_data(frequency, own, *settings) for frequency, own in by_carrier(table)]
    if location_steps == "line":
        assumed.append(
            "movement with force as measured, location steps those of the line: at "
            f"{data[0].anchor_n:.3g} N each end sees a short right at the press"
        )
    elif location_steps == "given":
        assumed.append("phases of different locations as given, multiples of 360 deg included")
    validation = validate_forms(data)
    form = validation["best"].get(form, form)
    forces = np.concatenate([curve.force_n for d in data for curve in d.curves])
    knots = curves.force_knots(form, forces)
    fits = [fit_carrier(d, form, knots) for d in data]
    validation |= contradicting_locations(fits)
    suspected = suspicions(table, length_mm, permittivity) or [
        *map(wrong_location_text, validation.get("wrong", ())),
        *(text for fit in fits for text in find_untouched_scatter(fit) + find_wrong_rows(fit)),
    ]
    if ruler_std_mm:
        assumed.append(f"locations are known to {ruler_std_mm:g} mm (standard deviation)")
    seen = [d.onset for d in data if d.onset is not None]
    if onset_force_n is not None:
        check_onset("onset_force_n", onset_force_n, np.max(forces))
    elif seen:
        onset_force_n = float(np.mean(seen))
    else:
        onset_force_n = 0.5 * float(np.min(forces))
        half = f"{onset_force_n:.3g} N, half the least calibrated force"
        assumed.append(f"the line is first shorted at {half}")
    carriers = [fit.carrier for fit in fits]
    spans = np.concatenate([carrier.force_span_n for carrier in carriers])
    return curves.CurveModel(
        name=name,
        length_mm=float(length_mm),
        onset_force_n=float(onset_force_n),
        force_span_n=(float(spans[:, 0].min()), float(spans[:, 1].max())),
        location_span_mm=(
            float(max(d.location_mm[0] for d in data)),
            float(min(d.location_mm[-1] for d in data)),
        ),
        provenance={
            "source": source or printable(f"calibration of {table.source}"),
            "date": date or datetime.date.today().isoformat(),
            "assumed": list(dict.fromkeys(assumed)),
            **stated_suspicions(suspected),
        },
        form=form,
        carriers=tuple(carriers),
        knots_n=knots,
        permittivity=float(permittivity),
        transferred_from_hz=None,
        transfer_std_deg=None,
        ruler_std_mm=float(ruler_std_mm) or None,
        cross_validation=validation,
    )


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
    refined = printable(f"refined by taps of {table.source}")
    provenance["source"] = f"{provenance['source']}; {refined}"
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
    weights = model.interpolations[index].weights(taps.location_mm)[:, port]
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
