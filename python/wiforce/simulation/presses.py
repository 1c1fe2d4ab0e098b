# SPDX-License-Identifier: GPL-3.0-or-later
"""Presses of a simulated scene on sensors and on the skin above them, and what the lines show."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..scene import Scene
from ..scene.effects import Beam
from ..scene.simulated import Move, Press, PressForce
from ..scene.surface import bare_skin
from ..signal.carrier import SPEED_OF_LIGHT_M_S
from ..surface.skin import Skin

# Physiological tremor of a hand lies between 8 and 12 Hz.
TREMOR_HZ = (8.3, 9.7, 11.4)


def press_force(press: PressForce, time_s: np.ndarray) -> np.ndarray:
    """Force in N of a press at times (n,) within it, with the tremor of a hand that holds it."""
    force = np.interp(time_s, *_profile(press))
    if press.tremor_n:
        cycles = np.outer(TREMOR_HZ, time_s - press.start_s)
        tremor = np.sin(2 * np.pi * cycles).sum(axis=0) * np.sqrt(2 / len(TREMOR_HZ))
        share = force / max(press.force_n, press.end_force_n)
        force = np.maximum(force + press.tremor_n * share * tremor, 0.0)
    return force


def shown_force(press: PressForce, time_s: np.ndarray, beam: Beam | None) -> np.ndarray:
    """Force in N that an elastic beam would need for the same contact, at times within a press.

    F + 4 h F (P - F) / P after the largest force P, and creep: c times the force through a filter
    of first order that starts at zero (a standard linear solid). Without ``beam``, F itself.
    """
    force = press_force(press, time_s)
    if beam is None:
        return force
    times, forces = _profile(press)
    reached = np.where(time_s >= times[1], forces[1], 0.0)
    reached = np.maximum(reached, np.where(time_s >= times[2], forces[2], 0.0))
    peak = np.maximum(np.maximum(force, reached), 1e-9)
    shown = force + 4 * beam.hysteresis * force * (peak - force) / peak
    if beam.creep:
        shown += beam.creep * _low_pass(times, forces, beam.creep_s, time_s)
    return shown


def _profile(press: PressForce) -> tuple[np.ndarray, list[float]]:
    """Times and forces between which a press is linear."""
    times = press.start_s + np.cumsum([0, press.rise_s, press.hold_s, press.rise_s])
    return times, [0.0, press.force_n, press.end_force_n, 0.0]


def _low_pass(
    knots: np.ndarray, values: list[float], constant_s: float, time_s: np.ndarray
) -> np.ndarray:
    """A piecewise linear signal through a filter of first order that starts at 0."""
    result, state = np.zeros(time_s.shape), 0.0
    for i in range(len(knots) - 1):
        length = knots[i + 1] - knots[i]
        if length == 0:
            continue
        slope = (values[i + 1] - values[i]) / length
        after = np.append(np.clip(time_s - knots[i], 0, length), length)
        lagging = slope * constant_s
        filtered = values[i] + slope * after - lagging
        filtered += (state - values[i] + lagging) * np.exp(-after / constant_s)
        result = np.where(time_s >= knots[i], filtered[:-1], result)
        state = float(filtered[-1])
    return result


# Points over which a mean within a phase group is taken.
_MEAN_POINTS = 32


@dataclass(frozen=True)
class TouchState:
    """State of a sensor at n times."""

    touch: np.ndarray  # (n,), whether the line is shorted
    force_n: np.ndarray  # (n,), applied, whatever the beam makes of it
    location_mm: np.ndarray  # (n,), NaN where nothing presses
    phases_deg: np.ndarray  # (n, 2), psi_1, psi_2 in (-180, 180]


# Force and location of a contact over time, (n,) each; location is NaN where nothing presses.
Contact = tuple[np.ndarray, np.ndarray]


class PressedSensor:
    """One sensor, pressed and moved as its scene states or as set.

    Under presses at once, as a skin gives to a strip, each end shows the nearest contact.
    """

    def __init__(self, scene: Scene, index: int) -> None:
        simulation, name = scene.simulation, scene.sensors[index].name
        tag = simulation.tags[index]
        self._beam, self._model = tag.beam, scene.load_model(tag.truth_model)
        self._carrier_hz = scene.radio.center_frequency_hz
        self._moves = [move for move in simulation.moves if move.sensor == name]
        presses = [press for press in simulation.presses if press.sensor == name]
        skin = bare_skin(scene)
        if skin is not None and index in skin.indices:
            presses += strip_presses(scene, skin, skin.indices.index(index))
        self._presses = sorted(presses, key=lambda press: press.start_s)
        self._layers = _layers(self._presses)
        self._held: tuple[float, float] | None = None
        self._steady = lru_cache(4)(self._reflections)

    @property
    def length_mm(self) -> float:
        """Length of its line."""
        return self._model.length_mm

    def hold(self, force_n: float, location_mm: float) -> None:
        """Press with a constant force from now on, instead of what the scene states."""
        self._held = float(force_n), float(location_mm)

    def state(self, time_s: ArrayLike) -> TouchState:
        """State over time."""
        time_s = np.asarray(time_s, float)
        force, location = _joined(self._contacts(time_s))
        touch = self._touching(self._contacts(time_s, self._beam)).any(axis=0)
        reflections = np.broadcast_to(self.reflections(time_s), (len(force), 2))
        return TouchState(touch, force, location, np.degrees(np.angle(reflections)))

    def reflections(self, time_s: np.ndarray) -> np.ndarray:
        """G_1 / rho and G_2 / rho over time, (n, 2), or (1, 2) when nothing changes."""
        contacts = self._contacts(time_s, self._beam)
        touching = self._touching(contacts)
        used = np.flatnonzero(touching.any(axis=1)).tolist() or [0]
        parts = [self._alone(*contacts[i]) for i in used]
        if len(used) == 1:
            return parts[0]
        places = np.stack([contacts[i][1] for i in used])
        near = np.where(touching[used], places, np.inf).argmin(axis=0)
        far = np.where(touching[used], places, -np.inf).argmax(axis=0)
        every = np.stack([np.broadcast_to(part, (len(time_s), 2)) for part in parts])
        at = np.arange(len(time_s))
        return np.stack([every[near, at, 0], every[far, at, 1]], axis=1)

    def mean_phases_deg(self, time_s: ArrayLike, period_s: float) -> np.ndarray:
        """Phases (n, 2) of the mean reflection over ``period_s`` about each time."""
        inside = ((np.arange(_MEAN_POINTS) + 0.5) / _MEAN_POINTS - 0.5) * period_s
        times = np.add.outer(np.asarray(time_s, float), inside)
        reflections = np.broadcast_to(self.reflections(times.ravel()), (times.size, 2))
        mean = reflections.reshape(*times.shape, 2).mean(axis=1)
        return np.degrees(np.angle(mean))

    def through(self, time_s: ArrayLike) -> np.ndarray:
        """Reflection (n,) with both switches on, minus the sum of the two ends alone.

        A press makes the ends independent. Untouched, waves run through once: 2 exp(j psi/2)
        replaces G_1 + G_2, the sign being that of a line half a wavelength longer or not.
        """
        untouched = self._model.phases_deg(0.0, 0.0, self._carrier_hz)
        passing = 2 * np.exp(1j * np.deg2rad(untouched.sum() / 4))
        alone = np.exp(1j * np.deg2rad(untouched)).sum()
        touch = self._touching(self._contacts(time_s, self._beam)).any(axis=0)
        return np.where(touch, 0.0, passing - alone)

    def near(self, time_s: np.ndarray, reach_s: float) -> np.ndarray:
        """How near the hand is: 1 while it presses, 0 without; it comes and goes in ``reach_s``."""
        if self._held is not None:
            return np.full(time_s.shape, float(self._held[0] > 0))
        nearest = np.zeros(time_s.shape)
        for press in self._presses:
            away_s = np.maximum(press.start_s - time_s, time_s - press.end_s)
            done = np.clip(1 - away_s / reach_s, 0, 1)
            nearest = np.maximum(nearest, (1 - np.cos(np.pi * done)) / 2)
        return nearest

    def motion(self, time_s: ArrayLike) -> np.ndarray | float:
        """Rotation of the tag's path by its moves, exp(-j 4 pi d / lambda); 1.0 without."""
        if not self._moves:
            return 1.0
        distance = sum(
            move.distance_mm * 1e-3 * _progress(move, np.asarray(time_s, float))
            for move in self._moves
        )
        return np.exp(-4j * np.pi * distance * self._carrier_hz / SPEED_OF_LIGHT_M_S)

    def _contacts(self, time_s: ArrayLike, beam: Beam | None = None) -> list[Contact]:
        """Force and location (n,) of the presses of each layer; or of what is held.

        With a ``beam``, the force that an elastic one would need for the same contact.
        """
        time_s = np.asarray(time_s, float)
        if self._held is not None:
            return [(np.full(time_s.shape, self._held[0]), np.full(time_s.shape, self._held[1]))]
        found = []
        for layer in self._layers:
            force, location = np.zeros(time_s.shape), np.full(time_s.shape, np.nan)
            starts = [press.start_s for press in layer]
            span = (time_s.min(), time_s.max()) if time_s.size else (0.0, 0.0)
            first, last = np.searchsorted(starts, span, "right").tolist()
            for press in layer[max(first - 1, 0) : last]:
                during = (time_s >= press.start_s) & (time_s < press.end_s)
                location[during] = press.location_mm
                force[during] = shown_force(press, time_s[during], beam)
            found.append((force, location))
        return found

    def _touching(self, contacts: list[Contact]) -> np.ndarray:
        """Whether each contact shorts the line; shape (layers, n)."""
        return np.array([force >= self._model.onset_force_n for force, _ in contacts])

    def _alone(self, force: np.ndarray, location: np.ndarray) -> np.ndarray:
        """Reflections (n, 2) of one contact, (1, 2) where it is steady."""
        location = np.where(force > 0, location, 0.0)  # anywhere where nothing presses
        if len(force) and (force == force[0]).all() and (location == location[0]).all():
            return self._steady(float(force[0]), float(location[0]))[None]
        return self._reflections(force, location)

    def _reflections(self, force: ArrayLike, location: ArrayLike) -> np.ndarray:
        return np.exp(1j * np.deg2rad(self._model.phases_deg(force, location, self._carrier_hz)))


