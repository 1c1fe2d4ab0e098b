# SPDX-License-Identifier: GPL-3.0-or-later
"""What happens to a sensor over time: force, location, and the phases that its ends show."""

from dataclasses import dataclass

import numpy as np

from ..signal.carrier import SPEED_OF_LIGHT_M_S

# Physiological tremor of a hand lies between 8 and 12 Hz.
TREMOR_HZ = (8.3, 9.7, 11.4)
_TIMES_INSIDE = 32


@dataclass(frozen=True)
class TouchState:
    """A sensor at some times.

    Attributes
    ----------
    touch : ndarray of bool, shape (n,)
        Whether the line is shorted.
    force_n : ndarray, shape (n,)
    location_mm : ndarray, shape (n,)
        NaN where nothing presses.
    phases_deg : ndarray, shape (n, 2)
        psi_1, psi_2 in (-180, 180].
    """

    touch: np.ndarray
    force_n: np.ndarray
    location_mm: np.ndarray
    phases_deg: np.ndarray


class PressedSensor:
    """One sensor of a scene, pressed as the scene says or as it is told while running."""

    def __init__(self, model, presses, moves, center_frequency_hz):
        self._model = model
        self._presses = sorted(presses, key=lambda press: press.start_s)
        self._starts = np.array([press.start_s for press in self._presses])
        self._moves = moves
        self._carrier_hz = center_frequency_hz
        self._held = None
        self._last = None, None
        model.phases_deg(0.0, 0.0, center_frequency_hz)  # refuses a carrier it does not know

    def hold(self, force_n, location_mm):
        """Press with this force from now on, whatever the scene says; None lets the scene rule."""
        self._held = None if force_n is None else (float(force_n), float(location_mm))

    def force(self, time_s):
        """Force and location at the given times; location is NaN where nothing presses."""
        time_s = np.asarray(time_s, float)
        if self._held is not None:
            return tuple(np.full(time_s.shape, value) for value in self._held)
        force, location = np.zeros(time_s.shape), np.full(time_s.shape, np.nan)
        if not len(self._presses) or not time_s.size:
            return force, location
        first = max(np.searchsorted(self._starts, time_s.min(), "right") - 1, 0)
        for press in self._presses[first : np.searchsorted(self._starts, time_s.max(), "right")]:
            during = (time_s >= press.start_s) & (time_s < press.end_s)
            location[during] = press.location_mm
            force[during] = _force(press, time_s[during])
        return force, location

    def state(self, time_s):
        """The :class:`TouchState` at the given times (s), an array."""
        force, location = self.force(time_s)
        touch = force >= self._model.onset_force_n
        return TouchState(touch, force, location, self._phases_deg(force, location))

    def reflections(self, time_s):
        """G_1 / rho and G_2 / rho at the given times; complex, shape (n, 2).

        One row when nothing changes over these times.
        """
        force, location = self.force(time_s)
        steady = (force == force[0]).all() and (
            np.isnan(location) | (location == location[0])
        ).all()
        if not steady:
            return np.exp(1j * np.deg2rad(self._phases_deg(force, location)))
        key = (force[0], 0.0 if force[0] == 0 else location[0])
        last, row = self._last
        if last != key:
            row = np.exp(1j * np.deg2rad(self._phases_deg(force[:1], location[:1])))
            self._last = key, row
        return row

    def mean_phases_deg(self, time_s, period_s):
        """Phases of the mean reflection over ``period_s`` about each time; shape (n, 2)."""
        inside = ((np.arange(_TIMES_INSIDE) + 0.5) / _TIMES_INSIDE - 0.5) * period_s
        times = np.add.outer(np.asarray(time_s, float), inside)
        reflections = np.broadcast_to(self.reflections(times.ravel()), (times.size, 2))
        mean = reflections.reshape(*times.shape, 2).mean(axis=1)
        return np.degrees(np.angle(mean))

    def through(self, time_s):
        """By how much both switches on together differ from the sum of the two; complex, (n,).

        A press shorts the line, so that each end answers for itself. Untouched, both waves run
        through to the other end, once, instead of to its open end and back: 2 exp(j psi/2) takes
        the place of G_1 + G_2 (psi/2 leaves the sign open: a line half a wavelength longer).
        """
        untouched = self._model.phases_deg(0.0, 0.0, self._carrier_hz)
        passing = 2 * np.exp(1j * np.deg2rad(untouched.sum() / 4))
        alone = np.exp(1j * np.deg2rad(untouched)).sum()
        touch = self.force(time_s)[0] >= self._model.onset_force_n
        return np.where(touch, 0.0, passing - alone)

    def motion(self, time_s):
        """Turn of the tag's whole path by its moves, exp(-j 4 pi d / lambda); 1 when it rests."""
        if not self._moves:
            return 1.0
        distance = sum(
            move.distance_mm * 1e-3 * _progress(move, np.asarray(time_s, float))
            for move in self._moves
        )
        return np.exp(-4j * np.pi * distance * self._carrier_hz / SPEED_OF_LIGHT_M_S)

    def _phases_deg(self, force, location):
        return self._model.phases_deg(
            force, np.where(np.isnan(location), 0.0, location), self._carrier_hz
        )


def _profile(press):
    """Times and forces between which a press is linear."""
    times = press.start_s + np.cumsum([0, press.rise_s, press.hold_s, press.rise_s])
    return times, [0.0, press.force_n, press.end_force_n, 0.0]


def _force(press, time_s):
    """Force of a press at times within it, with the tremor of a hand that holds it."""
    force = np.interp(time_s, *_profile(press))
    if press.tremor_n:
        turns = np.outer(TREMOR_HZ, time_s - press.start_s)
        tremor = np.sin(2 * np.pi * turns).sum(axis=0) * np.sqrt(2 / len(TREMOR_HZ))
        share = force / max(press.force_n, press.end_force_n)
        force = np.maximum(force + press.tremor_n * share * tremor, 0.0)
    return force


def _progress(move, time_s):
    if move.duration_s == 0:
        return (time_s >= move.start_s).astype(float)
    return np.clip((time_s - move.start_s) / move.duration_s, 0, 1)
