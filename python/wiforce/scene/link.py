# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a scene's levels come from: powers, distances, antennas and what lies in between.

H. T. Friis, "A note on a simple transmission formula", Proc. IRE 34 (1946); D. M. Pozar, *Microwave
Engineering*, sections 1.4 (waves in lossy media) and 4.4 (ABCD matrices); S. Gabriel, R. W. Lau, C.
Gabriel, "The dielectric properties of biological tissues: III", Phys. Med. Biol. 41 (1996).
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from ..io.text.schema import Derived, ListOf, declared, key
from ..io.text.values import Choice, Number, Scope
from ..signal.carrier import SPEED_OF_LIGHT_M_S, VACUUM_PERMITTIVITY_F_M
from ..signal.switching import harmonics
from ..signal.waveform import Waveform

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
    """Loss through layers (complex permittivity, thickness in m) between air, reflections too."""
    total = np.eye(2, dtype=complex)
    for permittivity, thickness_m in layers:
        index = np.sqrt(permittivity)
        turn = 2 * np.pi * frequency_hz / SPEED_OF_LIGHT_M_S * index * thickness_m
        # In units of the impedance of air, that of a layer is 1/index.
        total = total @ np.array(
            [[np.cos(turn), 1j * np.sin(turn) / index], [1j * np.sin(turn) * index, np.cos(turn)]]
        )
    return float(20 * np.log10(abs(total.sum() / 2)))


_GAIN = Number(unit="dBi", low=-60, high=60)
# Nearer than this, antennas of a wavelength's size are in each other's near field.
_DISTANCE = Number(unit="m", low=0.05, high=1000)
_LOSS = Number(unit="dB", low=0, high=200)
# Distances of a triangle may miss its inequalities by their rounding.
_ROUNDED = 1 + 1e-9
_OTHER = "other"


def _stated_if_other(value: float | None, scope: Scope) -> str | None:
    if (scope["material"] == _OTHER) == (value is None):
        return f"must be given for material '{_OTHER}', and for no other"
    return None


def _no_triangle(antennas_m: float, scope: Scope) -> str | None:
    one, other = scope["transmitter_m"], scope["receiver_m"]
    if abs(one - other) <= antennas_m * _ROUNDED and antennas_m <= (one + other) * _ROUNDED:
        return None
    rule = f"must be {abs(one - other):g} to {one + other:g} m, with the tag at these distances"
    return f"{rule} from transmitter_m and receiver_m"


def _beyond_antenna(layers: "tuple[Layer, ...]", scope: Scope) -> str | None:
    nearer_m = min(scope["transmitter_m"], scope["receiver_m"])
    thickness_mm = sum(layer.thickness_mm for layer in layers)
    if thickness_mm < 1e3 * nearer_m:
        return None
    return (
        f"must be thinner together ({thickness_mm:g} mm) than the nearer antenna is away "
        f"({1e3 * nearer_m:g} mm)"
    )


@declared
class Layer:
    """A layer of tissue or another material between the tag and both antennas."""

    material: str = key(
        Choice(words=(*TISSUES, _OTHER)),
        doc="`muscle`, `fat` and `skin` follow the carrier (Gabriel et al. 1996).",
    )
    thickness_mm: float = key(Number(unit="mm", low=0, above=True, high=1000), doc="Its thickness.")
    permittivity: float | None = key(
        Number(low=1, high=1000, optional=True),
        check=_stated_if_other,
        doc="Relative permittivity of another material.",
    )
    conductivity_s_m: float | None = key(
        Number(unit="S/m", low=0, high=1000, optional=True),
        check=_stated_if_other,
        doc="Conductivity of another material.",
    )

    def at(self, frequency_hz: float) -> tuple[complex, float]:
        """Complex relative permittivity, and thickness in m."""
        if self.material == _OTHER:
            stated = self.permittivity, self.conductivity_s_m
            found = complex_permittivity(*stated, frequency_hz)  # type: ignore[arg-type]
        else:
            found = tissue_permittivity(self.material, frequency_hz)
        return found, 1e-3 * self.thickness_mm


