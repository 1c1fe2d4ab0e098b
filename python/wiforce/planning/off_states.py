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

from ..sensor import SensorModel

if TYPE_CHECKING:
    from ..estimation.groups import Array
    from .plan import Plan, PlannedSensor

# The press that is compared, and parts of the calibrated span where pairs are compared.
_FORCE_N, _PARTS_OF_SPAN = 4.0, (0.25, 0.5, 0.75)
# Angles of off states to choose from, and how much better a pair must be to be named.
_ANGLES, _BETTER = 24, 0.9
# Condition beyond which a parameter is determined by the model's rounding alone.
_SINGULAR = 1e8


@dataclass(frozen=True)
class OffStates:
    """Off states of a sensor at a press, and a better pair of the same size, if there is one.

    ``free_std_n`` is the least standard deviation of the force where nothing is known of the common
    phase, infinite where it cannot be read; ``force_std_n`` where it is known. ``known_to`` is the
    error of the real and the imaginary part of each that adds as much as ``free_std_n``.
    """

    sensor: str
    off_reflection: tuple[complex, complex]
    force_n: float
    location_mm: float
    force_std_n: float
    free_std_n: float
    known_to: float
    noise: tuple[float, float]  # of the phases by arg R, in units of that without reflection
    better: tuple[complex, complex] | None
    better_std_n: float

    def report(self) -> dict[str, object]:
        """The same for JSON: pairs [re, im], None for what cannot be read."""

        def parts(off: tuple[complex, complex]) -> list[list[float]]:
            return [[each.real, each.imag] for each in off]

        numbers = {
            name: value if np.isfinite(value) else None
            for name in ("force_std_n", "free_std_n", "known_to", "better_std_n")
            for value in [getattr(self, name)]
        }
        return {
            "sensor": self.sensor,
            "off_reflection": parts(self.off_reflection),
            "force_n": self.force_n,
            "location_mm": self.location_mm,
            "noise": list(self.noise),
            "better": None if self.better is None else parts(self.better),
            **numbers,
        }

    def __str__(self) -> str:
        """One line for a terminal."""
        noise = "/".join(f"{each:.2g}" for each in self.noise)
        first = f"{self.sensor}: off states {_pair(self.off_reflection)}"
        at = f"{self.force_n:g} N at {self.location_mm:g} mm"
        if np.isfinite(self.free_std_n):
            read = (
                f"while the tag turns, {at} is read to {self.free_std_n:.2g} N (standing still to "
                f"{self.force_std_n:.2g} N), if they are known to {self.known_to:.2g}"
            )
        else:
            read = f"a turn of the tag cannot be distinguished from force ({at})"
        line = f"{first}: {read}; noise of the phases times {noise}"
        if self.better is None:
            return line
        return f"{line}; {_pair(self.better)} would read it to {self.better_std_n:.2g} N"


