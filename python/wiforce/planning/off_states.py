# SPDX-License-Identifier: GPL-3.0-or-later
"""What reflective off states of a tag's switches buy and cost.

Both ends show D_i = (G_i - G_off,i) / rho, times a rotation and a gain that they share. Four
numbers that are received determine force, location, rotation and gain, unless the off states are
alike and the press lies at mid-line.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..scene.schema import vna_std

if TYPE_CHECKING:
    from ..estimation.groups import Array
    from .plan import Plan, PlannedSensor

# Forces, and locations, of the calibrated span at which pairs are compared.
_PRESSES = 5
# Angles of off states to choose from, and how much better a pair must be to be named.
_ANGLES, _BETTER = 24, 0.9


@dataclass(frozen=True)
class OffStates:
    """Off states of a sensor, and a better pair of the same size, if there is one.

    ``free_std_n`` is the least standard deviation of the force where nothing is known of the common
    phase, ``force_std_n`` where it is known: geometric means over the calibrated span, by the noise
    of the phases and by what is unknown of the off states (``off_std``, of the real and the
    imaginary part of each). ``known_to`` is the ``off_std`` that equals the noise.
    """

    sensor: str
    off_reflection: tuple[complex, complex]
    off_std: float
    force_std_n: float
    free_std_n: float
    known_to: float
    better: tuple[complex, complex] | None
    better_std_n: float | None

    def report(self) -> dict[str, object]:
        """The same for JSON: pairs [re, im]."""

        def parts(off: tuple[complex, complex]) -> list[list[float]]:
            return [[each.real, each.imag] for each in off]

        better = None if self.better is None else parts(self.better)
        return vars(self) | {"off_reflection": parts(self.off_reflection), "better": better}

    def __str__(self) -> str:
        """One line for a terminal."""
        line = (
            f"{self.sensor}: {_stated(self.off_reflection)}, known to {self.off_std:.2g}: "
            f"over the calibrated span force is read to {self.free_std_n:.2g} N while the tag "
            f"turns, to {self.force_std_n:.2g} N while it stands still; errors of "
            f"{self.known_to:.2g} would equal the noise"
        )
        if self.better is None:
            return line
        return f"{line}; {_pair(self.better)} would read it to {self.better_std_n:.2g} N"


def off_states(plan: Plan, phase_std_deg: Sequence[Sequence[float]]) -> Iterator[OffStates]:
    """Judge the off states of every sensor whose switches reflect.

    ``phase_std_deg`` (S, 2): noise of the phases of all sensors.
    """
    for sensor, noise in zip(plan.sensors, np.radians(phase_std_deg), strict=True):
        off = np.asarray(sensor.off_reflection, complex)
        if not off.any():
            continue
        spans = sensor.model.force_span_n, sensor.model.location_span_mm
        grid = np.meshgrid(*(np.linspace(low, high, _PRESSES) for low, high in spans))
        line = PressedLine(sensor, plan.center_frequency_hz, np.stack(grid, axis=-1).reshape(-1, 2))
        # What is stated of equal ones says nothing of a pair that differs.
        off_std = sensor.off_reflection_std if off[0] != off[1] else vna_std(off)
        free_std_n = line.force_std_n(off, noise, off_std)
        circle = np.abs(off).max() * np.exp(2j * np.pi * np.arange(_ANGLES) / _ANGLES)
        pairs = np.stack(np.meshgrid(circle, circle), axis=-1).reshape(-1, 2)
        stds_n = line.force_std_n(pairs, noise, off_std)
        best = int(np.argmin(stds_n))
        is_better = stds_n[best] < _BETTER * free_std_n
        squares = (line.stds(off, *of)[:, 0] ** 2 for of in ((noise, 0.0), (0 * noise, 1.0)))
        by_noise, by_errors = (np.median(each) for each in squares)
        yield OffStates(
            sensor.name,
            (complex(off[0]), complex(off[1])),
            off_std,
            float(line.force_std_n(off, noise, off_std, turns=False)),
            float(free_std_n),
            float(np.sqrt(by_noise / by_errors)),
            (complex(pairs[best, 0]), complex(pairs[best, 1])) if is_better else None,
            float(stds_n[best]) if is_better else None,
        )


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
        self._prior = 12 / np.ptp(model.force_span_n) ** 2  # uniform over the span

    def error(self, off: Array) -> Array:
        """By how much D is wrong for unit errors of off states (..., 2); (..., n, 2).

        R is D over that of the untouched sensor, which the reader takes from its off state as well.
        """
        off = off[..., None, :]
        return np.abs(1 - (self._reflection - off) / (self._untouched - off))

    def stds(self, off: Array, noise: Array, off_std: float, turns: bool = True) -> Array:
        """Standard deviations of force, location and, if the tag turns, its rotation and gain.

        For off states (..., 2) and noise of the phases (..., 2) in rad; shape (..., n, 4 or 2),
        infinite where they are not determined.
        """
        switched = self._reflection - off[..., None, :]
        noise = np.hypot(noise, off_std * self.error(off))
        press = np.broadcast_to(
            1j * self._reflection[..., None] * self._slopes, (*switched.shape, 2)
        )
        common = [1j * switched[..., None], switched[..., None]] if turns else []
        columns = np.concatenate([press, *common], axis=-1) / noise[..., None]
        jacobian = np.concatenate([columns.real, columns.imag], axis=-2)
        scale = np.linalg.norm(jacobian, axis=-2)
        _, singular, rows = np.linalg.svd(jacobian / scale[..., None, :], full_matrices=False)
        with np.errstate(divide="ignore"):
            return np.linalg.norm(rows / singular[..., None], axis=-2) / scale

    def force_std_n(self, off: Array, noise: Array, off_std: float, turns: bool = True) -> Array:
        """Geometric mean over the presses of that of the force; shape (...)."""
        stds = self.stds(off, noise, off_std, turns)[..., 0]
        return np.exp(np.mean(np.log(1 / (1 / stds**2 + self._prior)), axis=-1) / 2)


def _stated(off: tuple[complex, complex]) -> str:
    """The same, and what one pair of the scene stands for."""
    if off[0] != off[1]:
        return f"off states {_pair(off)}"
    both = f"{off[0].real:+.2f}{off[0].imag:+.2f}j"
    return f"both off states {both} (one pair is [re, im]; [[re, im], [re, im]] states two)"


def _pair(off: tuple[complex, complex]) -> str:
    """Both as complex numbers."""
    return " and ".join(f"{each.real:+.2f}{each.imag:+.2f}j" for each in off)