@declared
class Link:
    """A link budget, from which `snr_db` and `static_clutter_db` follow."""

    transmit_dbm: float = key(
        Number(unit="dBm", low=-60, high=60), default=10.0, doc="Mean power of a preamble."
    )
    noise_figure_db: float = key(_LOSS, default=6.0, doc="Noise figure of the receiver.")
    transmitter_m: float = key(_DISTANCE, doc="From the transmitting antenna to the tag.")
    receiver_m: float = key(_DISTANCE, doc="From the tag to the receiving antenna.")
    antennas_m: float = key(
        _DISTANCE,
        derived=Derived(
            "`transmitter_m` + `receiver_m`, the tag on the line between the antennas",
            lambda scope: scope["transmitter_m"] + scope["receiver_m"],
        ),
        check=_no_triangle,
        doc="Between transmitting and receiving antenna.",
    )
    transmitter_dbi: float = key(_GAIN, default=0.0, doc="Gain of the transmitting antenna.")
    receiver_dbi: float = key(_GAIN, default=0.0, doc="Gain of the receiving antenna.")
    tag_dbi: float = key(_GAIN, default=0.0, doc="Gain of the tag's antenna, which counts twice.")
    tag_loss_db: float = key(
        _LOSS, default=1.0, doc="Loss of the tag's switches and of the line, there and back."
    )
    direct_loss_db: float = key(
        _LOSS,
        default=0.0,
        doc="What attenuates the direct path beyond free space, such as a metal plate.",
    )
    layers: tuple[Layer, ...] = key(
        ListOf(of=Layer, most=16),
        check=_beyond_antenna,
        doc="Layers that the waves pass at right angles, there and back, the outermost first.",
    )

    def tag_path_loss_db(self, frequency_hz: float) -> float:
        """From the transmitter by way of the tag to the receiver."""
        paths = self.transmitter_m, self.receiver_m
        layers = layers_loss_db([layer.at(frequency_hz) for layer in self.layers], frequency_hz)
        gains = self.transmitter_dbi + self.receiver_dbi + 2 * self.tag_dbi
        free = sum(free_space_loss_db(distance, frequency_hz) for distance in paths)
        return free + 2 * layers + self.tag_loss_db - gains

    def direct_path_loss_db(self, frequency_hz: float) -> float:
        """From the transmitter straight to the receiver."""
        gains = self.transmitter_dbi + self.receiver_dbi
        return free_space_loss_db(self.antennas_m, frequency_hz) + self.direct_loss_db - gains

    def levels_db(
        self, frequency_hz: float, waveform: Waveform, clock_hz: float
    ) -> tuple[float, float]:
        """`snr_db` and `static_clutter_db` of a scene, which refer to line 1 of the first tag."""
        line = 20 * np.log10(harmonics(1, clock_hz * waveform.averaging_s)[0])
        received_dbm = self.transmit_dbm - self.tag_path_loss_db(frequency_hz) + line
        noise = waveform.sample_rate_hz * waveform.channel_noise_gain
        noise_dbm = THERMAL_DBM_HZ + self.noise_figure_db + 10 * np.log10(noise)
        static_db = self.transmit_dbm - self.direct_path_loss_db(frequency_hz) - received_dbm
        return float(received_dbm - noise_dbm), float(static_db)


def level_or(default: float, which: int) -> Derived:
    """A level of a scene that follows from its link budget, or is a number without one."""

    def level(scope: Any) -> float:
        link, radio = scope["link"], scope["radio"]
        if link is None or scope.get("packets"):
            return default
        waveform = scope["sounding"].waveform_at(radio.sample_rate_hz)
        frequency_hz, clock_hz = radio.center_frequency_hz, scope["sensors"][0].clock_hz
        return round(link.levels_db(frequency_hz, waveform, clock_hz)[which], 2)

    return Derived(f"{default:g}; that of `link` where it is stated", level)
