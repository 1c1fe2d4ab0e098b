# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibration data per location and port: the phase added by the contact, over force."""

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..sensor import curves, line
from ..signal.carrier import CARRIERS_HZ, same_carrier
from .checks import check_places, continuous_phase, split_untouched
from .tables import CalibrationTable

# Forces at which curves of different locations are compared.
_FORCES_COMPARED = 9
# Relative difference below which two frequencies of a table are the same carrier.
_CARRIER_TOLERANCE = 1e-3
# A branch ends where the force turns by more than this part of its span, which a load cell's noise
# does not reach. Shorter branches are no sweeps, and data with more of them are in no order.
_TURN, _LEAST_BRANCH, _ORDERED_SHARE = 0.2, 4, 0.8


@dataclass(frozen=True)
class ContactCurve:
    """Data of one carrier, location and port, in order of force.

    ``force_n`` (n,); ``added_deg`` (n,): phase relative to a short exactly at the press, in
    degrees; ``press`` (n,): the press that each sample belongs to; ``copied``: whether it is the
    mirror image of another location; ``direction`` (n,): 1 while loading, -1 while unloading, 0
    where it is unknown.
    """

    force_n: np.ndarray
    added_deg: np.ndarray
    press: np.ndarray
    copied: bool = False
    direction: np.ndarray | None = None


@dataclass(frozen=True)
class CarrierData:
    """A table's data of one carrier.

    ``location_mm`` (J,): locations from port 1, rising; ``curves``: by port and location;
    ``untouched_deg``: psi_10 and psi_20 in degrees; None when the table has no untouched rows;
    ``onset``: largest untouched and smallest touched force of sweeps that begin before the contact,
    in N; None when there are none.
    """

    frequency_hz: float
    location_mm: np.ndarray
    curves: list[list[ContactCurve]]
    untouched_deg: tuple[float, float] | None
    onset: tuple[float, float] | None

    def all_curves(self) -> list[ContactCurve]:
        """The curves of both ports, one after the other."""
        return [curve for port in self.curves for curve in port]


def carriers_of(table: CalibrationTable) -> list[float]:
    """Carriers of a table in Hz, rising.

    Returns list of float: values within 0.1 % of each other are one carrier.
    """
    carriers: list[float] = []
    for frequency in np.unique(table.frequency_hz):
        if not CARRIERS_HZ[0] <= frequency <= CARRIERS_HZ[1]:
            index = int(np.argmax(table.frequency_hz == frequency))
            least, most = (limit / 1e6 for limit in CARRIERS_HZ)
            rule = f"must be positive, from {least:g} to {most:g} MHz"
            raise InputError(f"{table.at(index)}: freq_mhz", rule, frequency / 1e6)
        if not carriers or frequency > carriers[-1] * (1 + _CARRIER_TOLERANCE):
            carriers.append(float(frequency))
    return carriers


def carrier_data(
    table: CalibrationTable,
    frequency: float,
    length_mm: float,
    permittivity: float,
    mirror: bool,
    assumed: list[str],
) -> CarrierData:
    """Arrange the rows of one carrier by location and port.

    ``assumed``: assumptions are appended to it.
    """
    table = table.take(same_carrier(table.frequency_hz, frequency))
    untouched = untouched_phases(table)
    if untouched is None:
        assumed.append(
            f"untouched phases at {frequency / 1e6:g} MHz are those of a line of "
            f"{length_mm:g} mm: the table has none"
        )
    touched, onset = _without_untouched_sweeps(table, untouched)
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
    return CarrierData(frequency, places, rows, untouched, onset)


def untouched_phases(table: CalibrationTable) -> tuple[float, float] | None:
    """psi_10 and psi_20 of a table's untouched rows.

    Returns (float, float) or None: in degrees, averaged over phasors; None without such rows for
    both ports.
    """
    rows = table.take(table.untouched)
    if set(rows.port) != {1, 2}:
        return None
    means = [np.mean(np.exp(1j * np.deg2rad(rows.phase_deg[rows.port == p]))) for p in (1, 2)]
    first, second = (float(np.rad2deg(np.angle(mean))) for mean in means)
    return first, second


def _without_untouched_sweeps(
    table: CalibrationTable, untouched: tuple[float, float] | None
) -> tuple[CalibrationTable, tuple[float, float] | None]:
    """Touched rows; the largest force measured without contact and the smallest with it."""
    keep = ~table.untouched
    if untouched is None:
        return table.take(keep), None
    sweeps = np.flatnonzero(keep)
    below, above = [], []
    for key in {(table.location_mm[i], table.port[i], table.press[i]) for i in sweeps}:
        rows = np.flatnonzero(
            keep & (table.location_mm == key[0]) & (table.port == key[1]) & (table.press == key[2])
        )
        # While unloading, the line opens at another force than the one that shorted it.
        direction = sweep_directions(table.force_n[rows])
        for branch in (rows[direction == sign] for sign in np.unique(direction)):
            before = split_untouched(table.take(branch), untouched[key[1] - 1])
            if np.any(before) and not np.all(before):
                below.append(table.force_n[branch[before]].max())
                above.append(table.force_n[branch[~before]].min())
                keep[branch[before]] = False
    if not below:
        return table.take(keep), None
    return table.take(keep), (float(np.median(below)), float(np.median(above)))


