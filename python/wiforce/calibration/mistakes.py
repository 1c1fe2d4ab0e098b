# SPDX-License-Identifier: GPL-3.0-or-later
"""Likely mistakes of calibration tables, of the assumed line, and of phases for a model.

The line's length and permittivity are estimated from the data. Along the line the phase falls by
2 beta per millimetre at port 1 and rises by as much at port 2. At light forces the short is narrow,
so that both slopes give the permittivity. The changes against the untouched line, D1 = 180 deg +
2 beta (L - l + a1) and D2 = 180 deg + 2 beta (l + a2), give its length L, since the extents a1 and
a2 of the short are alike on average along the line (line.py).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..sensor import line
from ..sensor.model import SensorModel
from ..signal.carrier import same_carrier, wrap_deg
from .data import carriers_of, touched_rows, untouched_phases
from .tables import CalibrationTable
from .validation import shift_per_degree

# Concentration of the phases about a line: 1 without scatter. Below this the locations have phase
# offsets of their own, as when cables were moved, and nothing follows. The slope is only
# determined by several locations.
ON_A_LINE, ENOUGH_LOCATIONS = 0.97, 3
_SLOPES = np.linspace(0.6, 1.8, 241)
# The asymmetry of the short shifts the length by up to 7 mm where only one half was pressed, and
# the slope by up to 25 %, more for wide contacts: the permittivity by its square.
_LENGTH_MM = 10.0
_PERMITTIVITY_RATIO = 1.6
_SLOPE_LIMITS = (0.7, 1.5)
# Mean extents of a short: 1 to 11 mm by the contact law, up to a fingertip at 8 N; -6 mm where only
# changes with force are known, as in the published sweeps.
_EXTENTS_MM = (-10.0, 15.0)
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
        """The estimate in words, as wide as the contact law leaves it."""
        if self.permittivity is None:
            return "the phases of different locations do not tell"
        length = (
            "a length that only untouched rows would tell"
            if self.length_mm is None
            else f"{self.length_mm:.0f} +- {_LENGTH_MM:g} mm (or {self.ambiguity_mm:.0f} mm more)"
        )
        low = max(self.permittivity / _PERMITTIVITY_RATIO, 1.0)
        high = self.permittivity * _PERMITTIVITY_RATIO
        return f"the data suggest {length} and a permittivity between {low:.2g} and {high:.2g}"


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
    values = [_port_concentrations(rows, port, slopes) for port in (1, 2)]
    return np.mean(values, axis=0) if np.all(values) else np.zeros(len(slopes))


def _port_concentrations(rows: CalibrationTable, port: int, slopes: np.ndarray) -> np.ndarray:
    """The same of one port; shape (n,)."""
    places, phasors = _mean_phasors(rows, port)
    if len(places) < 2:
        return np.zeros(len(slopes))
    turns = np.exp(1j * np.radians((slopes if port == 1 else -slopes)[:, None] * places))
    return np.asarray(np.abs(np.mean(phasors * turns, axis=1)))


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
    untouched = untouched_phases(rows)
    touched, _ = touched_rows(rows, untouched)
    scores = concentrations(touched, _SLOPES * slope)
    best = int(np.argmax(scores))
    places = np.unique(touched.location_mm)
    if scores[best] < ON_A_LINE or len(places) < ENOUGH_LOCATIONS:
        return LineEstimate(frequency_hz, None, None, ambiguity_mm)
    own_permittivity = float(permittivity * _SLOPES[best] ** 2)
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


# Phases in radians lie within a turn, 6.28; those of a press and of the untouched line in degrees
# are further apart.
TURN_RAD = 2 * np.pi + 0.01
# No tactile sensor is pressed with as much; 8 N are 816 g.
_LARGEST_FORCE_N = 100.0
# A change is none if its standard deviation times this exceeds it.
_SIGNIFICANT = 3.0
# Presses within a tenth of the line are not a calibration, but one in other units. Phases that
# move by a tenth of what the line does from location to location are of no line.
_SMALLEST_SHARE = 0.1
# A direction is reversed if it leaves so much less scatter.
_REVERSED = 0.25
_DIRECTION_SLOPES = np.linspace(0.9, 1.4, 101)
# Readings of which so many are unexplained are suspicious, and explained if so few are.
_MOST, _FEW, _ROWS_TRIED = 0.5, 0.1, 200
_UNEXPLAINED = {"inconsistent", "extrapolated"}


def suspicions(table: CalibrationTable, length_mm: float, permittivity: float) -> list[str]:
    """Likely mistakes in the units, ports and signs of a table, or in the line that is assumed.

    Returns list of str: a sentence each; empty when nothing is suspicious.
    """
    touched = table.take(~table.untouched)
    if not touched.row.size:
        return []
    found = _units(table, touched, length_mm)
    if found:
        return found
    for frequency in carriers_of(table):
        own = table.take(same_carrier(table.frequency_hz, frequency))
        if own.untouched.all():
            continue
        rows, _ = touched_rows(own, untouched_phases(own))
        slope = line.round_trip_deg_per_mm(frequency, permittivity)
        found += _explained(rows, slope) or _unconnected(rows, slope) or _unpressed(rows, slope)
    if found:
        return list(dict.fromkeys(found))
    for estimate in estimate_line(table, length_mm, permittivity):
        rows = table.take(same_carrier(table.frequency_hz, estimate.frequency_hz))
        found += _other_line(estimate, length_mm, permittivity) or _other_untouched(
            rows, estimate, length_mm, permittivity
        )
    return found


def untouched_assumed(table: CalibrationTable, model: SensorModel) -> list[str]:
    """What follows where a table has no untouched rows, for each such carrier.

    Returns list of str: a sentence each, with the change of readings per degree of error.

    ``model``: of this table.
    """
    found = []
    for frequency in carriers_of(table):
        if untouched_phases(table.take(same_carrier(table.frequency_hz, frequency))) is not None:
            continue
        force, location = shift_per_degree(model, frequency)
        found.append(
            f"no rows of the untouched sensor (force_n 0, no location) at {frequency / 1e6:g} MHz: "
            f"its phases are taken to be those of a line of {model.length_mm:g} mm, and each "
            f"degree that one of them is off shifts forces by some {force:.2g} N and locations by "
            f"some {location:.2g} mm"
        )
    return found


def stated_suspicions(found: Sequence[str]) -> dict[str, list[str]]:
    """What the provenance of a model says of likely mistakes in its data.

    Returns dict: empty where there are none.

    ``found``: as :func:`suspicions` gives them.
    """
    return {"suspicions": list(dict.fromkeys(found))} if found else {}


def _units(table: CalibrationTable, touched: CalibrationTable, length_mm: float) -> list[str]:
    found = []
    widest = float(np.max(np.abs(table.phase_deg)))
    if widest <= TURN_RAD:
        found.append(
            f"all phases lie within +-{widest:.1f}: are they in radians instead of degrees?"
        )
    found += location_suspicions(float(np.max(touched.location_mm)), length_mm)
    hardest = float(np.max(touched.force_n))
    if hardest > _LARGEST_FORCE_N:
        found.append(f"forces reach {hardest:g} N: are they in grams (1 N is 102 g)?")
    return found


def _explained(rows: CalibrationTable, slope: float) -> list[str]:
    """The mistake of ports, signs, locations or units without which all phases follow a line.

    Returns list of str: a sentence; none where the phases follow a line as they are, or where two
    mistakes explain them alike, such as swapped ports at either of two locations.
    """
    if len(np.unique(rows.location_mm)) < ENOUGH_LOCATIONS:
        return []
    given = 1 - float(concentrations(rows, slope * _SLOPES).max())
    if given <= 1 - ON_A_LINE:
        return []
    found = [(given, 0.0, "")] * 2
    found += [
        (_scatter(changed, slope * _DIRECTION_SLOPES), share, text)
        for text, share, changed in _without_mistakes(rows)
    ]
    (best, share, text), (other, *_) = sorted(found)[:2]
    on_a_line = share == 1 or best <= 1 - ON_A_LINE
    return [text] if on_a_line and best <= share * other else []


def _scatter(rows: CalibrationTable, slopes: np.ndarray) -> float:
    """1 less the concentration about the best of some lines, of slopes (n,) in deg/mm.

    A port at which force moves the short inward follows none.
    """
    total = np.zeros(len(slopes))
    for port in (1, 2):
        own = rows.take(rows.port == port)
        moves = [_line_over_force(own, place) for place in np.unique(own.location_mm)]
        change, std = np.reshape(moves, (-1, 2)).T
        if change.sum() >= -_SIGNIFICANT * np.linalg.norm(std):
            total += _port_concentrations(own, port, slopes) / 2
    return float(1 - total.max())


def _without_mistakes(rows: CalibrationTable) -> Iterator[tuple[str, float, CalibrationTable]]:
    """For each mistake: a sentence, the share of the scatter that may be left, and the rows."""
    for ports in ((1,), (2,), (1, 2)):
        chosen = np.isin(rows.port, ports)
        turned = replace(rows, location_mm=np.where(chosen, -rows.location_mm, rows.location_mm))
        inverted = replace(rows, phase_deg=np.where(chosen, -rows.phase_deg, rows.phase_deg))
        if len(ports) == 1:
            alone = f"the phase of port {ports[0]} alone moves with location in the wrong direction"
            end = "are its locations measured from the other end than those of the other port?"
            yield f"{alone}: {end}", _REVERSED, turned
            yield f"{alone}: is its sign inverted?", _REVERSED, inverted
        else:
            yield (
                "the phase of port 1 rises with location and that of port 2 falls: are the ports "
                "swapped, or is location measured from port 2?",
                _REVERSED,
                turned,
            )
            yield (
                "phases move with location and with force in the wrong direction: is their sign "
                "inverted (they must be those of arg S11 and arg S22)?",
                _REVERSED,
                inverted,
            )
    for place in np.unique(rows.location_mm):
        here = rows.location_mm == place
        yield (
            f"the phases at location {place:g} mm would fit the others with the ports swapped: "
            "are they swapped there, or is location measured from port 2?",
            _REVERSED,
            replace(rows, port=np.where(here, 3 - rows.port, rows.port)),
        )
        widest = float(np.max(np.abs(rows.phase_deg[here])))
        if widest <= TURN_RAD:
            # In degrees, those of presses are hardly ever all so small.
            yield (
                f"all phases at location {place:g} mm lie within +-{widest:.1f}: are they in "
                "radians there instead of degrees?",
                1.0,
                replace(rows, phase_deg=np.where(here, np.degrees(rows.phase_deg), rows.phase_deg)),
            )


def _unconnected(rows: CalibrationTable, slope: float) -> list[str]:
    """Ports whose phases are alike at all locations and forces, as without a sensor."""
    dead = []
    for port in (1, 2):
        own = rows.take(rows.port == port)
        places = np.unique(own.location_mm)
        if len(places) < 2:
            continue
        mean = np.degrees(np.angle(np.mean(np.exp(1j * np.radians(own.phase_deg)))))
        about = wrap_deg(own.phase_deg - mean)
        means = [np.mean(about[own.location_mm == place]) for place in places]
        lines = np.array([_line_over_force(own, place) for place in places])
        moves = np.any(np.abs(lines[:, 0]) > _SIGNIFICANT * lines[:, 1])
        if np.ptp(means) <= _SMALLEST_SHARE * slope * np.ptp(places) and not moves:
            dead.append(f"{port} ({mean:.0f} deg)")
    return dead and [
        f"the phase of port {' and of port '.join(dead)} is the same at all locations and "
        "forces: is the sensor connected?"
    ]


def _unpressed(rows: CalibrationTable, slope: float) -> list[str]:
    """Whether no force changes the phases, everywhere or at some locations.

    A line without a soft beam is shorted alike by all forces, but its phases follow location.
    """
    places = np.unique(rows.location_mm)
    moved = np.array([_movement(rows, place) for place in places])
    known = np.isfinite(moved[:, 1])
    places, moved = places[known], moved[known]
    if not len(moved):
        return []
    change, std = np.abs(moved[:, 0].mean()), np.sqrt(np.sum(moved[:, 1] ** 2)) / len(moved)
    if change <= _SIGNIFICANT * std:
        if float(concentrations(rows, slope * _SLOPES).max()) >= ON_A_LINE:
            return []
        return [
            f"phases do not change with force (by {change:.2g} deg, uncertain by {std:.2g} deg): "
            "was the sensor pressed while they were measured?"
        ]
    # Both ends together move alike at all locations (line.py).
    most = np.abs(moved[:, 0]) + _SIGNIFICANT * moved[:, 1]
    return [
        f"phases do not change with force at location {place:g} mm (by {own[0]:.2g} deg, elsewhere "
        f"by {np.median(moved[:, 0]):.2g} deg): was the sensor pressed while they were measured?"
        for place, own, limit in zip(places, moved, most, strict=True)
        if limit < 0.5 * np.abs(np.median(moved[:, 0]))
    ]


def _movement(rows: CalibrationTable, place: float) -> tuple[float, float]:
    """Change of both ports' phases over the forces of a location, and its standard deviation."""
    found = [
        _line_over_force(own, place)
        for own in (rows.take(rows.port == port) for port in (1, 2))
        if np.any(own.location_mm == place)
    ]
    change, std = np.array(found).T
    return float(change.sum()), float(np.sqrt(np.sum(std**2)))


