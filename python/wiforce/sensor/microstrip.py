# SPDX-License-Identifier: GPL-3.0-or-later
"""Dimensions of a line to build, and the timer of its tag: impedance, match, phase, clock."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..signal.carrier import SPEED_OF_LIGHT_M_S, VACUUM_PERMITTIVITY_F_M
from .line import round_trip_deg_per_mm

# Terms of the charge on each strip: this many, and as many again for each height that it is wide,
# leave 1e-6 of the impedance. A ground that is wider than this many heights acts as an infinite one
# within 0.1 %.
_TERMS, _WIDEST_HEIGHTS = 16, 40.0
PORT_OHM = 50.0  # impedance of the ports at both ends of a line
# Heights among which a matched one is looked for, in widths of the trace.
_HEIGHTS = (0.02, 5.0)
# The tag's firmware (examples/tag_firmware): slots per period, the crystal's frequency, steps that
# its 8-bit timer counts, how the prescaler's bits divide the crystal, and the least cycles of a
# slot, three times those of its interrupt.
SLOTS, CRYSTAL_HZ = 16, 4e6
_MOST_STEPS, _DIVISORS, _LEAST_CYCLES = 256, {1: 1, 2: 8, 3: 64}, 64


def effective_permittivity(width_to_height: ArrayLike, permittivity: float) -> np.ndarray:
    """Effective permittivity of a microstrip line over a gap of some permittivity, within 0.2 %.

    E. Hammerstad and O. Jensen, IEEE MTT-S 1980, 407-409, equations 3 to 5.
    """
    u = np.asarray(width_to_height, float)
    a = 1 + np.log((u**4 + (u / 52) ** 2) / (u**4 + 0.432)) / 49 + np.log1p((u / 18.1) ** 3) / 18.7
    b = 0.564 * ((permittivity - 0.9) / (permittivity + 3)) ** 0.053
    found = (permittivity + 1) / 2 + (permittivity - 1) / 2 * (1 + 10 / u) ** (-a * b)
    return np.asarray(found)


def strips_impedance_ohm(width_mm: float, ground_mm: float, height_mm: float) -> float:
    """Characteristic impedance of two parallel strips in air, one of them the ground.

    The charge is a sum of T_n(x/a) over sqrt(1 - (x/a)^2). Potentials are -ln(a/2) T_0 and T_n/n on
    the own strip (J. C. Mason and D. C. Handscomb, *Chebyshev Polynomials*, 2003, 9.5.2), and by
    Gauss-Chebyshev quadrature on the other.
    """
    ground_mm = min(ground_mm, width_mm + _WIDEST_HEIGHTS * height_mm)
    count = _TERMS + int(np.ceil(max(width_mm, ground_mm) / height_mm))
    order = np.arange(count)
    node = (order + 0.5) * np.pi / count
    x, terms = np.cos(node), np.cos(np.outer(node, order))
    half = np.array([width_mm, ground_mm]) / 2
    blocks = []
    for own in (0, 1):
        factor = 1 / np.maximum(order, 1.0)
        factor[0] = -np.log(half[own] / 2)
        distance = np.hypot(np.subtract.outer(half[own] * x, half[1 - own] * x), height_mm)
        pair = [np.pi * terms * factor, -(np.pi / count) * np.log(distance) @ terms]
        blocks.append(np.hstack(pair if own == 0 else pair[::-1]))
    potential = np.repeat(np.eye(2), count, axis=0)
    charge = np.linalg.solve(np.vstack(blocks), potential)[::count]
    # Of the matrix of capacitances, what remains when both strips have opposite charges.
    capacitance = np.linalg.det(charge) / charge.sum() * 2 * np.pi**2 * VACUUM_PERMITTIVITY_F_M
    return float(1 / (SPEED_OF_LIGHT_M_S * capacitance))


@dataclass(frozen=True)
class Microstrip:
    """A trace over a ground, the paper's by default; ``permittivity`` is that of the gap."""

    width_mm: float = 2.5
    height_mm: float = 0.63
    ground_mm: float = 6.0
    length_mm: float = 80.0
    permittivity: float = 1.0

    @property
    def effective_permittivity(self) -> float:
        """Of the wave on the line; that of a wide ground."""
        return float(effective_permittivity(self.width_mm / self.height_mm, self.permittivity))

    @property
    def impedance_ohm(self) -> float:
        """Characteristic impedance, with the ground as wide as it is."""
        air = strips_impedance_ohm(self.width_mm, self.ground_mm, self.height_mm)
        return air / float(np.sqrt(self.effective_permittivity))

    def phase_deg_per_mm(self, frequency_hz: float) -> float:
        """By how much a short that moves by 1 mm changes the phase of S11, in degrees."""
        return float(round_trip_deg_per_mm(frequency_hz, self.effective_permittivity))

    def reflection_db(self, frequency_hz: ArrayLike) -> np.ndarray:
        """S11 = r (1 - t^2) / (1 - r^2 t^2) in dB of the untouched line between ports of 50 ohm.

        r = (Z - Z_0) / (Z + Z_0), t = exp(-j beta L) (Pozar, *Microwave Engineering*, 4.3).
        """
        r = (self.impedance_ohm - PORT_OHM) / (self.impedance_ohm + PORT_OHM)
        index = np.sqrt(self.effective_permittivity)
        turn = 4e-3 * np.pi * np.asarray(frequency_hz, float) * index * self.length_mm
        through = np.exp(-1j * turn / SPEED_OF_LIGHT_M_S)
        found = np.abs(r * (1 - through) / (1 - r**2 * through))
        return np.asarray(20 * np.log10(np.maximum(found, 1e-12)))

    def matched(self, port_ohm: float = PORT_OHM) -> "Microstrip":
        """The line at the height, of 0.02 to 5 widths, at which it has the ports' impedance."""
        from scipy.optimize import brentq  # slow to import, and needed here only

        def missing(height_mm: float) -> float:
            return replace(self, height_mm=height_mm).impedance_ohm - port_ohm

        low, high = (share * self.width_mm for share in _HEIGHTS)
        if not missing(low) < 0 < missing(high):
            rule = f"is reached at no height of {low:g} to {high:g} mm"
            raise InputError("impedance", rule, port_ohm)
        return replace(self, height_mm=float(brentq(missing, low, high)))


@dataclass(frozen=True)
class TagTimer:
    """Settings of the tag's firmware (``SLOT``, ``PRESCALER``), and the clock that they give."""

    steps: int
    prescaler: int
    clock_hz: float


def tag_timer(clock_hz: float, crystal_hz: float = CRYSTAL_HZ) -> TagTimer:
    """Settings of the tag's firmware nearest to a clock; refused beyond 1 % of it."""
    found = []
    for prescaler, divisor in _DIVISORS.items():
        unit_hz = crystal_hz / divisor / SLOTS
        least = -(-_LEAST_CYCLES // divisor)
        steps = int(np.clip(round(unit_hz / clock_hz), least, _MOST_STEPS))
        found.append(TagTimer(steps, prescaler, unit_hz / steps))
    best = min(found, key=lambda each: abs(each.clock_hz - clock_hz))
    if abs(best.clock_hz - clock_hz) > 0.01 * clock_hz:
        rule = (
            f"is not within reach of the firmware's timer, whose nearest clock is "
            f"{best.clock_hz:.6g} Hz"
        )
        raise InputError("clock_hz", rule, clock_hz)
    return best
