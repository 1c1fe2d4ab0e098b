# SPDX-License-Identifier: GPL-3.0-or-later
"""From a calibration table to a sensor model that knows its own errors."""

import datetime
from dataclasses import dataclass, replace

import numpy as np

from ..angles import wrap_deg
from ..carrier import same_carrier
from ..errors import InputError
from . import curves, line
from .checks import check_places, check_table, continuous_phase, split_untouched
from .fit import CurveFitter, force_knots, noise_and_misfit
from .location import learn_interpolation

LOCATION_STEPS = ("nearest", "given", "line")
FORM_CHOICES = ("auto", "auto-beyond", *curves.FORMS)
_BLOCKS = 6
_FORCES_COMPARED = 9
# Samples from which a curve is drawn when some are left out.
_LEAST_LEFT = 5
# No press is so wide that it moves a short by more than this beyond what the line does.
_LARGEST_EXTENT_MM = 30.0


@dataclass(frozen=True)
class _Curve:
    """Data of one carrier, location and port: what the contact adds to the line's phase."""

    force_n: np.ndarray
    added_deg: np.ndarray
    press: np.ndarray
    copied: bool = False  # the mirror image of another


@dataclass(frozen=True)
class _CarrierData:
    frequency_hz: float
    location_mm: np.ndarray
    curves: list  # [port][location] of _Curve
    untouched_deg: tuple | None
    onset: tuple  # largest untouched and least touched force seen in sweeps

    def all_curves(self):
        return [curve for port in self.curves for curve in port]


def calibrate(
    table,
    name,
    length_mm=80.0,
    form="auto",
    onset_force_n=None,
    location_steps="nearest",
    mirror=False,
    permittivity=1.0,
    source=None,
    date=None,
):
    """Makes a sensor model of a calibration table.

    Parameters
    ----------
    table : CalibrationTable
        One or several carriers.
    name : str
    length_mm : float
    form : str
        ``cubic`` (the paper), ``power``, ``spline``; ``auto``: whichever predicts best what it has
        not seen within the calibrated forces; ``auto-beyond``: likewise, a little beyond them
        included (:func:`validate_forms`).
    onset_force_n : float, optional
        Force at which the line is first shorted. By default midway between the last untouched and
        the first touched force where sweeps start before the contact, else half the least
        calibrated force.
    location_steps : str
        ``nearest``: multiples of 360 deg between locations as the line's physics wants them.
        ``given``: the phases of different locations as they stand in the table.
        ``line``: only the movement with force is taken from the table; in the middle of the common
        span of force every location shows a short right at the press.
    mirror : bool
        Takes what is missing at ``length - location`` from ``location`` with the ports swapped.
    permittivity : float
        Effective relative permittivity of the line.
    source, date : str, optional
        For the provenance; the table's source and today by default.

    Returns
    -------
    CurveModel

    Raises
    ------
    InputError
        Naming file, row, rule and value for what the table cannot support.
    """
    _check_settings(length_mm, form, onset_force_n, location_steps, permittivity)
    check_table(table, length_mm)
    assumed = []
    data = [
        _carrier_data(table, frequency, length_mm, permittivity, mirror, assumed)
        for frequency in _carriers(table)
    ]
    data = [_with_location_steps(d, location_steps, length_mm, permittivity) for d in data]
    assumed += _assumed_steps(location_steps, data)
    validation = validate_forms(data)
    form = validation["best"].get(form, form)
    forces = np.concatenate([curve.force_n for d in data for curve in d.all_curves()])
    knots = force_knots(form, forces)
    carriers = [_fit_carrier(d, form, knots, length_mm, permittivity) for d in data]
    validation["locations"] = [
        row
        for d, c in zip(data, carriers, strict=True)
        for row in _leave_locations_out(d, c, form, knots, length_mm)
    ]
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
        },
        form=form,
        carriers=tuple(carriers),
        knots_n=knots,
        permittivity=float(permittivity),
        cross_validation=validation,
    )


def _assumed_steps(location_steps, data):
    if location_steps == "line":
        return [
            f"movement with force as measured, location steps those of the line: at "
            f"{_anchor(data[0]):.3g} N each end sees a short right at the press"
        ]
    if location_steps == "given":
        return ["phases of different locations as given, multiples of 360 deg included"]
    return []