def _line_over_force(own: CalibrationTable, place: float) -> tuple[float, float]:
    """Change of the phase of one port and location over its forces, in deg, and its deviation.

    Both are of a straight line; what lies beside it, such as an onset, widens the deviation, which
    is infinite where too few forces state it.
    """
    here = own.take(own.location_mm == place)
    order = np.argsort(here.force_n, kind="stable")
    centred = here.force_n[order] - here.force_n.mean()
    phase = np.unwrap(here.phase_deg[order], period=360.0)
    spread, span = float(centred @ centred), float(np.ptp(centred))
    if not spread:
        return 0.0, np.inf
    slope = float(centred @ phase) / spread
    if len(order) < 3:
        return slope * span, np.inf
    residual = phase - phase.mean() - slope * centred
    variance = float(residual @ residual) / (len(order) - 2)
    return slope * span, span * float(np.sqrt(variance / spread))


def location_suspicions(farthest_mm: float, length_mm: float) -> list[str]:
    """The unit that locations may have been given in instead of millimetres.

    Returns list of str: one sentence, or none.

    ``farthest_mm``: location that is farthest from port 1, as given.
    """
    if not 0 < farthest_mm <= _SMALLEST_SHARE * length_mm:
        return []
    unit = "metres" if farthest_mm < 1 else "centimetres"
    return [
        f"all locations lie within {farthest_mm:g} mm of port 1: are they in {unit} instead of "
        "millimetres?"
    ]


