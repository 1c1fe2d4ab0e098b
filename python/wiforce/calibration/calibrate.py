# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibration: from a table of known presses to a sensor model that states its own errors."""

import datetime
from collections.abc import Sequence

import numpy as np

from ..errors import InputError
from ..sensor import curves
from ..sensor.model import MAX_FORCE_N, MAX_LENGTH_MM, MAX_PERMITTIVITY, check_onset
from .data import (
    CarrierData,
    anchor_force,
    carrier_data,
    carriers_of,
    check_table,
    with_location_steps,
)
from .fit import contact_values, fit_carrier
from .mistakes import stated_suspicions, suspicions
from .tables import CalibrationTable
from .validation import validate_forms
from .wrong_locations import find_wrong_location, leave_locations_out, wrong_location_text
from .wrong_rows import find_untouched_scatter, find_wrong_rows

LOCATION_STEPS = ("nearest", "given", "line")
FORM_CHOICES = ("auto", "auto-beyond", *curves.FORMS)


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
    >>> from gnuradio.wiforce.calibration.simulated_vna import measure_vna
    >>> true = load_sensor("line-900mhz")
    >>> table = measure_vna(true, [20.0, 30.0, 40.0, 50.0, 60.0], np.linspace(1, 8, 15), 0.2)
    >>> model = calibrate(table, "arm", form="power")
    >>> error_deg = model.phases_deg(4.0, 45.0) - true.phases_deg(4.0, 45.0)
    >>> bool(np.all(np.abs(error_deg) < 2.0))
    True
    """
    _check_settings(length_mm, form, onset_force_n, location_steps, permittivity)
    if not 0 <= ruler_std_mm <= length_mm:
        raise InputError("ruler_std_mm", f"must be 0 to {length_mm:g}", ruler_std_mm)
    check_table(table, length_mm)
    assumed: list[str] = []
    data = [
        carrier_data(table, frequency, length_mm, permittivity, mirror, assumed)
        for frequency in carriers_of(table)
    ]
    data = [with_location_steps(d, location_steps) for d in data]
    assumed += _assumed_steps(location_steps, data)
    validation = validate_forms(data)
    form = validation["best"].get(form, form)
    forces = np.concatenate([curve.force_n for d in data for curve in d.all_curves()])
    knots = curves.force_knots(form, forces)
    carriers = [fit_carrier(d, form, knots) for d in data]
    validation["locations"], wrong, rows_wrong = [], [], []
    for each, carrier in zip(data, carriers, strict=True):
        contact = contact_values(
            each, carrier.coefficients_deg, carrier.covariance_deg2, form, knots
        )
        rows = leave_locations_out(each, contact, ruler_std_mm)
        validation["locations"] += rows
        if row := find_wrong_location(each, carrier, contact, rows, ruler_std_mm):
            wrong.append(row)
        rows_wrong += find_untouched_scatter(each, carrier)
        rows_wrong += find_wrong_rows(each, form, knots)
    suspected = suspicions(table, length_mm, permittivity)
    if wrong:
        validation["wrong"] = wrong
    suspected = suspected or [*map(wrong_location_text, wrong), *rows_wrong]
    if ruler_std_mm:
        assumed.append(f"locations are known to {ruler_std_mm:g} mm (standard deviation)")
    onset = _onset(data, forces, onset_force_n, assumed)
    spans = np.concatenate([carrier.force_span_n for carrier in carriers])
    return curves.CurveModel(
        name=name,
        length_mm=float(length_mm),
        frequencies_hz=tuple(d.frequency_hz for d in data),
        onset_force_n=onset,
        force_span_n=(float(spans[:, 0].min()), float(spans[:, 1].max())),
        location_span_mm=(
            float(max(d.location_mm[0] for d in data)),
            float(min(d.location_mm[-1] for d in data)),
        ),
        provenance={
            "source": source or f"calibration of {table.source}",
            "date": date or datetime.date.today().isoformat(),
            "assumed": list(dict.fromkeys(assumed)),
            **stated_suspicions(suspected),
        },
        form=form,
        carriers=tuple(carriers),
        knots_n=knots,
        permittivity=float(permittivity),
        ruler_std_mm=float(ruler_std_mm) or None,
        cross_validation=validation,
    )


def _assumed_steps(location_steps: str, data: Sequence[CarrierData]) -> list[str]:
    if location_steps == "line":
        return [
            f"movement with force as measured, location steps those of the line: at "
            f"{anchor_force(data[0]):.3g} N each end sees a short right at the press"
        ]
    if location_steps == "given":
        return ["phases of different locations as given, multiples of 360 deg included"]
    return []


def _check_settings(
    length_mm: float,
    form: str,
    onset_force_n: float | None,
    location_steps: str,
    permittivity: float,
) -> None:
    limits = (
        ("length_mm", length_mm, MAX_LENGTH_MM),
        ("onset_force_n", onset_force_n, MAX_FORCE_N),
    )
    for name, value, high in limits:
        if value is not None and not 0 < value <= high:
            raise InputError(name, f"must be positive and at most {high:g}", value)
    if not 1 <= permittivity <= MAX_PERMITTIVITY:
        rule = f"must be at least 1 and at most {MAX_PERMITTIVITY:g}"
        raise InputError("permittivity", rule, permittivity)
    if form not in FORM_CHOICES:
        raise InputError("form", f"must be one of {', '.join(FORM_CHOICES)}", form)
    if location_steps not in LOCATION_STEPS:
        rule = f"must be one of {', '.join(LOCATION_STEPS)}"
        raise InputError("location_steps", rule, location_steps)


def _onset(
    data: Sequence[CarrierData],
    forces: np.ndarray,
    onset_force_n: float | None,
    assumed: list[str],
) -> float:
    seen = [d.onset for d in data if d.onset is not None]
    if onset_force_n is not None:
        check_onset("onset_force_n", onset_force_n, np.max(forces))
        return float(onset_force_n)
    if seen:
        return float(np.mean(seen))
    onset = 0.5 * float(np.min(forces))
    assumed.append(f"the line is first shorted at {onset:.3g} N, half the least calibrated force")
    return onset
