# SPDX-License-Identifier: GPL-3.0-or-later
"""Likely mistakes of calibration tables, and of the assumed line.

Along the line the phase falls by 2 beta per millimetre at port 1 and rises by as much at port 2,
which shows swapped ports, signs and units, and its permittivity. The changes against the untouched
line, D1 = 180 deg + 2 beta (L - l + a1) and D2 = 180 deg + 2 beta (l + a2), give its length L,
since the extents a1 and a2 of the short are alike on average along the line (line.py). Light
presses are taken, whose short is narrow.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..sensor import line
from .data import by_carrier, touched_rows, untouched_phases
from .tables import CalibrationTable

# Concentration of the phases about a line: 1 without scatter. Below this the locations have phase
# offsets of their own, as when cables were moved, and nothing follows. The slope is only
# determined by several locations.
_ON_A_LINE, _ENOUGH_LOCATIONS = 0.97, 3
_SLOPES = np.linspace(0.6, 1.8, 241)
# The asymmetry of the short shifts the length by up to 7 mm where only one half was pressed, and
# the slope by up to 25 %, more for wide contacts: the permittivity by its square.
_LENGTH_MM = 10.0
_SLOPE_LIMITS = (0.7, 1.5)
# Mean extents of a short: 1 to 11 mm by the contact law, up to a fingertip at 8 N; -6 mm where only
# changes with force are known, as in the published sweeps.
_EXTENTS_MM = (-10.0, 15.0)
# Share of the rows, those with the lightest forces, in which the short is taken to be narrow.
_LIGHT = 0.4
# Phases in radians lie within a turn, 6.28; those of a press and of the untouched line in degrees
# are further apart.
_TURN_RAD = 2 * np.pi + 0.01
# No tactile sensor is pressed with as much; 8 N are 816 g.
_LARGEST_FORCE_N = 100.0
# Presses within a tenth of the line are not a calibration, but one in other units. Phases that
# move by a tenth of what the line does from location to location are of no line.
_SMALLEST_SHARE = 0.1
# A direction is reversed if it leaves so much less scatter.
_REVERSED = 0.25
_DIRECTION_SLOPES = np.linspace(0.9, 1.4, 101)


@dataclass(frozen=True)
class _Presses:
    """The touched rows of one carrier, summed up for both ports at J locations.

    ``direction`` (2, J) is of the mean phasor of the lightest presses; 0 where a port is not
    ``known`` (2, J).
    """

    frequency_hz: float
    untouched_deg: tuple[float, float] | None
    location_mm: np.ndarray
    known: np.ndarray
    direction: np.ndarray

    def on_lines(self, slopes: np.ndarray) -> np.ndarray:
        """Mean length of both ports' mean phasors about slopes (n,) over location; shape (n,).

        0 where one was not measured along the line.
        """
        turns = np.exp(1j * np.radians(slopes)[:, None] * self.location_mm)
        count = self.known.sum(axis=1)[:, None]
        both = np.abs(np.stack([turns @ self.direction[0], turns.conj() @ self.direction[1]]))
        both = np.where(count > 1, both / np.maximum(count, 1), 0.0)
        return np.where(both.all(axis=0), both.mean(axis=0), 0.0)


def _presses(table: CalibrationTable) -> Iterator[_Presses]:
    for frequency, own in by_carrier(table):
        untouched = untouched_phases(own)
        rows, _ = touched_rows(own, untouched)
        places = np.unique(rows.location_mm)
        shape = (2, len(places))
        known, direction = np.zeros(shape, bool), np.zeros(shape, complex)
        for at in np.ndindex(shape):
            here = rows.take((rows.port == at[0] + 1) & (rows.location_mm == places[at[1]]))
            known[at] = here.row.size
            if known[at]:
                light = here.force_n <= np.quantile(here.force_n, _LIGHT)
                mean = np.mean(np.exp(1j * np.radians(here.phase_deg[light])))
                direction[at] = mean / max(abs(mean), 1e-12)
        yield _Presses(frequency, untouched, places, known, direction)


def suspicions(table: CalibrationTable, length_mm: float, permittivity: float) -> list[str]:
    """Likely mistakes in units, ports and signs of a table, or in the line; a sentence each."""
    touched = table.take(~table.untouched)
    if not touched.row.size:
        return []
    found = _units(table, touched, length_mm)
    if found:
        return found
    carriers = list(_presses(table))
    for own in carriers:
        slope = line.round_trip_deg_per_mm(own.frequency_hz, permittivity)
        found += _reversed(own, slope) or _unconnected(own, slope)
    if found:
        return list(dict.fromkeys(found))
    return [text for own in carriers for text in _other_line(own, length_mm, permittivity)]


def untouched_assumed(table: CalibrationTable, length_mm: float) -> list[str]:
    """What follows where a table has no untouched rows; a sentence per carrier."""
    return [
        f"no rows of the untouched sensor (force_n 0, no location) at {frequency / 1e6:g} MHz: its "
        f"phases are taken to be those of a line of {length_mm:g} mm, and what they are off shifts "
        "every reading"
        for frequency, own in by_carrier(table)
        if untouched_phases(own) is None
    ]


def stated_suspicions(found: Sequence[str]) -> dict[str, list[str]]:
    """What the provenance of a model says of likely mistakes; empty where there are none."""
    return {"suspicions": list(dict.fromkeys(found))} if found else {}


def _units(table: CalibrationTable, touched: CalibrationTable, length_mm: float) -> list[str]:
    found = radians_suspicion(table.phase_deg)
    farthest_mm = float(np.max(touched.location_mm))
    if 0 < farthest_mm <= _SMALLEST_SHARE * length_mm:
        unit = "metres" if farthest_mm < 1 else "centimetres"
        found.append(
            f"all locations lie within {farthest_mm:g} mm of port 1: are they in {unit} instead of "
            "millimetres?"
        )
    hardest = float(np.max(touched.force_n))
    if hardest > _LARGEST_FORCE_N:
        found.append(f"forces reach {hardest:g} N: are they in grams (1 N is 102 g)?")
    return found


def radians_suspicion(phases_deg: np.ndarray) -> list[str]:
    """A sentence where all phases are as small as angles in radians."""
    widest = float(np.max(np.abs(phases_deg)))
    if widest > _TURN_RAD:
        return []
    return [f"all phases lie within +-{widest:.1f}: are they in radians instead of degrees?"]


# Which ports are reversed, and what is said of them.
_REVERSALS = {
    (True, False): "the phase of port 1 alone moves",
    (False, True): "the phase of port 2 alone moves",
    (True, True): "the phases of both ports move",
}


def _reversed(own: _Presses, slope: float) -> list[str]:
    """Ports whose phases follow a line if location or sign is reversed, and do not as given."""
    given = 1 - float(own.on_lines(slope * _SLOPES).max())
    if len(own.location_mm) < _ENOUGH_LOCATIONS or given <= 1 - _ON_A_LINE:
        return []
    left = {}
    for ports in _REVERSALS:
        direction = np.where(np.array(ports)[:, None], own.direction.conj(), own.direction)
        turned = replace(own, direction=direction)
        left[ports] = 1 - float(turned.on_lines(slope * _DIRECTION_SLOPES).max())
    best, *others = sorted(left, key=left.__getitem__)
    if left[best] > min(1 - _ON_A_LINE, _REVERSED * min(given, left[others[0]])):
        return []
    return [
        f"{_REVERSALS[best]} with location in the wrong direction: are ports swapped, is location "
        "measured from the other end, or the sign inverted (it must be that of arg S11, arg S22)?"
    ]


def _unconnected(own: _Presses, slope: float) -> list[str]:
    """Ports whose phases are alike at all locations, as without a sensor."""
    found = []
    # Two may be half a wavelength apart.
    for port in np.flatnonzero(own.known.sum(axis=1) > 2):
        along, places = own.direction[port, own.known[port]], own.location_mm[own.known[port]]
        about_deg = np.degrees(np.angle(along * np.conj(along.mean())))
        if np.ptp(about_deg) <= _SMALLEST_SHARE * slope * np.ptp(places):
            found.append(
                f"the phase of port {port + 1} is the same at all locations: is the sensor "
                "connected?"
            )
    return found


def _other_line(own: _Presses, length_mm: float, permittivity: float) -> list[str]:
    """Whether the phases are those of a line of another permittivity, length or far end."""
    slope = line.round_trip_deg_per_mm(own.frequency_hz, permittivity)
    scores = own.on_lines(_SLOPES * slope)
    if scores.max() < _ON_A_LINE or len(own.location_mm) < _ENOUGH_LOCATIONS:
        return []
    at, ratio = f"{own.frequency_hz / 1e6:g} MHz: ", _SLOPES[np.argmax(scores)]
    if not _SLOPE_LIMITS[0] <= ratio <= _SLOPE_LIMITS[1]:
        return [
            f"{at}phases change with location as on a line of permittivity "
            f"{permittivity * ratio**2:.2g}, not {permittivity:g}: check --permittivity, and that "
            "locations are in mm"
        ]
    if own.untouched_deg is None:
        return []
    # Phasors of the extents of the short; where the line is longer, that of port 1 as well.
    open_mm = np.stack([length_mm - own.location_mm, own.location_mm])
    expected = np.array(own.untouched_deg)[:, None] + 180.0 + slope * open_mm
    beyond = own.direction * np.exp(-1j * np.radians(expected))
    longer = (beyond[0] * beyond[1].conj())[own.known.all(axis=0)]
    longer_mm = float(np.degrees(np.angle(np.mean(longer)))) / slope
    if abs(longer_mm) > _LENGTH_MM:
        return [
            f"{at}touched and untouched phases are those of a line of about "
            f"{length_mm + longer_mm:.0f} mm, not {length_mm:g} mm: were cables, reference planes "
            "and the open far end (50 ohm reflects nothing) the same for all rows, does the ruler "
            "begin at port 1, and is --length-mm right?"
        ]
    # What is off by as much at both ports does not show in the length.
    extent_deg = float(np.degrees(np.angle(np.mean(beyond[own.known]))))
    if _EXTENTS_MM[0] <= extent_deg / slope <= _EXTENTS_MM[1]:
        return []
    return [
        f"{at}untouched phases are off by some {-extent_deg:+.0f} deg at both ports: was the far "
        "end open while untouched (not shorted, nor 50 ohm), with the cables of the presses?"
    ]