def _joined(contacts: list[Contact]) -> Contact:
    """Sum of the forces of contacts, and their mean location."""
    if len(contacts) == 1:
        return contacts[0]
    forces = np.stack([force for force, _ in contacts])
    places = np.nan_to_num(np.stack([location for _, location in contacts]))
    total = forces.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return total, np.where(total > 0, (forces * places).sum(axis=0) / total, np.nan)


def _layers(presses: Sequence[Press]) -> list[list[Press]]:
    """Presses, which rise, in lists within which none overlap; at least one list."""
    layers: list[list[Press]] = [[]]
    for press in presses:
        free = [layer for layer in layers if not layer or layer[-1].end_s <= press.start_s]
        if not free:
            layers.append([])
        (free or layers[-1:])[0].append(press)
    return layers


def _progress(move: Move, time_s: np.ndarray) -> np.ndarray:
    """Part of a move that is done, 0..1; shape (n,)."""
    if move.duration_s == 0:
        return (time_s >= move.start_s).astype(float)
    return np.clip((time_s - move.start_s) / move.duration_s, 0, 1)


# A share below this is no contact: at 1000 N it is 0.1 N, far below the onset of any strip.
_LEAST_SHARE = 1e-4


def plate_share(distance_mm: ArrayLike, reach_mm: float, bearing_mm: float) -> np.ndarray:
    """Share of a press that a strip ``distance_mm`` across bears; 0 where the plate would lift.

    The pressure k/2 exp(-k|u|) (cos ku + sin k|u|), 1/k = ``reach_mm``, of a beam on an elastic
    foundation (M. Hetenyi, 1946), integrated over ``bearing_mm``.
    """
    distance = np.asarray(distance_mm, float)

    def up_to(u: np.ndarray) -> np.ndarray:
        v = np.abs(u) / reach_mm
        return np.sign(u) * (1 - np.exp(-v) * np.cos(v)) / 2

    share = up_to(distance + bearing_mm / 2) - up_to(distance - bearing_mm / 2)
    return np.maximum(share, 0.0)


