# SPDX-License-Identifier: GPL-3.0-or-later
"""The physical line: where a press shorts it, and the phases seen from its two ends.

A press of force F at location l shorts the line from ``l - a_1`` to ``l + a_2``. The phase of the
reflection seen from end i follows from the distance ``d_i`` of the nearer edge of the short:
``psi_i = offset_i + 180 deg - 2 beta d_i``, with ``d_1 = l - a_1`` and ``d_2 = L - l - a_2``. The
untouched line ends in an open: ``psi_i = offset_i - 2 beta L``.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..io.text.schema import declared, key
from ..io.text.values import LARGEST, Number, Scope
from ..signal.carrier import SPEED_OF_LIGHT_M_S

# No sensor is beyond these, in N, mm and Hz: squares of their ratios are still numbers.
LEAST, LEAST_FREQUENCY_HZ = 1e-6, 1.0
MAX_LENGTH_MM = 10_000
MAX_FORCE_N = 1e6
MAX_PERMITTIVITY = 1000


def round_trip_deg_per_mm(frequency_hz: float, permittivity: float = 1.0) -> float:
    """2 beta: round-trip phase of a line in deg/mm, by its effective permittivity."""
    return 720.0 * frequency_hz * np.sqrt(permittivity) / (SPEED_OF_LIGHT_M_S * 1e3)


# Nodes of a profile, for 5e-8 mm.
_NODES = 100_001


@lru_cache(maxsize=8)
def _profile(half: float) -> tuple[np.ndarray, np.ndarray]:
    """u = kx, and the deflection of a beam on an elastic foundation there, over minus the largest.

    For a load spread evenly over -half..half: the profile of a point load averaged over it, rising
    from -1 at u = 0 to the first extreme.
    """
    # Squared spacing: the profile is flat under the load.
    u = (half + np.pi) * np.linspace(0.0, 1.0, _NODES) ** 2
    if not half:
        return u, -np.exp(-u) * (np.cos(u) + np.sin(u))

    def integral(v: np.ndarray | float) -> np.ndarray:  # of a point's profile from 0 to v; odd
        return np.sign(v) * (1 - np.exp(-np.abs(v)) * np.cos(v))

    spread = (integral(u - half) - integral(u + half)) / (2 * integral(half))
    return u, np.maximum.accumulate(spread)


def _check_width(width_mm: float, scope: Scope) -> str | None:
    inside = width_mm <= scope["length_mm"]
    return None if inside else f"must not be wider than length_mm, {scope['length_mm']:g}"


@declared
class ContactLaw:
    """A soft beam pressed onto the line.

    A beam on an elastic foundation (M. Hetenyi, *Beams on Elastic Foundation*, 1946) is deflected
    by ``exp(-kx) (cos kx + sin kx)`` under a point load, 1/k = ``decay_length_mm``, and touches
    where that exceeds the gap: ``exp(-ka) (cos ka + sin ka) = F_onset / F``. Its held ends tilt the
    short: ``a_1 = a (1 + t)``, ``a_2 = a (1 - t)``, ``t = asymmetry x / sqrt(x^2 + fade^2)``, ``x =
    L/2 - l``. A load over ``width_mm`` averages the profile over it.
    """

    decay_length_mm: float = key(
        Number(unit="mm", low=LEAST, high=LARGEST),
        doc="1/k of the beam on its elastic foundation.",
    )
    asymmetry: float = key(
        Number(low=0, high=0.99),
        doc="Tilt of the short towards the nearer end, far from the middle of the line.",
    )
    fade_mm: float = key(
        Number(unit="mm", low=LEAST, high=LARGEST),
        doc="Distance from the middle over which the tilt builds up.",
    )
    width_mm: float = key(
        Number(unit="mm", low=0, high=MAX_LENGTH_MM),
        default=0.0,
        check=_check_width,
        doc="Width of the object that presses, evenly loaded; 0 for a point.",
    )

    def shorting_points_mm(
        self, force_n: ArrayLike, location_mm: ArrayLike, length_mm: float, onset_force_n: float
    ) -> np.ndarray:
        """Distances d_1 and d_2, (..., 2), of each end from the nearer edge of the short.

        0 or more; those of the press itself up to the onset.
        """
        force, location = np.broadcast_arrays(
            np.asarray(force_n, float), np.asarray(location_mm, float)
        )
        ratio = onset_force_n / np.maximum(force, onset_force_n)
        u, profile = _profile(self.width_mm / 2 / self.decay_length_mm)
        half_width = self.decay_length_mm * np.interp(-ratio, profile, u)
        from_middle = length_mm / 2 - location
        tilt = self.asymmetry * from_middle / np.hypot(from_middle, self.fade_mm)
        widths = half_width[..., None] * np.stack([1 + tilt, 1 - tilt], axis=-1)
        return np.maximum(distances_mm(location, length_mm) - widths, 0.0)


def distances_mm(location_mm: ArrayLike, length_mm: float) -> np.ndarray:
    """Distances (..., 2) of a location from both ports of a line."""
    location = np.asarray(location_mm, float)
    return np.stack([location, length_mm - location], axis=-1)


def short_phase_deg(
    distance_mm: ArrayLike, frequency_hz: float, permittivity: float = 1.0
) -> np.ndarray:
    """psi of a short at the distance d from the port, 180 deg - 2 beta d, not wrapped."""
    return 180.0 - round_trip_deg_per_mm(frequency_hz, permittivity) * np.asarray(distance_mm)


def open_phase_deg(length_mm: float, frequency_hz: float, permittivity: float = 1.0) -> float:
    """psi of the untouched line of length L, -2 beta L, in degrees, not wrapped."""
    return -round_trip_deg_per_mm(frequency_hz, permittivity) * length_mm


# At a carrier near the one that a sensor was calibrated at, the press touches the line at the same
# millimetres at every carrier, and the phases that a line adds are proportional to frequency. What
# is not the line, its connectors above all, follows no such rule. A connector of reflection
# coefficient rho in front of a strong reflection of phase psi adds 2 rho sin(psi - phi) to it,
# with an unknown phi (D. M. Pozar, *Microwave Engineering*, 4th ed., section 2.3: a load behind a
# lossless mismatch, to first order in rho). At the calibrated carrier this ripple is part of the
# calibration. At another one psi - phi has turned by ``delta = 2 pi (f' - f) tau``, where tau is
# the round trip to the far end of the line, and the ripple has changed by ``2 rho sqrt(1 -
# cos(delta))`` (rms over phi). A reading compares two states, touched and untouched, whose ripples
# change independently.
#
# VSWR 1.15 at each end, what makers of SMA connectors on flexible cable allow near 1 GHz.
CONNECTOR_REFLECTION = 0.07
# Length of connector and switch in front of the line, as a length of line in air.
CONNECTOR_MM = 30.0


def transfer_std_deg(
    length_mm: float, permittivity: float, from_hz: float, frequency_hz: float
) -> float:
    """Standard deviation of each phase that a transfer between carriers adds, in degrees."""
    way_mm = length_mm * np.sqrt(permittivity) + CONNECTOR_MM
    delay_s = 2e-3 * way_mm / SPEED_OF_LIGHT_M_S
    turn = 2 * np.pi * abs(frequency_hz - from_hz) * delay_s
    one_state = 2 * CONNECTOR_REFLECTION * np.sqrt(1 - np.cos(turn))
    return float(np.degrees(np.sqrt(2) * one_state))