def off_states(plan: Plan, phase_std_deg: Sequence[Sequence[float]]) -> Iterator[OffStates]:
    """Judge the off states of every sensor whose switches reflect.

    ``phase_std_deg`` (S, 2): noise of the phases of all sensors.
    """
    carrier_hz = plan.center_frequency_hz
    for sensor, noise in zip(plan.sensors, np.radians(phase_std_deg), strict=True):
        off = np.asarray(sensor.off_reflection, complex)
        if not off.any():
            continue
        low, high = sensor.model.location_span_mm
        force_n = float(np.clip(_FORCE_N, *sensor.model.force_span_n))
        locations_mm = low + np.array(_PARTS_OF_SPAN) * (high - low)
        slopes = [_slopes(sensor.model, force_n, mm, carrier_hz) for mm in locations_mm]
        untouched = np.exp(1j * np.radians(sensor.model.untouched_deg(carrier_hz)))
        reflection, slope = slopes[len(slopes) // 2]
        free_std_n, error_n = _free(reflection, slope, untouched, off, noise)
        if free_std_n > sensor.model.force_span_n[1]:
            free_std_n = np.inf  # nothing is read by it
        known = _jacobian(reflection, slope, off, noise)[:, :2]
        switched = reflection - off
        growth = np.abs(switched) / (switched * reflection.conj()).real
        better, better_std_n = _best(slopes, untouched, off, noise)
        yield OffStates(
            sensor.name,
            (complex(off[0]), complex(off[1])),
            force_n,
            float(locations_mm[len(locations_mm) // 2]),
            float(_stds(known)[0]),
            free_std_n,
            free_std_n / error_n if np.isfinite(free_std_n) else np.inf,
            (float(growth[0]), float(growth[1])),
            better,
            better_std_n,
        )


def _slopes(
    model: SensorModel, force_n: float, location_mm: float, carrier_hz: float
) -> tuple[Array, Array]:
    """G / rho of both ends, and the slopes of psi with force and location, rad; (2,) and (2, 2)."""
    forward = model.inverter(carrier_hz).forward
    psi = np.radians(np.ravel(model.phases_deg(force_n, location_mm, carrier_hz)))
    slopes = forward.slopes(*forward.clip(np.array([force_n]), np.array([location_mm])))[0]
    return np.exp(1j * psi), np.radians(slopes)


def _jacobian(reflection: Array, slope: Array, off: Array, noise: Array) -> Array:
    """Of both D in units of their noise; force, location, rotation, gain; shape (4, 4)."""
    switched = reflection - off
    press = (1j * reflection)[:, None] * slope
    columns = np.column_stack([press, 1j * switched, switched]) / noise[:, None]
    return np.concatenate([columns.real, columns.imag])


def _stds(jacobian: Array) -> Array:
    """Standard deviations of the parameters; infinite where they are not determined."""
    squares: Array = jacobian.T @ jacobian
    scale: Array = np.sqrt(np.diag(squares))
    normal: Array = squares / np.outer(scale, scale)
    if np.linalg.cond(normal) > _SINGULAR:
        return np.full(len(scale), np.inf)
    stds: Array = np.sqrt(np.diag(np.linalg.inv(normal))) / scale
    return stds


def _free(
    reflection: Array, slope: Array, untouched: Array, off: Array, noise: Array
) -> tuple[float, float]:
    """Standard deviation of the force without the common phase, and its error in N by unit errors
    of real and imaginary part of each off state.
    """
    stds, errors = _without_common(reflection, slope, untouched, off, noise)
    return float(stds[0]), float(errors[0])


def _without_common(
    reflection: Array, slope: Array, untouched: Array, off: Array, noise: Array
) -> tuple[Array, Array]:
    """The same of force, location, rotation and gain; infinite where they are not determined."""
    jacobian = _jacobian(reflection, slope, off, noise)
    stds = _stds(jacobian)
    if not np.isfinite(stds).all():
        return stds, stds
    # R is D over that of the untouched sensor, which the reader takes from its off state as well.
    wrong = np.diag((reflection - off) * (1 / (untouched - off) - 1 / (reflection - off)))
    wrong = np.column_stack([wrong, 1j * wrong]) / noise[:, None]
    moved = np.linalg.lstsq(jacobian, np.concatenate([wrong.real, wrong.imag]), rcond=None)[0]
    return stds, np.linalg.norm(moved, axis=1)


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
    untouched = np.exp(1j * np.radians(sensor.model.untouched_deg(carrier_hz)))
    found = []
    for force_n, location_mm in presses:
        reflection, slope = _slopes(sensor.model, force_n, location_mm, carrier_hz)
        stds, errors = _without_common(reflection, slope, untouched, off, np.radians(phase_std_deg))
        found.append(np.degrees(np.hypot(stds[2], sensor.off_reflection_std * errors[2])))
    return np.array(found)


def _best(
    slopes: list[tuple[Array, Array]], untouched: Array, off: Array, noise: Array
) -> tuple[tuple[complex, complex] | None, float]:
    """The pair of this size that reads best over the line, if it is better than ``off``."""

    def worth(pair: Array) -> float:
        stds = [_stds(_jacobian(g, slope, pair, noise))[0] for g, slope in slopes]
        return float(np.mean(np.log(stds)))

    circle = np.abs(off).max() * np.exp(2j * np.pi * np.arange(_ANGLES) / _ANGLES)
    pairs = [np.array([first, second]) for first in circle for second in circle]
    best = min(pairs, key=worth)
    if not worth(best) < worth(off) + np.log(_BETTER):
        return None, np.inf
    std, _ = _free(*slopes[len(slopes) // 2], untouched, best, noise)
    return (complex(best[0]), complex(best[1])), std


def _pair(off: tuple[complex, complex]) -> str:
    """Both as complex numbers."""
    return " and ".join(f"{each.real:+.2f}{each.imag:+.2f}j" for each in off)
