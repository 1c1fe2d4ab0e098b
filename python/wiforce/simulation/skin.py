# SPDX-License-Identifier: GPL-3.0-or-later
"""A skin over strips in a simulation: what each press on it does to each strip."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..scene.simulated import Press
from ..scene.surface import bare_skin
from .presses import PressedSensor, TouchState, press_force

if TYPE_CHECKING:
    from ..scene import Scene
    from ..surface.skin import Skin


# A share below this is no contact: at 1000 N it is 0.1 N, far below the onset of any strip.
_LEAST_SHARE = 1e-4


def plate_share(distance_mm: ArrayLike, reach_mm: float, bearing_mm: float) -> np.ndarray:
    """Share of a press that a strip under a plate bears; 0 where the plate would lift.

    ``distance_mm`` is across, from the press to the middle of the strip, 1/k = ``reach_mm`` that of
    the plate on its foundation, ``bearing_mm`` the width over which the strip bears it. The
    pressure under a point load, summed along the strip, is that of a beam on an elastic foundation,
    k/2 exp(-k|u|) (cos ku + sin k|u|) (M. Hetenyi, *Beams on Elastic Foundation*, 1946). It is
    integrated over the strip's width.
    """
    distance = np.asarray(distance_mm, float)

    def up_to(u: np.ndarray) -> np.ndarray:
        v = np.abs(u) / reach_mm
        return np.sign(u) * (1 - np.exp(-v) * np.cos(v)) / 2

    share = up_to(distance + bearing_mm / 2) - up_to(distance - bearing_mm / 2)
    return np.maximum(share, 0.0)


def strip_presses(scene: "Scene", skin: "Skin", strip: int) -> list[Press]:
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


def pressed_sensor(scene: "Scene", index: int, elastic: bool = False) -> PressedSensor:
    """One sensor of a scene, with what is pressed on it and on the surface above it.

    ``elastic`` leaves out the hysteresis and creep that the scene may state.
    """
    simulation, name = scene.simulation, scene.sensors[index].name
    tag = simulation.tags[index]
    moves = [move for move in simulation.moves if move.sensor == name]
    presses = [press for press in simulation.presses if press.sensor == name]
    model, beam = scene.load_model(tag.truth_model), None if elastic else tag.beam
    carrier_hz = scene.radio.center_frequency_hz

    def pressed(by: Sequence[Press]) -> PressedSensor:
        return PressedSensor(model, by, moves, carrier_hz, beam)

    skin = bare_skin(scene)
    if skin is None or index not in skin.indices:
        return pressed(presses)
    presses += strip_presses(scene, skin, skin.indices.index(index))
    layers = _layers(presses)
    return pressed(layers[0]) if len(layers) == 1 else PressedTwice(list(map(pressed, layers)))


def _layers(presses: Sequence[Press]) -> list[list[Press]]:
    """Presses in lists within which none overlap; at least one list."""
    layers: list[list[Press]] = [[]]
    for press in sorted(presses, key=lambda each: each.start_s):
        free = [layer for layer in layers if not layer or layer[-1].end_s <= press.start_s]
        if not free:
            layers.append([])
        (free or layers[-1:])[0].append(press)
    return layers


class PressedTwice(PressedSensor):
    """A strip that several presses touch at a time, each at its own place, in layers that do not
    overlap.

    Each end shows the contact that is nearest to it, since the line behind that is shorted.
    """

    def __init__(self, layers: list[PressedSensor]) -> None:
        first = layers[0]
        super().__init__(first._model, [], first._moves, first._carrier_hz, first._beam)
        self._layers = layers

    @property
    def presses(self) -> list[Press]:
        """The presses of all layers, in the order of their starts."""
        every = [press for layer in self._layers for press in layer.presses]
        return sorted(every, key=lambda press: press.start_s)

    def force(self, time_s: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Sum of the forces, and the location weighted by them."""
        if self._held is not None:
            return super().force(time_s)
        return _joined([layer.force(time_s) for layer in self._layers])

    def state(self, time_s: ArrayLike) -> TouchState:
        """State over time."""
        if self._held is not None:
            return super().state(time_s)
        force, location = self.force(time_s)
        touch = np.any([layer.state(time_s).touch for layer in self._layers], axis=0)
        reflections = np.broadcast_to(self.reflections(np.asarray(time_s, float)), (len(force), 2))
        return TouchState(touch, force, location, np.degrees(np.angle(reflections)))

    def reflections(self, time_s: np.ndarray) -> np.ndarray:
        """G_1 / rho and G_2 / rho over time."""
        if self._held is not None:
            return super().reflections(time_s)
        parts = [layer.reflections(time_s) for layer in self._layers]
        shown = [layer._shown(time_s) for layer in self._layers]
        touching = [force >= self._model.onset_force_n for force, _ in shown]
        used = [i for i, touch in enumerate(touching) if touch.any()]
        if len(used) < 2:
            return parts[used[0] if used else 0]
        where = np.stack([np.where(touching[i], shown[i][1], np.nan) for i in used])
        none = np.isnan(where).all(axis=0)
        near = np.where(none, 0, np.nan_to_num(where, nan=np.inf).argmin(axis=0))
        far = np.where(none, 0, np.nan_to_num(where, nan=-np.inf).argmax(axis=0))
        every = np.stack([np.broadcast_to(parts[i], (len(time_s), 2)) for i in used])
        at = np.arange(len(time_s))
        return np.stack([every[near, at, 0], every[far, at, 1]], axis=1)

    def near(self, time_s: np.ndarray, reach_s: float) -> np.ndarray:
        """How near a hand is."""
        if self._held is not None:
            return super().near(time_s, reach_s)
        return np.max([layer.near(time_s, reach_s) for layer in self._layers], axis=0)

    def through(self, time_s: ArrayLike) -> np.ndarray:
        """Reflection with both switches on, minus the sum of the two ends alone."""
        if self._held is not None:
            return super().through(time_s)
        found = np.stack([layer.through(time_s) for layer in self._layers])
        return np.where((found == 0).any(axis=0), 0.0, found[0])

    def _shown(self, time_s: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        if self._held is not None:
            return super()._shown(time_s)
        return _joined([layer._shown(time_s) for layer in self._layers])


def _joined(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Sum of the forces of contacts, and their mean location."""
    forces = np.stack([force for force, _ in parts])
    places = np.nan_to_num(np.stack([location for _, location in parts]))
    total = forces.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return total, np.where(total > 0, (forces * places).sum(axis=0) / total, np.nan)


def surface_truth(scene: "Scene", time_s: np.ndarray) -> list[list[dict[str, float | int | str]]]:
    """What is pressed on the surface at given times, as rows of a file of truth.

    For each time the presses that began first, in the order of their names.
    """
    surface = scene.surface
    names = () if surface is None else surface.names
    rows: list[list[dict[str, float | int | str]]] = []
    presses = sorted(scene.simulation.surface_presses, key=lambda press: press.start_s)
    for time in np.asarray(time_s, float).tolist():
        now = [press for press in presses if press.start_s <= time < press.end_s]
        found: list[dict[str, float | int | str]] = []
        for i, name in enumerate(names):
            row: dict[str, float | int | str] = {"sensor": name, "touch": int(i < len(now))}
            if i < len(now):
                force = float(press_force(now[i], np.array([time]))[0])
                row |= {"force_n": force, "location_mm": now[i].x_mm, "y_mm": now[i].y_mm}
            found.append(row)
        rows.append(found)
    return rows
