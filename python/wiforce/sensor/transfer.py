# SPDX-License-Identifier: GPL-3.0-or-later
"""A sensor model at a carrier near the one that it was calibrated at.

The press touches the line at the same millimetres at every carrier, and the phases that a line
adds are proportional to frequency. What is not the line, its connectors above all, follows no such
rule. A connector of reflection coefficient rho in front of a strong reflection of phase psi adds
2 rho sin(psi - phi) to it, with an unknown phi (D. M. Pozar, *Microwave Engineering*, 4th ed.,
section 2.3: a load behind a lossless mismatch, to first order in rho). At the calibrated carrier
this ripple is part of the calibration. At another one psi - phi has turned by
``delta = 2 pi (f' - f) tau``, where tau is the round trip to the far end of the line, and the
ripple has changed by ``2 rho sqrt(1 - cos(delta))`` (rms over phi). A reading compares two states,
touched and untouched, whose ripples change independently.
"""

import numpy as np

from ..signal.carrier import SPEED_OF_LIGHT_M_S

# VSWR 1.15 at each end, what makers of SMA connectors on flexible cable allow near 1 GHz.
CONNECTOR_REFLECTION = 0.07
# Length of connector and switch in front of the line, as a length of line in air.
CONNECTOR_MM = 30.0


def transfer_std_deg(
    length_mm: float, permittivity: float, from_hz: float, frequency_hz: float
) -> float:
    """Standard deviation of each phase that a transfer between carriers adds, in degrees.

    ``permittivity`` is the effective relative one of the line; 0 at the carrier of the calibration.
    """
    way_mm = length_mm * np.sqrt(permittivity) + CONNECTOR_MM
    delay_s = 2e-3 * way_mm / SPEED_OF_LIGHT_M_S
    turn = 2 * np.pi * abs(frequency_hz - from_hz) * delay_s
    one_state = 2 * CONNECTOR_REFLECTION * np.sqrt(1 - np.cos(turn))
    return float(np.degrees(np.sqrt(2) * one_state))


def transfer_assumption(from_hz: float, frequency_hz: float) -> str:
    """What a transferred model assumes, as its provenance states it."""
    return (
        f"phases at {frequency_hz / 1e6:g} MHz are those at {from_hz / 1e6:g} MHz times "
        f"{frequency_hz / from_hz:.6g}: the contact touches the line at the same millimetres"
    )
