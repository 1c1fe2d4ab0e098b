# SPDX-License-Identifier: GPL-3.0-or-later
"""A tag: its clock, its switches, and the sensor whose ends they connect."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .presses import PressedSensor
from .streams import Ramp
from .switching import SWITCHES, SwitchingClock, switch_states

if TYPE_CHECKING:
    from ..scene import Scene
    from ..scene.schema import SceneSensor
    from ..scene.simulated import Tag


class SwitchedTag:
    """Reflection of a tag, sample by sample, while its clock runs and its sensor is pressed.

    Parameters
    ----------
    scene : Scene
    sensor : SceneSensor
    tag : Tag
    rng : numpy.random.Generator
        For the clock's start and the path's phase.
    ramp : Ramp
        Knots at which reflections are computed.

    Attributes
    ----------
    name : str
        Of the sensor.
    clock : SwitchingClock
    pressed : PressedSensor
    on : bool
        False removes the tag.

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> scene = load_scene("demo")
    >>> ramp = Ramp(scene.radio.sample_rate_hz)
    >>> rng = np.random.default_rng(1)
    >>> tag = SwitchedTag(scene, scene.sensors[0], scene.simulation.tags[0], rng, ramp)
    >>> reflection = tag.reflection(0, 250_000)  # 20 ms of its clock
    >>> round(float(np.mean(np.abs(reflection))), 2)  # on for a quarter of the time at either end
    0.5
    """

    def __init__(
        self,
        scene: "Scene",
        sensor: "SceneSensor",
        tag: "Tag",
        rng: np.random.Generator,
        ramp: Ramp,
    ) -> None:
        self.name, self.on = sensor.name, True
        self._rate, self._ramp = scene.radio.sample_rate_hz, ramp
        simulation = scene.simulation
        last_ppm = tag.clock_offset_ppm + tag.clock_drift_ppm_per_s * simulation.duration_s
        phase = rng.random()
        if tag.clock_phase_deg is not None:
            phase = tag.clock_phase_deg / 360
        self.clock = SwitchingClock(
            sensor.clock_hz,
            tag.clock_offset_ppm,
            tag.clock_drift_ppm_per_s,
            max(sensor.clock_tolerance_ppm, abs(tag.clock_offset_ppm), abs(last_ppm)),
            phase,
        )
        self._switches, self._delay_s = SWITCHES[tag.clock2_duty], tag.clock2_delay_s
        self._off = np.array(sensor.off_reflection)
        self._rotation = np.exp(2j * np.pi * rng.random())
        self.pressed = PressedSensor(
            scene.load_model(tag.truth_model),
            [press for press in simulation.presses if press.sensor == sensor.name],
            [move for move in simulation.moves if move.sensor == sensor.name],
            scene.radio.center_frequency_hz,
        )

    def reflection(self, first: int, count: int) -> np.ndarray:
        """Reflection during some samples.

        Parameters
        ----------
        first, count : int
            First sample and their number.

        Returns
        -------
        ndarray of complex64, shape (count,)
            r / rho.
        """
        if not self.on:
            return np.zeros(count, np.complex64)
        first_on, second_on = switch_states(
            self.clock, self._switches, self._delay_s, first, count, self._rate
        )
        both_on = first_on * second_on
        times = self._ramp.knots(first, count)
        ends = self.pressed.reflections(times)
        path = self._rotation * self.pressed.motion(times)
        # Relative to the off state, which is added for the whole time.
        states = [first_on, second_on]
        values = [ends[:, 0] - self._off[0], ends[:, 1] - self._off[1]]
        if both_on.any():
            states.append(both_on)
            values.append(self.pressed.through(times) + self._off.mean())
        if self._off.any():
            states.append(np.ones_like(first_on))
            values.append(self._off.mean())
        values = [np.atleast_1d(value * path).astype(np.complex64) for value in values]
        return self._sum(states, values, first, count)

    def _sum(
        self, states: Sequence[np.ndarray], values: Sequence[np.ndarray], first: int, count: int
    ) -> np.ndarray:
        """Sum of the states times their values: constants, or values at the knots."""
        if all(len(value) == 1 for value in values):
            parts = np.concatenate(values).view(np.float32).reshape(-1, 2)
            return (np.stack(states).T @ parts).view(np.complex64).ravel()
        total = np.zeros(count, np.complex64)
        for state, value in zip(states, values, strict=True):
            constant = len(value) == 1
            total += state * (value if constant else self._ramp.interpolate(value, first, count))
        return total
