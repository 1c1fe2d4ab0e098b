# SPDX-License-Identifier: GPL-3.0-or-later
"""Presses of a simulated scene: force over time, and what the line shows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..signal.carrier import SPEED_OF_LIGHT_M_S

if TYPE_CHECKING:
    from ..scene.effects import Beam, PressForce
    from ..scene.simulated import Move, Press
    from ..sensor import SensorModel


# Physiological tremor of a hand lies between 8 and 12 Hz.
TREMOR_HZ = (8.3, 9.7, 11.4)


def press_force(press: "PressForce", time_s: np.ndarray) -> np.ndarray:
    """Force in N of a press at times (n,) within it, with the tremor of a hand that holds it."""
    force = np.interp(time_s, *_profile(press))
    if press.tremor_n:
        cycles = np.outer(TREMOR_HZ, time_s - press.start_s)
        tremor = np.sin(2 * np.pi * cycles).sum(axis=0) * np.sqrt(2 / len(TREMOR_HZ))
        share = force / max(press.force_n, press.end_force_n)
        force = np.maximum(force + press.tremor_n * share * tremor, 0.0)
    return force


def shown_force(press: "PressForce", time_s: np.ndarray, beam: "Beam") -> np.ndarray:
    """Force in N that an elastic beam would need for the same contact, at times within a press.

    After the largest force P so far, the contact shows F + 4 h F (P - F) / P: it opens later than
    it closed, most at half of P, by h P. Creep adds c times the force, low-pass filtered with the
    stated time constant (a standard linear solid). The filter starts at zero with each press.
    """
    force = press_force(press, time_s)
    times, forces = _profile(press)
    reached = np.where(time_s >= times[1], forces[1], 0.0)
    reached = np.maximum(reached, np.where(time_s >= times[2], forces[2], 0.0))
    peak = np.maximum(np.maximum(force, reached), 1e-9)
    shown = force + 4 * beam.hysteresis * force * (peak - force) / peak
    if beam.creep:
        shown += beam.creep * _low_pass(times, forces, beam.creep_s, time_s)
    return shown


def _profile(press: "PressForce") -> tuple[np.ndarray, list[float]]:
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


class PressedSensor:
    """One sensor of a scene, pressed and moved as the scene states or as set while running.

    Refuses a carrier that the model does not hold; elastic without a ``beam``.
    """

    def __init__(
        self,
        model: "SensorModel",
        presses: Sequence["Press"],
        moves: Sequence["Move"],
        center_frequency_hz: float,
        beam: "Beam | None" = None,
    ) -> None:
        self._model, self._beam = model, beam
        self._presses = sorted(presses, key=lambda press: press.start_s)
        self._starts = np.array([press.start_s for press in self._presses])
        self._moves = moves
        self._carrier_hz = center_frequency_hz
        self._held: tuple[float, float] | None = None
        # Force and location of the latest steady state, and its reflections.
        self._last: tuple[tuple[float, float], np.ndarray] | None = None
        model.phases_deg(0.0, 0.0, center_frequency_hz)  # refuses a carrier that it does not hold

    @property
    def length_mm(self) -> float:
        """Length of its line."""
        return self._model.length_mm

    @property
    def presses(self) -> "list[Press]":
        """The presses, in the order of their starts."""
        return self._presses

    def hold(self, force_n: float | None, location_mm: float | None) -> None:
        """Press with a constant force from now on; None returns to what the scene states."""
        self._held = None
        if force_n is not None and location_mm is not None:
            self._held = float(force_n), float(location_mm)

    def force(self, time_s: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Force and location over time, (n,) each; location is NaN where nothing presses."""
        return self._over_time(np.asarray(time_s, float), press_force)

    def state(self, time_s: ArrayLike) -> TouchState:
        """State over time."""
        force, location = self.force(time_s)
        shown = self._shown(time_s)[0]
        touch = shown >= self._model.onset_force_n
        return TouchState(touch, force, location, self._phases_deg(shown, location))

    def reflections(self, time_s: np.ndarray) -> np.ndarray:
        """G_1 / rho and G_2 / rho over time, (n, 2), or (1, 2) when nothing changes."""
        force, location = self._shown(time_s)
        steady = (force == force[0]).all() and (
            np.isnan(location) | (location == location[0])
        ).all()
        if not steady:
            return np.exp(1j * np.deg2rad(self._phases_deg(force, location)))
        key = (force[0], 0.0 if force[0] == 0 else location[0])
        if self._last is None or self._last[0] != key:
            row = np.exp(1j * np.deg2rad(self._phases_deg(force[:1], location[:1])))
            self._last = key, row
        return self._last[1]

    def mean_phases_deg(self, time_s: ArrayLike, period_s: float) -> np.ndarray:
        """Phases (n, 2) of the mean reflection over ``period_s`` about each time."""
        inside = ((np.arange(_MEAN_POINTS) + 0.5) / _MEAN_POINTS - 0.5) * period_s
        times = np.add.outer(np.asarray(time_s, float), inside)
        reflections = np.broadcast_to(self.reflections(times.ravel()), (times.size, 2))
        mean = reflections.reshape(*times.shape, 2).mean(axis=1)
        return np.degrees(np.angle(mean))

    def through(self, time_s: ArrayLike) -> np.ndarray:
        """Reflection (n,) with both switches on, minus the sum of the two ends alone.

        A press shorts the line, so that the ends are independent. Untouched, both waves run through
        to the other end, once, instead of to its open end and back: 2 exp(j psi/2) replaces G_1 +
        G_2. Its sign, which psi/2 leaves open, is that of a line half a wavelength longer or not.
        """
        untouched = self._model.phases_deg(0.0, 0.0, self._carrier_hz)
        passing = 2 * np.exp(1j * np.deg2rad(untouched.sum() / 4))
        alone = np.exp(1j * np.deg2rad(untouched)).sum()
        touch = self._shown(time_s)[0] >= self._model.onset_force_n
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

    def _shown(self, time_s: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """The force that an elastic beam would need for the same contact, and the location."""
        beam = self._beam
        if beam is None:
            return self.force(time_s)
        return self._over_time(
            np.asarray(time_s, float), lambda press, times: shown_force(press, times, beam)
        )

    def _over_time(
        self, time_s: np.ndarray, force_of: Callable[["Press", np.ndarray], np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        if self._held is not None:
            return np.full(time_s.shape, self._held[0]), np.full(time_s.shape, self._held[1])
        force, location = np.zeros(time_s.shape), np.full(time_s.shape, np.nan)
        if not len(self._presses) or not time_s.size:
            return force, location
        first = max(np.searchsorted(self._starts, time_s.min(), "right") - 1, 0)
        for press in self._presses[first : np.searchsorted(self._starts, time_s.max(), "right")]:
            during = (time_s >= press.start_s) & (time_s < press.end_s)
            location[during] = press.location_mm
            force[during] = force_of(press, time_s[during])
        return force, location

    def _phases_deg(self, force: np.ndarray, location: np.ndarray) -> np.ndarray:
        return self._model.phases_deg(
            force, np.where(np.isnan(location), 0.0, location), self._carrier_hz
        )


def _progress(move: "Move", time_s: np.ndarray) -> np.ndarray:
    """Part of a move that is done, 0..1; shape (n,)."""
    if move.duration_s == 0:
        return (time_s >= move.start_s).astype(float)
    return np.clip((time_s - move.start_s) / move.duration_s, 0, 1)
