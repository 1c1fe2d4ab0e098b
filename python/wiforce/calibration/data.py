# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibration data per location and port, checked: the phase added by the contact, over force."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ..errors import InputError
from ..sensor import curves, line
from ..sensor.line import LEAST
from ..signal.carrier import CARRIER_TOLERANCE, CARRIERS_HZ, same_carrier, wrap_deg
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
    """Reject tables with errors; equal rows may be repeated measurements."""
    touched = ~table.untouched
    if not np.any(touched):
        raise InputError(table.source, "has no row with a force")
    rules = (
        ("force_n", table.force_n >= LEAST, f"must be at least {LEAST:g}, as the others are"),
        (
            "location_mm",
            (table.location_mm > 0) & (table.location_mm < length_mm),
            f"must lie within the line, 0 to {length_mm:g} mm",
        ),
    )
    for name, holds, rule in rules:
        for index in np.flatnonzero(touched & ~holds)[:1]:
            raise InputError(f"{table.at(index)}: {name}", rule, float(getattr(table, name)[index]))


def _forces_at(table: CalibrationTable) -> dict[float, list[np.ndarray]]:
    """The different forces of touched rows at each location, by port; all rising."""
    touched = table.take(~table.untouched)
    return {
        place: [
            np.unique(touched.force_n[(touched.location_mm == place) & (touched.port == port)])
            for port in (1, 2)
        ]
        for place in np.unique(touched.location_mm).tolist()
    }


def without_incomplete(table: CalibrationTable) -> CalibrationTable:
    """One carrier's rows but for locations with too few forces, if others are left for curves."""
    forces = _forces_at(table).items()
    complete = [place for place, own in forces if min(map(len, own)) >= LEAST_FORCES]
    if len(complete) < 2:
        return table
    return table.take(table.untouched | np.isin(table.location_mm, complete))


def _check_places(touched: CalibrationTable) -> None:
    """Reject rows that do not determine a model of one carrier."""
    frequency = f"{touched.frequency_hz[0] / 1e6:g} MHz"
    places = _forces_at(touched)
    if len(places) < 2:
        rule = f"must have at least two locations at {frequency}"
        raise InputError(f"{touched.at(0)}: location_mm", rule, list(places))
    for place, forces in places.items():
        first = int(np.argmax(touched.location_mm == place))
        where = f"{touched.at(first)}: location {place:g} mm at {frequency}"
        for port, values in enumerate(forces, 1):
            if len(values) < LEAST_FORCES:
                rule = f"must have at least {LEAST_FORCES} forces at port {port}"
                raise InputError(where, rule, len(values))
        if max(f[0] for f in forces) >= min(f[-1] for f in forces):
            spans = " and ".join(f"{f[0]:g}..{f[-1]:g} N" for f in forces)
            raise InputError(where, "must have forces that both ports share", spans)


