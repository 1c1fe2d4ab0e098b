# SPDX-License-Identifier: GPL-3.0-or-later
"""What a calibration table must satisfy before curves are drawn through it."""

import numpy as np

from ..errors import InputError
from ..signal.carrier import wrap_deg
from . import line
from .model import LEAST

LEAST_FORCES = 5

# Between neighbouring forces the short moves at most this far; a jump beyond it is an error in the
# data unless the whole curve is that rough.
_LARGEST_STEP_MM, _LARGEST_SLOPE_MM_PER_N = 4.0, 6.0
_ROUGHNESS_FACTOR = 10.0
# A sweep that starts before the contact shows the untouched phases first.
_UNTOUCHED_DEG, _ONSET_STEP_DEG = 3.0, 6.0


def check_onset(where, onset_n, highest_n):
    """The line must be shorted within the calibrated forces; raises InputError otherwise."""
    if onset_n >= highest_n:
        rule = f"must be below the highest calibrated force, {highest_n:g}"
        raise InputError(where, rule, onset_n)


def check_table(table, length_mm):
    """Refuses tables that hold errors.

    Raises
    ------
    InputError
        Naming row, rule and value: force of the other sign, location outside the line, the same
        measurement twice.
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
    _check_duplicates(table)


def _check_duplicates(table):
    seen = {}
    for index in np.flatnonzero(~table.untouched):
        key = (
            table.frequency_hz[index],
            table.location_mm[index],
            table.port[index],
            table.press[index],
            table.force_n[index],
            table.phase_deg[index],
        )
        if key in seen:
            rule = f"must not repeat row {seen[key]}"
            raise InputError(table.at(index), rule)
        seen[key] = table.row[index]


def check_places(table):
    """Refuses what cannot make a model of one carrier: too few locations, forces or ports.

    Raises
    ------
    InputError
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


def continuous_phase(table, permittivity):
    """Phases of one carrier, location, port and press in order of force, without 360 deg jumps.

    Returns
    -------
    order : ndarray of int
        Rows by rising force.
    phase_deg : ndarray
        In that order.

    Raises
    ------
    InputError
        For a jump that is neither a multiple of 360 deg nor in the force.
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


def split_untouched(table, untouched_deg):
    """Rows of a sweep taken before the contact.

    Parameters
    ----------
    table : CalibrationTable
        One carrier, location, port and press.
    untouched_deg : float
        psi_i0 of this port.

    Returns
    -------
    ndarray of bool
        True for the first rows by force that show the untouched phase, where a step follows.
    """
    order = np.argsort(table.force_n, kind="stable")
    away = np.abs(wrap_deg(table.phase_deg[order] - untouched_deg))
    count = int(np.argmax(away > _UNTOUCHED_DEG)) if np.any(away > _UNTOUCHED_DEG) else 0
    before = np.zeros(len(order), bool)
    if count and away[count] > _ONSET_STEP_DEG:
        before[order[:count]] = True
    return before
