# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a location of a table is wrong, or two of them were exchanged.

Each inner location is predicted from the others, which is the leave-one-out predictive
probability of Gaussian processes (C. E. Rasmussen and C. K. I. Williams, *Gaussian Processes for
Machine Learning*, 2006, section 5.4.2).
"""

from collections.abc import Mapping, Sequence
from itertools import combinations, product
from typing import Any

import numpy as np

from ..sensor import line
from ..sensor.curves import Carrier
from ..signal.carrier import wrap_deg
from .data import CarrierData
from .fit import ContactValues, interpolate

# What an explanation may leave, and how much better another one must be, in standard deviations.
_UNEXPECTED = 3.0
# Fewest locations of which one can be left out while the others still predict one of them.
_LEAST_TESTED = 4
# Places at which a press is sought, closer than a ruler is read.
_PLACE_STEP_MM = 0.1
# Nearer than a reading is expected to be, no ruler was misread.
VAGUE_MM = 0.5
# Cross-validation is stated to this.
ROUNDED_DEG, _DECIMALS = 1e-4, 4


def contradictions(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Those rows of :func:`leave_locations_out` that the other locations did not expect."""
    return [row for row in rows if row["rms_deg"] > _UNEXPECTED * row["expected_deg"]]


def leave_locations_out(
    data: CarrierData, contact: ContactValues, ruler_std_mm: float = 0.0
) -> list[dict[str, Any]]:
    """Predict each inner location from the others.

    Returns list of dict: ``frequency_mhz``, ``location_mm``, ``port``, ``rms_deg`` of the
    prediction and ``expected_deg``, which the interpolation states; by location and port.

    ``contact``: of all locations or of some; ``ruler_std_mm``: standard deviation of the locations.
    """
    rows = []
    ruler_deg = ruler_std_mm * data.slope
    for j in range(1, len(contact.location_mm) - 1):
        others, place = contact.without(j), contact.location_mm[j]
        interpolation = interpolate(data, others)
        for port in (0, 1):
            values = others.added_deg[port].T
            weights = interpolation.weights(place, port)
            error = values @ weights - contact.added_deg[port, j]
            variance = interpolation.variance(np.full(len(error), place), port, values)
            # The errors of the ruler at this location and at those that predict it.
            variance = variance + ruler_deg**2 * (1 + weights @ weights)
            rows.append(
                {
                    "frequency_mhz": round(data.frequency_hz / 1e6, 6),
                    "location_mm": float(place),
                    "port": port + 1,
                    "rms_deg": round(float(np.sqrt(np.mean(error**2))), _DECIMALS),
                    "expected_deg": round(float(np.sqrt(np.mean(variance))), _DECIMALS),
                }
            )
    return rows


def find_wrong_location(
    data: CarrierData,
    carrier: Carrier,
    contact: ContactValues,
    rows: Sequence[Mapping[str, Any]],
    ruler_std_mm: float = 0.0,
) -> dict[str, Any] | None:
    """Two locations that were exchanged, or the one that the others contradict.

    A wrong location also spoils the predictions of its neighbours. It is the one without which the
    others are predicted best.

    Returns dict or None: ``frequency_mhz``, ``location_mm``, and ``exchanged_mm``, the other one
    (with ``port`` where it is one port only), or ``fits_mm``, where the others see such phases,
    None where they see them nowhere.

    ``rows``: of :func:`leave_locations_out`; the other arguments as there.
    """
    found = {"frequency_mhz": round(data.frequency_hz / 1e6, 6)}
    if exchanged := _exchanged_locations(data, contact, rows, ruler_std_mm):
        return found | exchanged
    count = len(data.location_mm)
    if count < _LEAST_TESTED or not contradictions(rows):
        return None
    others = [leave_locations_out(data, contact.without(j), ruler_std_mm) for j in range(count)]
    worst = [max(row["rms_deg"] / row["expected_deg"] for row in each) for each in others]
    wrong = int(np.argmin(worst))
    stated_mm = float(data.location_mm[wrong])
    fits_mm = _place_among(data, carrier, contact, wrong, ruler_std_mm)
    near = fits_mm is not None and abs(fits_mm - stated_mm) <= VAGUE_MM
    if worst[wrong] > _UNEXPECTED or near:
        return None
    return found | {"location_mm": stated_mm, "fits_mm": fits_mm}