def _check_settings(length_mm, form, onset_force_n, location_steps, permittivity):
    for name, value in (("length_mm", length_mm), ("onset_force_n", onset_force_n)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise InputError(name, "must be positive", value)
    if not (np.isfinite(permittivity) and permittivity >= 1):
        raise InputError("permittivity", "must be at least 1", permittivity)
    if form not in FORM_CHOICES:
        raise InputError("form", f"must be one of {', '.join(FORM_CHOICES)}", form)
    if location_steps not in LOCATION_STEPS:
        rule = f"must be one of {', '.join(LOCATION_STEPS)}"
        raise InputError("location_steps", rule, location_steps)


def _carriers(table):
    """Carriers of a table, rising; values within 0.1 % of each other are one."""
    carriers = []
    for frequency in np.unique(table.frequency_hz):
        if frequency <= 0:
            index = int(np.argmax(table.frequency_hz == frequency))
            raise InputError(f"{table.at(index)}: freq_mhz", "must be positive", frequency / 1e6)
        if not carriers or frequency > carriers[-1] * 1.001:
            carriers.append(float(frequency))
    return carriers


def _carrier_data(table, frequency, length_mm, permittivity, mirror, assumed):
    table = table.take(same_carrier(table.frequency_hz, frequency))
    untouched = _untouched_phases(table)
    if untouched is None:
        assumed.append(
            f"untouched phases at {frequency / 1e6:g} MHz are those of a line of "
            f"{length_mm:g} mm: the table has none"
        )
    touched, below, above = _without_untouched_sweeps(table, untouched)
    own = np.unique(touched.location_mm)
    if not len(own):
        raise InputError(table.source, f"has no row with a force at {frequency / 1e6:g} MHz")
    if mirror:
        touched = _mirrored(touched, length_mm, assumed)
    check_places(touched)
    places = np.unique(touched.location_mm)
    rows = [
        [
            _curve(touched, place, port, length_mm, permittivity, place not in own)
            for place in places
        ]
        for port in (1, 2)
    ]
    return _CarrierData(frequency, places, rows, untouched, (below, above))


def _untouched_phases(table):
    """psi_10, psi_20 (deg), averaged over phasors; None without such rows for both ports."""
    rows = table.take(table.untouched)
    if set(rows.port) != {1, 2}:
        return None
    means = [np.mean(np.exp(1j * np.deg2rad(rows.phase_deg[rows.port == p]))) for p in (1, 2)]
    return tuple(float(np.rad2deg(np.angle(mean))) for mean in means)


def _without_untouched_sweeps(table, untouched):
    """Touched rows, the largest force seen without contact and the least seen with it."""
    keep = ~table.untouched
    if untouched is None:
        return table.take(keep), None, None
    sweeps = np.flatnonzero(keep)
    below, above = [], []
    for key in {(table.location_mm[i], table.port[i], table.press[i]) for i in sweeps}:
        rows = np.flatnonzero(
            keep & (table.location_mm == key[0]) & (table.port == key[1]) & (table.press == key[2])
        )
        before = split_untouched(table.take(rows), untouched[key[1] - 1])
        if np.any(before) and not np.all(before):
            below.append(table.force_n[rows[before]].max())
            above.append(table.force_n[rows[~before]].min())
            keep[rows[before]] = False
    if not below:
        return table.take(keep), None, None
    return table.take(keep), float(np.median(below)), float(np.median(above))


def _mirrored(table, length_mm, assumed):
    """The table with absent locations taken from their mirror images."""
    places = np.unique(table.location_mm)
    absent = [p for p in places if not np.any(np.isclose(length_mm - p, places))]
    parts = [table]
    for place in absent:
        twin = table.take(table.location_mm == place)
        parts.append(replace(twin, location_mm=length_mm - twin.location_mm, port=3 - twin.port))
        assumed.append(f"{length_mm - place:g} mm is {place:g} mm with the ports swapped")
    joined = {
        field: np.concatenate([getattr(part, field) for part in parts])
        for field in table.__dataclass_fields__
        if field != "source"
    }
    return replace(table, **joined)


def _curve(table, place, port, length_mm, permittivity, copied):
    rows = table.take((table.location_mm == place) & (table.port == port))
    distance = place if port == 1 else length_mm - place
    base = line.short_phase_deg(distance, rows.frequency_hz[0], permittivity)
    forces, added, presses = [], [], []
    for press in dict.fromkeys(rows.press):
        one = rows.take(rows.press == press)
        order, phase = continuous_phase(one, length_mm, permittivity)
        phase = phase - base
        if added:
            phase += 360.0 * np.round((np.median(added[0]) - np.median(phase)) / 360.0)
        forces.append(one.force_n[order])
        added.append(phase)
        presses.append(one.press[order])
    force, value = np.concatenate(forces), np.concatenate(added)
    order = np.argsort(force, kind="stable")
    return _Curve(force[order], value[order], np.concatenate(presses)[order], copied)


def _anchor(data):
    """Middle of the span of force that all locations share, or of all of it."""
    low = max(curve.force_n[0] for curve in data.all_curves())
    high = min(curve.force_n[-1] for curve in data.all_curves())
    return 0.5 * (low + high)


def _with_location_steps(data, location_steps, length_mm, permittivity):
    """The same data with the offsets of the locations brought in line, as asked."""
    if location_steps == "given":
        return data
    rows = []
    for port in data.curves:
        middles = [float(np.median(curve.added_deg)) for curve in port]
        if location_steps == "line":
            shifts = [-_value_at(curve, _anchor(data)) for curve in port]
        else:
            # what the contact adds differs little from one location to the next
            shifts, last = [], middles[0]
            for middle in middles:
                shifts.append(360.0 * np.round((last - middle) / 360.0))
                last = middle + shifts[-1]
        rows.append(
            [
                replace(curve, added_deg=curve.added_deg + shift)
                for curve, shift in zip(port, shifts, strict=True)
            ]
        )
    return replace(data, curves=rows)


def _value_at(curve, force):
    basis = curves.PowerBasis()
    coefficients = np.linalg.lstsq(basis(curve.force_n), curve.added_deg, rcond=None)[0]
    return float(basis(force) @ coefficients)


def _fit_carrier(data, form, knots, length_mm, permittivity):
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
    interpolation = _interpolation(
        data, coefficients, covariance, form, knots, length_mm, data.location_mm
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
        interpolation=interpolation.hypotheses,
    )


def _compared_forces(data):
    """A few forces within what every location covers, or, failing that, most of them."""
    low = max(curve.force_n[0] for curve in data.all_curves())
    high = min(curve.force_n[-1] for curve in data.all_curves())
    if low >= high:
        every = np.concatenate([curve.force_n for curve in data.all_curves()])
        low, high = np.quantile(every, [0.25, 0.75])
    return np.linspace(low, high, _FORCES_COMPARED)


def _interpolation(data, coefficients, covariance, form, knots, length_mm, location_mm):
    basis = curves.force_basis(form, knots)(_compared_forces(data))
    values = np.einsum("pjk,fk->pjf", coefficients, basis)
    noise = np.mean(np.einsum("fk,pjkm,fm->pjf", basis, covariance, basis))
    slope = line.round_trip_deg_per_mm(data.frequency_hz)
    physical = np.ptp(values, axis=1).max() < _LARGEST_EXTENT_MM * slope
    return learn_interpolation(location_mm, length_mm, values, noise, physical)


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


def _leave_locations_out(data, carrier, form, knots, length_mm):
    """How well each inner location is predicted from the others: a row per location and port."""
    forces = _compared_forces(data)
    basis = curves.force_basis(form, knots)(forces)
    rows = []
    for j in range(1, len(data.location_mm) - 1):
        kept = np.arange(len(data.location_mm)) != j
        interpolation = _interpolation(
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


def _onset(data, forces, onset_force_n, assumed):
    seen = [d.onset for d in data if d.onset[0] is not None]
    if onset_force_n is not None:
        return float(onset_force_n)
    if seen:
        return float(np.mean(seen))
    onset = 0.5 * float(np.min(forces))
    assumed.append(f"the line is first shorted at {onset:.3g} N, half the least calibrated force")
    return onset
