# SPDX-License-Identifier: GPL-3.0-or-later
"""The line's cross-section: its impedance in air, and how well it is matched from end to end.

The sensor is a trace of 2.5 mm over a ground trace of 6 mm, 0.63 mm apart, air between, 80 mm long.
"""

import numpy as np
from gnuradio.wiforce.signal.carrier import SPEED_OF_LIGHT_M_S
from scipy.optimize import brentq

TRACE_MM, GROUND_MM, HEIGHT_MM, LENGTH_MM = 2.5, 6.0, 0.63, 80.0
_WAVE_IMPEDANCE_OHM = 376.730


def microstrip_impedance_ohm(width_to_height):
    """Characteristic impedance of a trace over a wide ground in air.

    E. O. Hammerstad's equations, as in D. M. Pozar, *Microwave Engineering*, section 3.8: within 1
    %.
    """
    u = np.asarray(width_to_height, float)
    wide = _WAVE_IMPEDANCE_OHM / (u + 1.393 + 0.667 * np.log(u + 1.444))
    return np.where(u < 1, narrow_strip_impedance_ohm(u), wide)


def narrow_strip_impedance_ohm(width_to_height):
    """Hammerstad's equation for a trace no wider than high, ``60 ln(8 h/w + w/(4 h))`` in air.

    The sensor's trace is four to five times as wide as high: there it is off by a quarter.
    """
    u = np.asarray(width_to_height, float)
    return _WAVE_IMPEDANCE_OHM / (2 * np.pi) * np.log(8 / u + u / 4)


def strip_pair_impedance_ohm(width_to_height):
    """The same where the ground is as narrow as the trace: two strips, mirrored at mid-height."""
    return 2 * microstrip_impedance_ohm(2 * np.asarray(width_to_height, float))


def matched_ratio(impedance, port_ohm=50.0):
    """Width to height at which ``impedance``, one of the functions above, is that of the port."""
    return float(brentq(lambda u: float(impedance(u)) - port_ohm, 0.2, 50.0))


def reflection_db(
    frequency_hz,
    width_to_height,
    length_mm=LENGTH_MM,
    impedance=microstrip_impedance_ohm,
    port_ohm=50.0,
):
    """S11 in dB of the untouched line between two ports, by scikit-rf's media.

    Returns ndarray, shape (n,). ``frequency_hz`` (n,); ``impedance``: of width to height, ohm.
    """
    import skrf

    frequency = skrf.Frequency.from_f(np.atleast_1d(frequency_hz), unit="Hz")
    gamma = 2j * np.pi * frequency.f / SPEED_OF_LIGHT_M_S
    own = np.full(frequency.npoints, float(impedance(width_to_height)))
    media = skrf.media.DefinedGammaZ0(frequency, z0_port=port_ohm, z0=own, gamma=gamma)
    line = media.line(length_mm * 1e-3, unit="m")
    return 20 * np.log10(np.maximum(np.abs(line.s[:, 0, 0]), 1e-12))
