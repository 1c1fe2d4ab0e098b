# SPDX-License-Identifier: GPL-3.0-or-later
"""Locations and rows of a table that the others contradict, or that were exchanged.

Each inner location is predicted from the others, which is the leave-one-out predictive
probability of Gaussian processes (C. E. Rasmussen and C. K. I. Williams, *Gaussian Processes for
Machine Learning*, 2006, section 5.4.2), each row from the curve of the others. Another explanation
counts if its likelihood ratio makes it certain, however many were tried.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, product
from typing import Any

import numpy as np
from scipy.optimize import nnls

from ..sensor import line
from ..signal.carrier import wrap_deg
from .data import CarrierData
from .fit import CarrierFit, ContactValues, ForceCurve

# What an explanation may leave, and how much better another one must be, in standard deviations.
_UNEXPECTED = 3.0
# Fewest locations of which one can be left out while the others still predict one of them.
_LEAST_TESTED = 4
# Places at which a press is sought, closer than a ruler is read.
_PLACE_STEP_MM = 0.1
# Nearer than a reading is expected to be, no ruler was misread.
_VAGUE_MM = 0.5
# Cross-validation is stated to this.
_ROUNDED_DEG, _DECIMALS = 1e-4, 4


def contradictions(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Those rows of :func:`leave_locations_out` that the other locations did not expect."""
    return [row for row in rows if row["rms_deg"] > _UNEXPECTED * row["expected_deg"]]


def leave_locations_out(contact: ContactValues) -> list[dict[str, Any]]:
    """Predict each inner location from the others: rms and expected deg by location and port."""
    data, rows = contact.data, []
    for j in range(1, len(contact.location_mm) - 1):
        others, place = contact.without(j), contact.location_mm[j]
        interpolation, values = others.interpolation(), np.moveaxis(others.added_deg, -1, 0)
        weights = interpolation.weights(place)
        error = np.sum(weights * values, axis=-1) - contact.added_deg[:, j].T
        variance = np.mean(interpolation.variance(place, values), axis=0)
        # The errors of the ruler at this location and at those that predict it.
        variance += (data.ruler_std_mm * data.slope) ** 2 * (1 + np.sum(weights**2, axis=-1))
        both = zip((1, 2), np.mean(error**2, axis=0) ** 0.5, variance**0.5, strict=True)
        rows += [
            {
                "frequency_mhz": round(data.frequency_hz / 1e6, 6),
                "location_mm": float(place),
                "port": port,
                "rms_deg": round(float(rms_deg), _DECIMALS),
                "expected_deg": round(float(expected_deg), _DECIMALS),
            }
            for port, rms_deg, expected_deg in both
        ]
    return rows


def contradicting_locations(fits: Sequence[CarrierFit]) -> dict[str, list[dict[str, Any]]]:
    """``locations``, rows of :func:`leave_locations_out` of all carriers, and ``wrong`` ones.

    These were exchanged with ``exchanged_mm`` (at one ``port``), or fit at ``fits_mm`` or nowhere.
    """
    locations, wrong = [], []
    for fitted in fits:
        rows = leave_locations_out(fitted.contact)
        found = _exchanged_locations(fitted.contact, rows) or _wrong_location(fitted, rows)
        if found:
            wrong.append({"frequency_mhz": round(fitted.data.frequency_hz / 1e6, 6)} | found)
        locations += rows
    return {"locations": locations} | ({"wrong": wrong} if wrong else {})


