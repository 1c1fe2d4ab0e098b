# SPDX-License-Identifier: GPL-3.0-or-later
"""A tag on the air: its clock, its switches, the sensor that they show."""

import numpy as np

from .presses import PressedSensor
from .switching import SWITCHES, SwitchingClock, switch_states


class SwitchedTag:
    """What a tag reflects, sample by sample, while its clock runs and its sensor is pressed.

    Parameters
    ----------
    scene : Scene
    sensor : SceneSensor
    tag : Tag
    rng : numpy.random.Generator
        Of the clock's start and the path's phase.
    ramp : Ramp

    Attributes
    ----------
    name : str
    clock : SwitchingClock
    pressed : PressedSensor
    on : bool
        False takes the tag off the air.
    """

    def __init__(self, scene, sensor, tag, rng, ramp):
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
        self._turn = np.exp(2j * np.pi * rng.random())
        self.pressed = PressedSensor(
            scene.load_model(tag.truth_model),
            [press for press in simulation.presses if press.sensor == sensor.name],
            [move for move in simulation.moves if move.sensor == sensor.name],
            scene.radio.center_frequency_hz,
        )

    def reflection(self, first, count):
        """r / rho of the samples; complex64, shape (count,)."""
        if not self.on:
            return np.zeros(count, np.complex64)
        first_on, second_on = switch_states(
            self.clock, self._switches, self._delay_s, first, count, self._rate
        )
        both_on = first_on * second_on
        times = self._ramp.knots(first, count)
        ends = self.pressed.reflections(times)
        path = self._turn * self.pressed.motion(times)
        # Against the off state, which is taken with the rest of the time.
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

    def _sum(self, states, values, first, count):
        """Sum of the states times their values: constants, or values at the knots."""
        if all(len(value) == 1 for value in values):
            parts = np.concatenate(values).view(np.float32).reshape(-1, 2)
            return (np.stack(states).T @ parts).view(np.complex64).ravel()
        total = np.zeros(count, np.complex64)
        for state, value in zip(states, values, strict=True):
            total += state * (value if len(value) == 1 else self._ramp.draw(value, first, count))
        return total
