# SPDX-License-Identifier: GPL-3.0-or-later
"""What reflective off states of a tag's switches show of a turn, and what their errors cost.

Both ends show D_i = (G_i - G_off,i) / rho, times a rotation and a gain that they share. Four
numbers that are received determine force, location, rotation and gain, unless the off states are
alike and the press lies at mid-line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..estimation.groups import Array
    from .plan import PlannedSensor


def turn_std_deg(
    sensor: PlannedSensor, carrier_hz: float, presses: Array, phase_std_deg: Array
) -> Array:
    """To what the amplitudes of both ends show how far the tag has turned, by its off states.

    Of presses (n, 2) in N and mm; infinite where they do not show it. The bound of an estimate
    beside force, location and gain, with what is unknown of the off states.
    """
    off = np.asarray(sensor.off_reflection, complex)
    if not off.any():
        return np.full(len(presses), np.inf)
    stds = PressedLine(sensor, carrier_hz, presses).stds(
        off, np.radians(phase_std_deg), sensor.off_reflection_std
    )
    return np.degrees(stds[:, 2])


def off_error_deg(sensor: PlannedSensor, carrier_hz: float, presses: Array) -> Array:
    """Standard deviation of both phases of presses (n, 2) by what is unknown of the off states."""
    line = PressedLine(sensor, carrier_hz, presses)
    return np.degrees(sensor.off_reflection_std * line.error(np.asarray(sensor.off_reflection)))


class PressedLine:
    """What both ends reflect at presses (n, 2): G / rho, and the slopes of psi, in rad."""

    def __init__(self, sensor: PlannedSensor, carrier_hz: float, presses: Array) -> None:
        model, forward = sensor.model, sensor.model.inverter(carrier_hz).forward
        self._untouched = np.exp(1j * np.radians(model.untouched_deg(carrier_hz)))
        self._reflection = np.exp(
            1j * np.radians(model.phases_deg(presses[:, 0], presses[:, 1], carrier_hz))
        )
        self._slopes = np.radians(forward.slopes(*forward.clip(*presses.T)))

    def error(self, off: Array) -> Array:
        """By how much D is wrong for unit errors of off states (..., 2); (..., n, 2).

        R is D over that of the untouched sensor, which the reader takes from its off state as well.
        """
        off = off[..., None, :]
        return np.abs(1 - (self._reflection - off) / (self._untouched - off))

    def stds(self, off: Array, noise: Array, off_std: float) -> Array:
        """Standard deviations of force, location, the tag's rotation and gain.

        For off states (..., 2) and noise of the phases (..., 2) in rad; shape (..., n, 4), infinite
        where they are not determined.
        """
        switched = self._reflection - off[..., None, :]
        noise = np.hypot(noise, off_std * self.error(off))
        press = np.broadcast_to(
            1j * self._reflection[..., None] * self._slopes, (*switched.shape, 2)
        )
        common = 1j * switched[..., None], switched[..., None]
        columns = np.concatenate([press, *common], axis=-1) / noise[..., None]
        jacobian = np.concatenate([columns.real, columns.imag], axis=-2)
        scale = np.linalg.norm(jacobian, axis=-2)
        _, singular, rows = np.linalg.svd(jacobian / scale[..., None, :], full_matrices=False)
        with np.errstate(divide="ignore"):
            return np.linalg.norm(rows / singular[..., None], axis=-2) / scale