def wrong_location_text(row: Mapping[str, Any]) -> str:
    """What :func:`find_wrong_location` found, in words."""
    if "exchanged_mm" in row:
        what = f"locations {row['location_mm']:g} and {row['exchanged_mm']:g} mm"
        if "port" in row:
            what += f" of port {row['port']}"
        return f"{what} would fit the others exchanged: were their presses exchanged?"
    text = f"location {row['location_mm']:g} mm does not fit the others"
    if row["fits_mm"] is None:
        return f"{text}, nor would it anywhere else: were units, ports and sensor the same there?"
    return f"{text}, which see such phases at {row['fits_mm']:g} mm: was the ruler right there?"


def _exchanged_locations(
    data: CarrierData,
    contact: ContactValues,
    rows: Sequence[Mapping[str, Any]],
    ruler_std_mm: float,
) -> dict[str, float] | None:
    """Two locations whose exchange, at one port or both, explains the phases better:
    ``location_mm``, ``exchanged_mm`` and, where it is one, ``port``.
    """
    if not rows:
        return None
    # Along a line an exchange moves phases further apart, unless it takes another one back.
    pairs = combinations(range(len(contact.location_mm)), 2)
    tried = list(product(pairs, ((0, 1), (0,), (1,))))
    values = [_exchange(data, contact, *pair, ports) for pair, ports in tried]
    spread = [float(np.var(each.added_deg, axis=1).mean()) for each in values]
    best = int(np.argmin(spread))
    as_given = _exchange(data, contact, 0, 0, (0, 1))
    if spread[best] >= np.var(as_given.added_deg, axis=1).mean():
        return None
    after = leave_locations_out(data, values[best], ruler_std_mm)
    better = is_better(_log_probability(after) - _log_probability(rows), len(tried))
    if not better or contradictions(after):
        return None
    pair, ports = tried[best]
    first, second = (float(contact.location_mm[j]) for j in pair)
    found = {"location_mm": first, "exchanged_mm": second}
    return found if len(ports) > 1 else found | {"port": ports[0] + 1}


def _exchange(
    data: CarrierData, contact: ContactValues, first: int, second: int, ports: tuple[int, ...]
) -> ContactValues:
    """The same with the phases of two locations exchanged, turns of 360 deg by the line."""
    order = np.arange(len(contact.location_mm))
    order[[first, second]] = second, first
    added, variance = contact.added_deg.copy(), contact.variance_deg2.copy()
    for port in ports:
        added[port], variance[port] = added[port, order], variance[port, order]
        values = added[port]
        short = _short_deg(data, contact.location_mm, port)
        values += (short[order] - short)[:, None]
        middles = np.median(values, axis=1)
        values += (np.unwrap(middles, period=360.0) - middles)[:, None]
    return ContactValues(contact.location_mm, added, variance)


def _short_deg(data: CarrierData, location_mm: np.ndarray | float, port: int) -> np.ndarray:
    """Phase of a short exactly at some locations, in degrees."""
    distance = data.length_mm - location_mm if port else location_mm
    return np.asarray(line.short_phase_deg(distance, data.frequency_hz, data.permittivity))


def _log_probability(rows: Sequence[Mapping[str, Any]]) -> float:
    """Of predictions, but for a constant: the forces of a location and port err alike."""
    rms, expected = (np.array([row[name] for row in rows]) for name in ("rms_deg", "expected_deg"))
    expected = np.maximum(expected, ROUNDED_DEG)
    return float(-np.sum(np.log(expected) + 0.5 * (rms / expected) ** 2))


def is_better(log_ratio: float, count: int) -> bool:
    """Whether the best of so many other explanations is certain, by its likelihood ratio."""
    return log_ratio - np.log(count) > 0.5 * _UNEXPECTED**2


def _place_among(
    data: CarrierData, carrier: Carrier, contact: ContactValues, wrong: int, ruler_std_mm: float
) -> float | None:
    """Where the other locations expect the phases of one, in mm; None where nowhere."""
    others = contact.without(wrong)
    interpolation = interpolate(data, others)
    places = np.arange(0.0, data.length_mm, _PLACE_STEP_MM)
    squares, variances = [], []
    for port in (0, 1):
        values = others.added_deg[port].T
        short = _short_deg(data, contact.location_mm[wrong], port)
        measured = contact.added_deg[port, wrong] + short
        predicted = (
            interpolation.weights(places, port) @ values.T + _short_deg(data, places, port)[:, None]
        )
        squares.append(np.mean(wrap_deg(measured - predicted) ** 2, axis=1))
        spread = [interpolation.variance(places, port, value) for value in values]
        variances.append(np.mean(spread, axis=0) + np.square(carrier.noise_deg[port]))
    square = np.mean(squares, axis=0)
    best = int(np.argmin(square))
    expected = np.mean(variances, axis=0)[best] + (ruler_std_mm * data.slope) ** 2
    return round(float(places[best]), 1) if square[best] <= _UNEXPECTED**2 * expected else None
