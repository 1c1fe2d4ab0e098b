# SPDX-License-Identifier: GPL-3.0-or-later
"""Length and permittivity of the line, estimated from calibration data.

Along the line the phase falls by 2 beta per millimetre at port 1 and rises by as much at port 2. At
light forces the short is narrow, so that both slopes give the permittivity. The changes against
the untouched line, D1 = 180 deg + 2 beta (L - l + a1) and D2 = 180 deg + 2 beta (l + a2), give its
length L, since the extents a1 and a2 of the short are alike on average along the line (line.py).
"""

from dataclasses import dataclass

import numpy as np

from ..sensor import line
from ..signal.carrier import same_carrier, wrap_deg
from .data import carriers_of, untouched_phases
from .tables import CalibrationTable

# Concentration of the phases about a line: 1 without scatter. Below this the locations have phase
# offsets of their own, as when cables were moved, and nothing follows. The slope is only
# determined by several locations.
ON_A_LINE, ENOUGH_LOCATIONS = 0.97, 3
_SLOPES = np.linspace(0.6, 1.8, 241)
# Share of the rows, those with the lightest forces, in which the short is taken to be narrow.
_LIGHT = 0.4


@dataclass(frozen=True)
class LineEstimate:
    """What the data of one carrier say about the line.

    ``length_mm``: the length next to the assumed one; None where there are no untouched rows;
    ``ambiguity_mm``: lengths that differ by this give the same phases: half a wavelength.
    """

    frequency_hz: float
    permittivity: float | None
    length_mm: float | None
    ambiguity_mm: float

    def text(self) -> str:
        """The estimate in words."""
        if self.permittivity is None:
            return "the phases of different locations do not tell"
        length = (
            "a length that only untouched rows would tell"
            if self.length_mm is None
            else f"{self.length_mm:.0f} mm (modulo {self.ambiguity_mm:.0f} mm)"
        )
        return f"the data suggest roughly {length} and permittivity {self.permittivity:.2g}"


def estimate_line(
    table: CalibrationTable, length_mm: float, permittivity: float
) -> list[LineEstimate]:
    """Estimate length and permittivity of the line from the data of each carrier.

    Returns list of LineEstimate: rough ones, within 10 mm and 60 %, since the contact law is not
    known.
    """
    return [
        _estimate(table.take(same_carrier(table.frequency_hz, f)), f, length_mm, permittivity)
        for f in carriers_of(table)
    ]


def concentrations(rows: CalibrationTable, slopes: np.ndarray) -> np.ndarray:
    """How well the phases of light presses follow each of some slopes over location.

    Returns ndarray, shape (n,): length of the mean phasor about the slope, mean of both ports: 1
    without scatter, 0 where fewer than two locations were pressed.

    ``rows``: touched rows of one carrier; ``slopes`` (n,): of port 2, in deg/mm; port 1 has the
    opposite one.
    """
    values = np.zeros((2, len(slopes)))
    for row, (port, sign) in enumerate(((1, -1), (2, 1))):
        places, phasors = _mean_phasors(rows, port)
        if len(places) < 2:
            return np.zeros(len(slopes))
        turns = np.exp(-1j * np.radians(sign * slopes[:, None] * places))
        values[row] = np.abs(np.mean(phasors * turns, axis=1))
    return values.mean(axis=0)


def _mean_phasors(rows: CalibrationTable, port: int) -> tuple[np.ndarray, np.ndarray]:
    """Locations of a port, and the direction of the mean phasor of the lightest presses at each."""
    own = rows.take(rows.port == port)
    places = np.unique(own.location_mm)
    means = []
    for place in places:
        here = own.take(own.location_mm == place)
        light = here.force_n <= np.quantile(here.force_n, _LIGHT)
        means.append(np.mean(np.exp(1j * np.radians(here.phase_deg[light]))))
    phasors = np.array(means)
    return places, phasors / np.maximum(np.abs(phasors), 1e-12)


def _estimate(
    rows: CalibrationTable, frequency_hz: float, length_mm: float, permittivity: float
) -> LineEstimate:
    slope = line.round_trip_deg_per_mm(frequency_hz, permittivity)
    ambiguity_mm = float(360.0 / slope)
    touched = rows.take(~rows.untouched)
    scores = concentrations(touched, _SLOPES * slope)
    best = int(np.argmax(scores))
    places = np.unique(touched.location_mm)
    if scores[best] < ON_A_LINE or len(places) < ENOUGH_LOCATIONS:
        return LineEstimate(frequency_hz, None, None, ambiguity_mm)
    own_permittivity = float(permittivity * _SLOPES[best] ** 2)
    untouched = untouched_phases(rows)
    if untouched is None:
        return LineEstimate(frequency_hz, own_permittivity, None, ambiguity_mm)
    lengths = _lengths_mm(touched, untouched, slope)
    turns = np.mean(np.exp(1j * np.radians(slope * lengths)))
    beyond = wrap_deg(np.degrees(np.angle(turns)) - slope * length_mm) / slope
    return LineEstimate(frequency_hz, own_permittivity, float(length_mm + beyond), ambiguity_mm)


def _lengths_mm(
    touched: CalibrationTable, untouched_deg: tuple[float, float], slope: float
) -> np.ndarray:
    """Length of the line from the light presses at each location, modulo half a wavelength."""
    places, first = _mean_phasors(touched, 1)
    others, second = _mean_phasors(touched, 2)
    common, rows, columns = np.intersect1d(places, others, return_indices=True)
    changes = [
        np.degrees(np.angle(phasors)) - start
        for phasors, start in zip((first[rows], second[columns]), untouched_deg, strict=True)
    ]
    extent = wrap_deg(changes[1] - 180.0 - slope * common) / slope
    return np.asarray((changes[0] - 180.0) / slope + common - extent)
