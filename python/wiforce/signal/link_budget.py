# SPDX-License-Identifier: GPL-3.0-or-later
"""Losses of a radio path: free space, and layers of tissue or other materials.

H. T. Friis, "A note on a simple transmission formula", Proc. IRE 34 (1946); D. M. Pozar, *Microwave
Engineering*, sections 1.4 (waves in lossy media) and 4.4 (ABCD matrices); S. Gabriel, R. W. Lau, C.
Gabriel, "The dielectric properties of biological tissues: III", Phys. Med. Biol. 41 (1996).
"""

from collections.abc import Iterable

import numpy as np

from .carrier import SPEED_OF_LIGHT_M_S

VACUUM_PERMITTIVITY_F_M = 8.8541878128e-12
# Thermal noise at 290 K, in dBm per Hz: 10 log10(k T / 1 mW).
THERMAL_DBM_HZ = -173.975

# Gabriel et al., table 1: permittivity at infinite frequency, static conductivity in S/m, and of
# each Cole-Cole dispersion its strength, time constant in s and exponent.
TISSUES: dict[str, tuple[float, float, tuple[tuple[float, float, float], ...]]] = {
    "muscle": (
        4.0,
        0.2,
        (
            (50.0, 7.234e-12, 0.1),
            (7000.0, 353.678e-9, 0.1),
            (1.2e6, 318.310e-6, 0.1),
            (2.5e7, 2.274e-3, 0.0),
        ),
    ),
    "fat": (
        2.5,
        0.01,
        (
            (3.0, 7.958e-12, 0.2),
            (15.0, 15.915e-9, 0.1),
            (3.3e4, 159.155e-6, 0.05),
            (1e7, 7.958e-3, 0.01),
        ),
    ),
    "skin": (4.0, 0.0002, ((32.0, 7.234e-12, 0.0), (1100.0, 32.481e-9, 0.2))),
}


def free_space_loss_db(distance_m: float, frequency_hz: float) -> float:
    """Loss between two isotropic antennas, (4 pi d / lambda)^2."""
    return float(20 * np.log10(4 * np.pi * distance_m * frequency_hz / SPEED_OF_LIGHT_M_S))


def complex_permittivity(
    permittivity: float, conductivity_s_m: float, frequency_hz: float
) -> complex:
    """Relative permittivity whose imaginary part holds the conductivity, for exp(+j w t)."""
    return permittivity - 1j * conductivity_s_m / (
        2 * np.pi * frequency_hz * VACUUM_PERMITTIVITY_F_M
    )


def tissue_permittivity(tissue: str, frequency_hz: float) -> complex:
    """The same of a tissue, one of `TISSUES`, from 10 Hz to 100 GHz."""
    infinite, conductivity, dispersions = TISSUES[tissue]
    omega = 2 * np.pi * frequency_hz
    return complex_permittivity(infinite, conductivity, frequency_hz) + sum(
        strength / (1 + (1j * omega * time_s) ** (1 - exponent))
        for strength, time_s, exponent in dispersions
    )


def layers_loss_db(layers: Iterable[tuple[complex, float]], frequency_hz: float) -> float:
    """Loss of a wave that passes layers at right angles, with air before and behind them.

    Layers are complex relative permittivity and thickness in m. Reflections at and between the
    borders are contained.
    """
    total = np.eye(2, dtype=complex)
    for permittivity, thickness_m in layers:
        index = np.sqrt(permittivity)
        turn = 2 * np.pi * frequency_hz / SPEED_OF_LIGHT_M_S * index * thickness_m
        # In units of the impedance of air, that of a layer is 1/index.
        total = total @ np.array(
            [[np.cos(turn), 1j * np.sin(turn) / index], [1j * np.sin(turn) * index, np.cos(turn)]]
        )
    return float(20 * np.log10(abs(total.sum() / 2)))