def _wrong_location(fitted: CarrierFit, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """The location without which the others, its neighbours too, are predicted best."""
    contact = fitted.contact
    count = len(contact.location_mm)
    if count < _LEAST_TESTED or not contradictions(rows):
        return None
    others = [leave_locations_out(contact.without(j)) for j in range(count)]
    worst = [max(row["rms_deg"] / row["expected_deg"] for row in left) for left in others]
    wrong = int(np.argmin(worst))
    stated_mm, fits_mm = float(contact.location_mm[wrong]), _place_among(fitted, wrong)
    near = fits_mm is not None and abs(fits_mm - stated_mm) <= _VAGUE_MM
    if worst[wrong] > _UNEXPECTED or near:
        return None
    return {"location_mm": stated_mm, "fits_mm": fits_mm}


def wrong_location_text(row: Mapping[str, Any]) -> str:
    """A row of ``wrong`` of :func:`contradicting_locations`, in words."""
    if row.get("exchanged_mm") is not None:
        what = f"locations {row['location_mm']:g} and {row['exchanged_mm']:g} mm"
        if row.get("port") is not None:
            what += f" of port {row['port']}"
        return f"{what} would fit the others exchanged: were their presses exchanged?"
    text = f"location {row['location_mm']:g} mm does not fit the others"
    if row.get("fits_mm") is None:
        return f"{text}, nor would it anywhere else: were units, ports and sensor the same there?"
    return f"{text}, which see such phases at {row['fits_mm']:g} mm: was the ruler right there?"


def _exchanged_locations(
    contact: ContactValues, rows: Sequence[Mapping[str, Any]]
) -> dict[str, Any] | None:
    """Two locations whose exchange, at one ``port`` or both, explains the phases better."""
    if not rows:
        return None
    # Along a line an exchange moves phases further apart, unless it takes another one back.
    pairs = combinations(range(len(contact.location_mm)), 2)
    tried = [((0, 0), (0, 1)), *product(pairs, ((0, 1), (0,), (1,)))]
    values = [_exchange(contact, *pair, ports) for pair, ports in tried]
    best = int(np.argmin([np.var(each.added_deg, axis=1).mean() for each in values]))
    if not best:  # as given
        return None
    after = leave_locations_out(values[best])
    better = _is_better(_log_probability(after) - _log_probability(rows), len(tried) - 1)
    if not better or contradictions(after):
        return None
    pair, ports = tried[best]
    first, second = (float(contact.location_mm[j]) for j in pair)
    found = {"location_mm": first, "exchanged_mm": second}
    return found if len(ports) > 1 else found | {"port": ports[0] + 1}


def _exchange(
    contact: ContactValues, first: int, second: int, ports: tuple[int, ...]
) -> ContactValues:
    """The same with the phases of two locations exchanged, turns of 360 deg by the line."""
    order = np.arange(len(contact.location_mm))
    order[[first, second]] = second, first
    added, variance = contact.added_deg.copy(), contact.variance_deg2.copy()
    shorts = _short_deg(contact.data, contact.location_mm)
    for port in ports:
        short = shorts[:, port]
        values = added[port, order] + (short[order] - short)[:, None]
        middles = np.median(values, axis=1)
        added[port] = values + (np.unwrap(middles, period=360.0) - middles)[:, None]
        variance[port] = variance[port, order]
    return replace(contact, added_deg=added, variance_deg2=variance)


def _short_deg(data: CarrierData, location_mm: np.ndarray | float) -> np.ndarray:
    """Phases (..., 2) of a short exactly at some locations, in degrees."""
    distance = line.distances_mm(location_mm, data.length_mm)
    return line.short_phase_deg(distance, data.frequency_hz, data.permittivity)


def _log_probability(rows: Sequence[Mapping[str, Any]]) -> float:
    """Of predictions, but for a constant: the forces of a location and port err alike."""
    rms, expected = (np.array([row[name] for row in rows]) for name in ("rms_deg", "expected_deg"))
    expected = np.maximum(expected, _ROUNDED_DEG)
    return float(-np.sum(np.log(expected) + 0.5 * (rms / expected) ** 2))


def _is_better(log_ratio: float, count: int) -> bool:
    """Whether the best of so many other explanations is certain, by its likelihood ratio."""
    return log_ratio - np.log(count) > 0.5 * _UNEXPECTED**2


def _place_among(fitted: CarrierFit, wrong: int) -> float | None:
    """Where the other locations expect the phases of one, in mm; None where nowhere."""
    data, contact, others = fitted.data, fitted.contact, fitted.contact.without(wrong)
    interpolation = others.interpolation()
    places = np.arange(0.0, data.length_mm, _PLACE_STEP_MM)
    # By force, place and port.
    values = np.moveaxis(others.added_deg, -1, 0)[:, None]
    measured = contact.added_deg[:, wrong].T + _short_deg(data, contact.location_mm[wrong])
    predicted = np.sum(interpolation.weights(places) * values, axis=-1) + _short_deg(data, places)
    square = np.mean(wrap_deg(measured[:, None] - predicted) ** 2, axis=(0, 2))
    best = int(np.argmin(square))
    expected = np.mean(interpolation.variance(places[best], values))
    expected += np.mean(np.square(fitted.carrier.noise_deg)) + (data.ruler_std_mm * data.slope) ** 2
    return round(float(places[best]), 1) if square[best] <= _UNEXPECTED**2 * expected else None


def find_wrong_rows(fitted: CarrierFit) -> list[str]:
    """Rows of a location whose exchange explains the phases better, or without which they fit.

    A phase follows force smoothly, with noise of its own and of the force. Tried are the row
    farthest beside its curve with that of its press whose exchange fits best, then the row alone,
    above the onset.
    """
    without_n, touched_n = fitted.data.onset or (0.0, 0.0)
    fitter = fitted.fitter
    found: list[str] = []
    both = zip(fitted.data.curves, fitted.fits, strict=True)
    own = [(curve, fit) for curve, fit in both if not curve.copied]
    places = {curve.location_mm for curve, _ in own}
    if len(places) < 2:
        return found  # nothing tells the noise
    # Where rows of both ports are wrong, only other locations tell the noise.
    noises = {
        place: _Noise([fit for curve, fit in own if curve.location_mm != place]) for place in places
    }
    rows = sum(len(curve.force_n) for curve, _ in own)
    pressed_in = [curve.press[curve.force_n > without_n] for curve, _ in own]
    counts = np.concatenate([np.unique(press, return_counts=True)[1] for press in pressed_in])
    pairs = int(np.sum(counts * (counts - 1) // 2))
    for curve, fit in own:
        noise, force_n = noises[curve.location_mm], curve.force_n
        where = f"at location {curve.location_mm:g} mm, port {curve.port},"
        basis = fitter.basis(force_n)
        # What a fit leaves of a row, exactly where the coefficients are free.
        rest = np.maximum(1.0 - np.sum(basis @ fit.unit_covariance * basis, axis=1), 1e-9)
        beside = fit.residual**2 / rest
        pressed = force_n > without_n
        first = int(np.argmax(pressed * beside))
        # By how much an exchange with each row reduces the squares.
        step = curve.added_deg - curve.added_deg[first]
        size = rest + rest[first] + 2 * (basis @ (fit.unit_covariance @ basis[first]))
        gain = step * (2 * (fit.residual - fit.residual[first]) - step * size)
        gain *= pressed & (curve.press == curve.press[first])
        pair = np.sort([first, np.argmax(gain)])
        if gain.max() > 0:
            exchanged = curve.added_deg.copy()
            exchanged[pair] = exchanged[pair[::-1]]
            after = fitter.fit(force_n, exchanged)
            if _is_better(noise.log_ratio(fit, after.residual, after.freedom), pairs):
                low, high = force_n[pair]
                found.append(
                    f"the phases of {low:g} and {high:g} N {where} would fit the others exchanged: "
                    "were rows exchanged?"
                )
                continue
        row = int(np.argmax((force_n > touched_n) * beside))
        if not (force_n[row] > touched_n and fit.residual[row]):
            continue
        after = fitter.fit(np.delete(force_n, row), np.delete(curve.added_deg, row))
        residual = np.insert(after.residual, row, 0.0)
        if _is_better(noise.log_ratio(fit, residual, after.freedom), rows):
            off_deg = curve.added_deg[row] - after.value(force_n[row])
            found.append(
                f"the phase of {force_n[row]:g} N {where} is {off_deg:+.1f} deg beside the curve "
                "of the others: was it measured, or typed, wrong?"
            )
    return found


class _Noise:
    """Variance of phases (deg^2) and of forces (N^2) about fitted curves of known slopes."""

    def __init__(self, others: Sequence[ForceCurve]) -> None:
        parts = [
            fit.freedom / len(fit.slope) * np.column_stack([np.ones_like(fit.slope), fit.slope**2])
            for fit in others
        ]
        squares = np.concatenate([fit.residual**2 for fit in others])
        self._variance = np.asarray(nnls(np.concatenate(parts), squares)[0])
        self._freedom = sum(fit.freedom for fit in others)

    def log_ratio(self, given: ForceCurve, residual: np.ndarray, freedom: float) -> float:
        """How much likelier residuals (n,) of so many degrees of freedom are than those given."""
        # A curve that does not follow its data leaves more than noise.
        left = max(float(np.sum(residual**2)) / freedom, _ROUNDED_DEG**2)
        variance = np.maximum(self._variance[0] + self._variance[1] * given.slope**2, left)
        square = max(float(np.sum((given.residual**2 - residual**2) / variance)), 0.0)
        # Noise that few rows tell is Student's.
        return (self._freedom + 1) / 2 * float(np.log1p(square / self._freedom))


def find_untouched_scatter(fitted: CarrierFit) -> list[str]:
    """Ports whose untouched phases, reference of all readings, scatter more than presses do."""
    found, data = [], fitted.data
    if data.untouched_deg is None:
        return []
    rows = sum(map(len, data.untouched_rows_deg))  # each may be the wrong one
    ports = zip(data.untouched_rows_deg, data.untouched_deg, fitted.carrier.noise_deg, strict=True)
    for port, (phases, mean, noise) in enumerate(ports, 1):
        beside, freedom = wrap_deg(phases - mean), len(phases) - 1
        noise = max(noise, _ROUNDED_DEG)
        excess = float(np.sum(beside**2)) / max(freedom, 1) / noise**2
        ratio = freedom / 2 * (excess - 1 - np.log(max(excess, 1.0)))
        if excess > 1 and _is_better(ratio, rows):
            found.append(
                f"untouched phases of port {port} differ by {np.ptp(beside):.1f} deg, where "
                f"those of presses scatter by {noise:.2g} deg: is each right, and were cables "
                "fixed?"
            )
    return found
