# SPDX-License-Identifier: GPL-3.0-or-later
"""What a calibration table says of each location: phase that the contact adds, over force."""

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..signal.carrier import same_carrier
from . import curves, line
from .checks import check_places, continuous_phase, split_untouched
from .model import LEAST_FREQUENCY_HZ

_FORCES_COMPARED = 9


@dataclass(frozen=True)
class ContactCurve:
    """Data of one carrier, location and port: what the contact adds to the line's phase.

    Arrays are of shape (n,) and in order of force.
    """

    force_n: np.ndarray
    added_deg: np.ndarray
    press: np.ndarray  # which press each row belongs to
    copied: bool = False  # the mirror image of another


@dataclass(frozen=True)
class CarrierData:
    """A table's data of one carrier."""

    frequency_hz: float
    location_mm: np.ndarray
    curves: list  # [port][location] of ContactCurve
    untouched_deg: tuple | None  # psi_10, psi_20
    onset: tuple  # largest untouched and least touched force (N) seen in sweeps

    def all_curves(self):
        return [curve for port in self.curves for curve in port]


def carriers_of(table):
    """Carriers of a table, rising; values within 0.1 % of each other are one."""
    carriers = []
    for frequency in np.unique(table.frequency_hz):
        if frequency < LEAST_FREQUENCY_HZ:
            index = int(np.argmax(table.frequency_hz == frequency))
            rule = f"must be positive, at least {LEAST_FREQUENCY_HZ / 1e6:g}"
            raise InputError(f"{table.at(index)}: freq_mhz", rule, frequency / 1e6)
        if not carriers or frequency > carriers[-1] * 1.001:
            carriers.append(float(frequency))
    return carriers


def carrier_data(table, frequency, length_mm, permittivity, mirror, assumed):
    """The rows of one carrier as curves; what had to be taken for granted goes to ``assumed``.

    Raises InputError, naming file and row, for what no curve can be drawn through.
    """
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
    return CarrierData(frequency, places, rows, untouched, (below, above))


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
        order, phase = continuous_phase(one, permittivity)
        phase = phase - base
        if added:
            phase += 360.0 * np.round((np.median(added[0]) - np.median(phase)) / 360.0)
        forces.append(one.force_n[order])
        added.append(phase)
        presses.append(one.press[order])
    force, value = np.concatenate(forces), np.concatenate(added)
    order = np.argsort(force, kind="stable")
    return ContactCurve(force[order], value[order], np.concatenate(presses)[order], copied)


def with_location_steps(data, location_steps):
    """The same data with the offsets of the locations brought in line, as asked."""
    if location_steps == "given":
        return data
    rows = []
    for port in data.curves:
        middles = [float(np.median(curve.added_deg)) for curve in port]
        if location_steps == "line":
            shifts = [-_value_at(curve, anchor_force(data)) for curve in port]
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


def anchor_force(data):
    """Middle (N) of the span of force that all locations share, or of all of it."""
    low = max(curve.force_n[0] for curve in data.all_curves())
    high = min(curve.force_n[-1] for curve in data.all_curves())
    return 0.5 * (low + high)


def _value_at(curve, force):
    basis = curves.PowerBasis()
    coefficients = np.linalg.lstsq(basis(curve.force_n), curve.added_deg, rcond=None)[0]
    return float(basis(force) @ coefficients)


def compared_forces(data):
    """A few forces (N) within what every location covers, or, failing that, most of them."""
    low = max(curve.force_n[0] for curve in data.all_curves())
    high = min(curve.force_n[-1] for curve in data.all_curves())
    if low >= high:
        every = np.concatenate([curve.force_n for curve in data.all_curves()])
        low, high = np.quantile(every, [0.25, 0.75])
    return np.linspace(low, high, _FORCES_COMPARED)