def unwrap_over_force(
    force_n: np.ndarray, phase_deg: np.ndarray, slope: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows (n,) of a press and port by force, unwrapped phases, and too large steps (n - 1,)."""
    order = np.argsort(force_n, kind="stable")
    phase = np.unwrap(phase_deg[order], period=360.0)
    steps, gaps = np.abs(np.diff(phase)), np.diff(force_n[order])
    allowed = slope * (_LARGEST_STEP_MM + _LARGEST_SLOPE_MM_PER_N * gaps)
    rough = _ROUGHNESS_FACTOR * np.median(steps) if steps.size else 0.0
    return order, phase, steps > np.maximum(allowed, rough)


def _continuous_phase(table: CalibrationTable, slope: float) -> tuple[np.ndarray, np.ndarray]:
    """The first two of :func:`unwrap_over_force`; steps that are too large are refused."""
    order, phase, jumps = unwrap_over_force(table.force_n, table.phase_deg, slope)
    for index in np.flatnonzero(jumps)[:1]:
        row, after = order[[index, index + 1]]
        rule = (
            f"must not jump by {abs(phase[index + 1] - phase[index]):.0f} deg (modulo 360) from "
            f"row {table.row[row]} while the force changes by "
            f"{table.force_n[after] - table.force_n[row]:.3g} N (rows or cables exchanged, or "
            "typed wrong?)"
        )
        raise InputError(f"{table.at(after)}: phase_deg", rule)
    return order, phase


def _before_contact(table: CalibrationTable, untouched_deg: float) -> np.ndarray:
    """Which rows of a sweep (n,) have the untouched phase, from the least force until a step."""
    order = np.argsort(table.force_n, kind="stable")
    away = np.abs(wrap_deg(table.phase_deg[order] - untouched_deg))
    count = int(np.argmax(away > _UNTOUCHED_DEG))
    before = np.zeros(len(order), bool)
    before[order[:count]] = away[count] > _ONSET_STEP_DEG
    return before


# Forces at which curves of different locations are compared.
_FORCES_COMPARED = 9
# A branch ends where the force turns by more than this part of its span, which a load cell's noise
# does not reach. Shorter branches are no sweeps, and data with more of them are in no order.
_TURN, _LEAST_BRANCH, _ORDERED_SHARE = 0.2, 4, 0.8


@dataclass(frozen=True)
class ContactCurve:
    """Data of one carrier, location and port, in order of force.

    ``added_deg`` (n,) are relative to a short exactly at the press; ``direction`` (n,) is 1 while
    loading, -1 while unloading, 0 where unknown; ``copied`` where mirrored from another location.
    """

    port: int
    location_mm: float
    force_n: np.ndarray
    added_deg: np.ndarray
    press: np.ndarray
    copied: bool
    direction: np.ndarray


@dataclass(frozen=True)
class CarrierData:
    """A table's data of one carrier at J locations, and the line that they are of.

    ``curves`` (2 J) are those of port 1 and then of port 2, by location; ``untouched_deg`` are
    means of ``untouched_rows_deg``; ``onset`` is the largest untouched and the least touched force
    of sweeps from before the contact, in N; None without such rows.
    """

    frequency_hz: float
    location_mm: np.ndarray
    curves: list[ContactCurve]
    untouched_deg: tuple[float, float] | None
    untouched_rows_deg: tuple[np.ndarray, ...]
    onset: tuple[float, float] | None
    length_mm: float
    permittivity: float
    ruler_std_mm: float  # of the locations

    @property
    def slope(self) -> float:
        """Change of the phase along the line, in deg/mm."""
        return line.round_trip_deg_per_mm(self.frequency_hz, self.permittivity)

    @property
    def anchor_n(self) -> float:
        """Middle of the span of force that all locations share, in N."""
        return sum(self.shared_span_n) / 2

    @property
    def shared_span_n(self) -> tuple[float, float]:
        """Least and greatest force that all locations share; in reverse where they share none."""
        spans = np.array([curve.force_n[[0, -1]] for curve in self.curves])
        return float(spans[:, 0].max()), float(spans[:, 1].min())


def by_carrier(table: CalibrationTable) -> list[tuple[float, CalibrationTable]]:
    """Rows of each carrier, in Hz, rising; values within 0.1 % of each other are one carrier."""
    carriers: list[float] = []
    for frequency in np.unique(table.frequency_hz):
        if not CARRIERS_HZ[0] <= frequency <= CARRIERS_HZ[1]:
            index = int(np.argmax(table.frequency_hz == frequency))
            least, most = (limit / 1e6 for limit in CARRIERS_HZ)
            rule = f"must be {least:g} to {most:g} MHz (not in Hz or GHz)"
            raise InputError(f"{table.at(index)}: freq_mhz", rule, frequency / 1e6)
        if not carriers or frequency > carriers[-1] * (1 + CARRIER_TOLERANCE):
            carriers.append(float(frequency))
    return [(each, table.take(same_carrier(table.frequency_hz, each))) for each in carriers]


def carrier_data(
    frequency: float,
    table: CalibrationTable,
    length_mm: float,
    permittivity: float,
    ruler_std_mm: float,
    mirror: bool,
    location_steps: str,
    assumed: list[str],
) -> CarrierData:
    """Arrange the rows of one carrier by location and port; what is ``assumed`` is appended."""
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
    _check_places(touched)
    places = np.unique(touched.location_mm)
    slope = line.round_trip_deg_per_mm(frequency, permittivity)
    contact_curves = []
    for port, place in product((1, 2), places.tolist()):
        rows = touched.take((touched.location_mm == place) & (touched.port == port))
        distance = place if port == 1 else length_mm - place
        short_deg = line.short_phase_deg(distance, frequency, permittivity)
        contact_curves.append(_curve(rows, short_deg, slope, place not in own))
    single = table.take(table.untouched)
    data = CarrierData(
        frequency,
        places,
        contact_curves,
        untouched,
        tuple(single.phase_deg[single.port == port] for port in (1, 2) if untouched),
        onset,
        length_mm,
        permittivity,
        ruler_std_mm,
    )
    return _with_location_steps(data, location_steps)


def untouched_phases(table: CalibrationTable) -> tuple[float, float] | None:
    """psi_10 and psi_20 in degrees, means of untouched rows' phasors; None without for a port."""
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
            before = _before_contact(table.take(branch), untouched[key[1] - 1])
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
    return CalibrationTable.joined(parts)


def _curve(
    rows: CalibrationTable, short_deg: np.ndarray, slope: float, copied: bool
) -> ContactCurve:
    """The curve of one location and port; ``short_deg``: phase of a short exactly there."""
    parts: list[tuple[np.ndarray, ...]] = []
    for press in dict.fromkeys(rows.press):
        one = rows.take(rows.press == press)
        order, phase = _continuous_phase(one, slope)
        phase = phase - short_deg
        if parts:
            phase += 360.0 * np.round((np.median(parts[0][1]) - np.median(phase)) / 360.0)
        direction = sweep_directions(one.force_n)[order]
        parts.append((one.force_n[order], phase, one.press[order], direction))
    force, added, presses, directions = map(np.concatenate, zip(*parts, strict=True))
    order = np.argsort(force, kind="stable")
    return ContactCurve(
        int(rows.port[0]),
        float(rows.location_mm[0]),
        force[order],
        added[order],
        presses[order],
        copied,
        directions[order],
    )


def _with_location_steps(data: CarrierData, location_steps: str) -> CarrierData:
    """Shift the phases of each location, ``nearest``, ``given`` or by the ``line``."""
    if location_steps == "given":
        return data
    if location_steps == "line":
        basis, anchor = curves.PowerBasis(), data.anchor_n
        fits = [np.linalg.lstsq(basis(c.force_n), c.added_deg, rcond=None)[0] for c in data.curves]
        shifts = np.array([-float(basis(anchor) @ fit) for fit in fits])
    else:
        # the phase added by the contact differs little from one location to the next
        middles = np.reshape([np.median(curve.added_deg) for curve in data.curves], (2, -1))
        shifts = (np.unwrap(middles, period=360.0) - middles).ravel()
    moved = zip(data.curves, shifts.tolist(), strict=True)
    return replace(data, curves=[replace(c, added_deg=c.added_deg + by) for c, by in moved])


def compared_forces(data: CarrierData) -> np.ndarray:
    """Forces (9,) in N over the span that all locations share, else the middle of all forces."""
    low, high = data.shared_span_n
    if low >= high:
        every = np.concatenate([curve.force_n for curve in data.curves])
        low, high = np.quantile(every, [0.25, 0.75])
    return np.linspace(low, high, _FORCES_COMPARED)


def sweep_directions(force_n: np.ndarray) -> np.ndarray:
    """Whether the force (n,) of a press rose, 1, or fell, -1; all 0 without an order."""
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
