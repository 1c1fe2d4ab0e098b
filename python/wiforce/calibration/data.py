# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibration data per location and port, checked: the phase added by the contact, over force."""

from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..sensor import curves, line
from ..sensor.model import LEAST
from ..signal.carrier import CARRIERS_HZ, same_carrier, wrap_deg
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
            f"{table.row[order[index]]} while the force changes by {gaps[index]:.3g} N "
            "(rows or cables exchanged, or typed wrong?)"
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
    """A table's data of one carrier, and the line that they are of.

    ``location_mm`` (J,): locations from port 1, rising; ``curves``: by port and location;
    ``untouched_deg``: psi_10 and psi_20 in degrees; None when the table has no untouched rows;
    ``untouched_rows_deg``: by port, those that they are means of;
    ``onset``: largest untouched and smallest touched force of sweeps that begin before the contact,
    in N; None when there are none.
    """

    frequency_hz: float
    location_mm: np.ndarray
    curves: list[list[ContactCurve]]
    untouched_deg: tuple[float, float] | None
    onset: tuple[float, float] | None
    length_mm: float
    permittivity: float
    untouched_rows_deg: tuple[np.ndarray, ...] = ()

    @property
    def slope(self) -> float:
        """Change of the phase along the line, in deg/mm."""
        return line.round_trip_deg_per_mm(self.frequency_hz, self.permittivity)

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
            rule = f"must be {least:g} to {most:g} MHz (not in Hz or GHz)"
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
    touched, onset = touched_rows(table, untouched)
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
    single = table.take(table.untouched)
    return CarrierData(
        frequency,
        places,
        rows,
        untouched,
        onset,
        length_mm,
        permittivity,
        tuple(single.phase_deg[single.port == port] for port in (1, 2) if untouched),
    )


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


def touched_rows(
    table: CalibrationTable, untouched: tuple[float, float] | None
) -> tuple[CalibrationTable, tuple[float, float] | None]:
    """Rows in contact; the largest force measured without contact and the smallest with it."""
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
    parts: list[tuple[np.ndarray, ...]] = []
    for press in dict.fromkeys(rows.press):
        one = rows.take(rows.press == press)
        order, phase = continuous_phase(one, permittivity)
        phase = phase - base
        if parts:
            phase += 360.0 * np.round((np.median(parts[0][1]) - np.median(phase)) / 360.0)
        direction = sweep_directions(one.force_n)[order]
        parts.append((one.force_n[order], phase, one.press[order], direction))
    force, added, presses, directions = map(np.concatenate, zip(*parts, strict=True))
    order = np.argsort(force, kind="stable")
    return ContactCurve(force[order], added[order], presses[order], copied, directions[order])


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