def _other_line(estimate: LineEstimate, length_mm: float, permittivity: float) -> list[str]:
    at = f"{estimate.frequency_hz / 1e6:g} MHz: "
    if estimate.permittivity is None:
        return []
    ratio = np.sqrt(estimate.permittivity / permittivity)
    if not _SLOPE_LIMITS[0] <= ratio <= _SLOPE_LIMITS[1]:
        return [
            f"{at}phases change with location as on a line of permittivity "
            f"{estimate.permittivity:.2g}, not {permittivity:g}: check --permittivity, and that "
            "locations are in mm"
        ]
    if estimate.length_mm is not None and abs(estimate.length_mm - length_mm) > _LENGTH_MM:
        return [
            f"{at}touched and untouched phases are those of a line of about "
            f"{estimate.length_mm:.0f} mm, not {length_mm:g} mm: were cables, reference planes and "
            "the open far end (50 ohm reflects nothing) the same for all rows, does the ruler "
            "begin at port 1, and is --length-mm right?"
        ]
    return []


def _other_untouched(
    rows: CalibrationTable, estimate: LineEstimate, length_mm: float, permittivity: float
) -> list[str]:
    """Whether untouched phases are off by as much at both ports, which the length does not show.

    ``rows``: of one carrier.
    """
    untouched = untouched_phases(rows)
    if untouched is None or estimate.length_mm is None:
        return []
    touched, _ = touched_rows(rows, untouched)
    slope = line.round_trip_deg_per_mm(estimate.frequency_hz, permittivity)
    phasors = []
    for port, start_deg in zip((1, 2), untouched, strict=True):
        places, means = _mean_phasors(touched, port)
        # D = 180 deg + 2 beta (L - l + a1), and 180 deg + 2 beta (l + a2) at port 2.
        open_mm = length_mm - places if port == 1 else places
        phasors.append(means * np.exp(-1j * np.radians(start_deg + 180.0 + slope * open_mm)))
    extent_deg = float(np.degrees(np.angle(np.mean(np.concatenate(phasors)))))
    low, high = _EXTENTS_MM
    if low <= extent_deg / slope <= high:
        return []
    return [
        f"{estimate.frequency_hz / 1e6:g} MHz: untouched phases are off by some "
        f"{-extent_deg:+.0f} deg at both ports: was the far end open while untouched (not shorted, "
        "nor 50 ohm), with the cables of the presses?"
    ]