def strip_presses(scene: Scene, skin: Skin, strip: int) -> list[Press]:
    """The presses on one strip that those on the surface cause; they may overlap."""
    plate, own = scene.simulation.plate, skin.strips[strip]
    bearing_mm = plate.bearing_mm or skin.spacing_mm
    found = []
    for press in scene.simulation.surface_presses:
        share = float(plate_share(press.y_mm - own.y_mm, plate.reach_mm, bearing_mm))
        if share < _LEAST_SHARE:
            continue
        found.append(
            Press(
                start_s=press.start_s,
                rise_s=press.rise_s,
                hold_s=press.hold_s,
                force_n=share * press.force_n,
                end_force_n=share * press.end_force_n,
                tremor_n=share * press.tremor_n,
                sensor=own.sensor,
                location_mm=float(own.location_of(press.x_mm)),
            )
        )
    return found


def surface_truth(scene: Scene, time_s: np.ndarray) -> list[list[dict[str, Any]]]:
    """Rows of truth of the surface at given times: presses that began first, by order of names."""
    names = () if scene.surface is None else scene.surface.names
    presses = sorted(scene.simulation.surface_presses, key=lambda press: press.start_s)
    found = []
    for time in np.asarray(time_s, float).tolist():
        now = [press for press in presses if press.start_s <= time < press.end_s]
        rows: list[dict[str, Any]] = [
            {"sensor": name, "touch": int(i < len(now))} for i, name in enumerate(names)
        ]
        for row, press in zip(rows, now, strict=False):
            force_n = float(press_force(press, np.array([time]))[0])
            row |= {"force_n": force_n, "location_mm": press.x_mm, "y_mm": press.y_mm}
        found.append(rows)
    return found
