# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks of a calibration table before curves are fitted to it."""

import numpy as np

from ..errors import InputError
from ..sensor import line
from ..sensor.model import LEAST
from ..signal.carrier import wrap_deg
from .tables import CalibrationTable

# Forces per location and port from which a curve with four coefficients has a residual.
LEAST_FORCES = 5

# Between neighbouring forces the short moves at most this far: by the contact law in line.py it
# moves by 6 mm/N at 1.0 N and less above; at the onset it reaches 4 mm at once. A larger jump is an
# error in the data unless the whole curve is as rough.
_LARGEST_STEP_MM, _LARGEST_SLOPE_MM_PER_N = 4.0, 6.0
_ROUGHNESS_FACTOR = 10.0
# A sweep that starts before the contact begins with the untouched phase, within 3 deg, and leaves
# it by a step of more than 6 deg.
_UNTOUCHED_DEG, _ONSET_STEP_DEG = 3.0, 6.0


def check_table(table: CalibrationTable, length_mm: float) -> None:
    """Reject tables with errors.

    Equal rows are repeated measurements: rounded phases of repeated sweeps are often equal.
    """
    touched = ~table.untouched
    if not np.any(touched):
        raise InputError(table.source, "has no row with a force")
    for index in np.flatnonzero(touched & (table.force_n < LEAST)):
        rule = f"must be at least {LEAST:g}, as the others are"
        raise InputError(f"{table.at(index)}: force_n", rule, float(table.force_n[index]))
    outside = touched & ~((table.location_mm > 0) & (table.location_mm < length_mm))
    for index in np.flatnonzero(outside):
        rule = f"must lie within the line, 0 to {length_mm:g} mm"
        raise InputError(f"{table.at(index)}: location_mm", rule, float(table.location_mm[index]))


def complete_locations(table: CalibrationTable) -> list[float]:
    """Locations with enough forces for curves at both ports, rising.

    ``table``: rows of one carrier.
    """
    touched = table.take(~table.untouched)
    forces = {
        place: [
            np.unique(touched.force_n[(touched.location_mm == place) & (touched.port == port)])
            for port in (1, 2)
        ]
        for place in np.unique(touched.location_mm).tolist()
    }
    return [place for place, own in forces.items() if min(map(len, own)) >= LEAST_FORCES]


def check_places(table: CalibrationTable) -> None:
    """Reject data that do not determine a model of one carrier.

    ``table``: rows of one carrier.
    """
    touched = table.take(~table.untouched)
    frequency = f"{table.frequency_hz[0] / 1e6:g} MHz"
    places = np.unique(touched.location_mm)
    if len(places) < 2:
        rule = f"must have at least two locations at {frequency}"
        raise InputError(f"{touched.at(0)}: location_mm", rule, places.tolist())
    for place in places:
        here = touched.take(touched.location_mm == place)
        forces = [np.unique(here.force_n[here.port == port]) for port in (1, 2)]
        where = f"{here.at(0)}: location {place:g} mm at {frequency}"
        for port, values in zip((1, 2), forces, strict=True):
            if len(values) < LEAST_FORCES:
                rule = f"must have at least {LEAST_FORCES} forces at port {port}"
                raise InputError(where, rule, len(values))
        if max(f[0] for f in forces) >= min(f[-1] for f in forces):
            spans = " and ".join(f"{f[0]:g}..{f[-1]:g} N" for f in forces)
            raise InputError(where, "must have forces that both ports share", spans)


def continuous_phase(table: CalibrationTable, permittivity: float) -> tuple[np.ndarray, np.ndarray]:
    """Sort phases by force and unwrap them.

    Returns order (n,): rows by rising force; phase_deg (n,): in that order. ``table``: rows of one
    carrier, location, port and press.
    """
    order = np.argsort(table.force_n, kind="stable")
    phase = np.unwrap(table.phase_deg[order], period=360.0)
    steps = np.abs(np.diff(phase))
    slope = line.round_trip_deg_per_mm(table.frequency_hz[0], permittivity)
    gaps = np.diff(table.force_n[order])
    allowed = slope * (_LARGEST_STEP_MM + _LARGEST_SLOPE_MM_PER_N * gaps)
    allowed = np.maximum(allowed, _ROUGHNESS_FACTOR * np.median(steps) if steps.size else 0.0)
    for index in np.flatnonzero(steps > allowed):
        rule = (
            f"must not jump by {steps[index]:.0f} deg (modulo 360) from row "
            f"{table.row[order[index]]} while the force changes by {gaps[index]:.3g} N"
        )
        raise InputError(f"{table.at(order[index + 1])}: phase_deg", rule)
    return order, phase


def split_untouched(table: CalibrationTable, untouched_deg: float) -> np.ndarray:
    """Find the rows of a sweep that were measured before the contact.

    Returns ndarray of bool, shape (n,): True for the first rows by force with the untouched phase,
    if a step follows.

    ``table``: one carrier, location, port and press; ``untouched_deg``: psi_i0 of this port, in
    degrees.
    """
    order = np.argsort(table.force_n, kind="stable")
    away = np.abs(wrap_deg(table.phase_deg[order] - untouched_deg))
    count = int(np.argmax(away > _UNTOUCHED_DEG)) if np.any(away > _UNTOUCHED_DEG) else 0
    before = np.zeros(len(order), bool)
    if count and away[count] > _ONSET_STEP_DEG:
        before[order[:count]] = True
    return before