def phase_suspicions(
    model: SensorModel,
    phases_deg: np.ndarray,
    std_deg: float,
    location_mm: np.ndarray | None = None,
    frequency_hz: float | None = None,
) -> list[str]:
    """Likely mistakes in the units, ports and signs of phases that a model does not explain.

    Returns list of str: a sentence each, if most readings are inconsistent with the model, or if
    they are small and would be consistent in radians. A mistake is named if nearly all would be
    consistent without it.

    ``phases_deg`` (n, 2); ``location_mm`` (n,): known locations, NaN where unknown;
    ``frequency_hz``: carrier; the model's only one by default.
    """
    known = np.full(len(phases_deg), np.nan) if location_mm is None else np.asarray(location_mm)
    rows = np.linspace(0, len(phases_deg) - 1, min(len(phases_deg), _ROWS_TRIED)).astype(int)
    phases, known = np.asarray(phases_deg, float)[rows], known[rows]
    found = []
    if np.isfinite(known).any() and (farthest := float(np.nanmax(known))) > 0:
        found += location_suspicions(farthest, model.length_mm)

    def share(changed: np.ndarray) -> float:
        return _unexplained(model, changed, std_deg, known, frequency_hz)

    if found:
        return found
    # Phases in degrees are hardly ever all so small; a press may explain those of a row or two.
    if np.max(np.abs(phases)) <= TURN_RAD and share(np.degrees(phases)) <= _FEW:
        return ["the phases would fit the sensor in radians: are they not in degrees?"]
    if share(phases) <= _MOST:
        return []
    for changed, text in (
        (phases[:, ::-1], "with the ports swapped the phases would fit the sensor"),
        (-phases, "with the opposite sign the phases would fit the sensor (arg S11, arg S22)"),
    ):
        if share(changed) <= _FEW:
            found.append(f"{text}; now most of them do not")
    if not found and (~model.is_untouched(phases, std_deg, frequency_hz)).any():
        found = ["most phases do not fit the sensor: are they of another line or carrier?"]
    return found


def _unexplained(
    model: SensorModel,
    phases: np.ndarray,
    std_deg: float,
    known: np.ndarray,
    frequency_hz: float | None,
) -> float:
    """Share of touched readings that the model does not explain; 1 where none is touched."""
    touched = ~model.is_untouched(phases, std_deg, frequency_hz)
    bad = []
    for given in (True, False):
        chosen = touched & (np.isfinite(known) == given)
        if chosen.any():
            places = known[chosen] if given else None
            result = model.invert(phases[chosen], std_deg, places, frequency_hz)
            bad += [bool(_UNEXPLAINED & set(flags)) for flags in result.flags]
    return float(np.mean(bad)) if bad else 1.0