def _mirrored(table: CalibrationTable, length_mm: float, assumed: list[str]) -> CalibrationTable:
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


def _curve(
    table: CalibrationTable,
    place: float,
    port: int,
    length_mm: float,
    permittivity: float,
    copied: bool,
) -> ContactCurve:
    rows = table.take((table.location_mm == place) & (table.port == port))
    distance = place if port == 1 else length_mm - place
    base = line.short_phase_deg(distance, rows.frequency_hz[0], permittivity)
    forces: list[np.ndarray] = []
    added: list[np.ndarray] = []
    presses: list[np.ndarray] = []
    directions: list[np.ndarray] = []
    for press in dict.fromkeys(rows.press):
        one = rows.take(rows.press == press)
        order, phase = continuous_phase(one, permittivity)
        phase = phase - base
        if added:
            phase += 360.0 * np.round((np.median(added[0]) - np.median(phase)) / 360.0)
        forces.append(one.force_n[order])
        added.append(phase)
        presses.append(one.press[order])
        directions.append(sweep_directions(one.force_n)[order])
    force, value = np.concatenate(forces), np.concatenate(added)
    order = np.argsort(force, kind="stable")
    return ContactCurve(
        force[order],
        value[order],
        np.concatenate(presses)[order],
        copied,
        np.concatenate(directions)[order],
    )


def with_location_steps(data: CarrierData, location_steps: str) -> CarrierData:
    """Shift the phases of each location as a setting of :func:`.calibration.calibrate` says.

    ``location_steps``: ``nearest``, ``given`` or ``line``.
    """
    if location_steps == "given":
        return data
    rows = []
    for port in data.curves:
        middles = [float(np.median(curve.added_deg)) for curve in port]
        if location_steps == "line":
            shifts = [-_value_at(curve, anchor_force(data)) for curve in port]
        else:
            # the phase added by the contact differs little from one location to the next
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


def anchor_force(data: CarrierData) -> float:
    """Middle of the span of force that all locations share, in N."""
    low = max(curve.force_n[0] for curve in data.all_curves())
    high = min(curve.force_n[-1] for curve in data.all_curves())
    return float(0.5 * (low + high))


def _value_at(curve: ContactCurve, force: float) -> float:
    basis = curves.PowerBasis()
    coefficients = np.linalg.lstsq(basis(curve.force_n), curve.added_deg, rcond=None)[0]
    return float(basis(force) @ coefficients)


def compared_forces(data: CarrierData) -> np.ndarray:
    """Forces at which locations are compared, in N.

    Returns ndarray, shape (9,): over the span that all locations share, otherwise over the middle
    half of all forces.
    """
    low = max(curve.force_n[0] for curve in data.all_curves())
    high = min(curve.force_n[-1] for curve in data.all_curves())
    if low >= high:
        every = np.concatenate([curve.force_n for curve in data.all_curves()])
        low, high = np.quantile(every, [0.25, 0.75])
    return np.linspace(low, high, _FORCES_COMPARED)


def sweep_directions(force_n: np.ndarray) -> np.ndarray:
    """Whether the force of a press rose or fell, from the order of its rows.

    Returns ndarray of int, shape (n,): 1 while loading, -1 while unloading. All 0 where the rows
    are in no order of measurement.

    ``force_n`` (n,): of one press, in the order in which it was measured.
    """
    direction = np.zeros(len(force_n), int)
    for start, stop, sign in _branches(force_n):
        if stop - start >= _LEAST_BRANCH:
            direction[start:stop] = sign
    if np.mean(direction != 0) < _ORDERED_SHARE:
        direction[:] = 0
    return direction


def _branches(force_n: np.ndarray) -> list[tuple[int, int, int]]:
    """First row, row after the last one, and sign of each rise and fall of the force."""
    turn = _TURN * np.ptp(force_n)
    found, start, extreme, sign = [], 0, 0, 0
    for row in range(1, len(force_n)):
        change = force_n[row] - force_n[extreme]
        if not sign and abs(change) > turn:
            sign = 1 if change > 0 else -1
        if sign * change >= 0:
            extreme = row if sign else extreme
        elif abs(change) > turn:
            found.append((start, extreme + 1, sign))
            start, extreme, sign = extreme + 1, row, -sign
    return [*found, (start, len(force_n), sign)]
