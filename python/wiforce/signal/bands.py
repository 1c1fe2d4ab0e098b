# SPDX-License-Identifier: GPL-3.0-or-later
"""Frequency bands that may be used without a licence, and what a sounding signal occupies."""

from typing import NamedTuple

from .waveform import Waveform


class Band(NamedTuple):
    """A frequency band, by its edges."""

    low_hz: float
    high_hz: float

    def holds(self, low_hz: float, high_hz: float) -> bool:
        """Whether all frequencies from ``low_hz`` to ``high_hz`` lie inside."""
        return self.low_hz <= low_hz and high_hz <= self.high_hz


# Only the edges are compared. Power, power density, duty cycle and channels are limited as well,
# by the rules named here; docs/reference/scenes.md says so.
BANDS = {
    # 47 CFR 15.247(a): 902-928, 2400-2483.5 and 5725-5850 MHz.
    "us-902-928": Band(902e6, 928e6),
    "us-2400-2483.5": Band(2400e6, 2483.5e6),
    "us-5725-5850": Band(5725e6, 5850e6),
    # ERC Recommendation 70-03, annex 1 (short range devices), with EN 300 220-2 below 1 GHz and
    # EN 300 440 above.
    "eu-433.05-434.79": Band(433.05e6, 434.79e6),
    "eu-863-870": Band(863e6, 870e6),
    "eu-5725-5875": Band(5725e6, 5875e6),
    # ERC Recommendation 70-03, annex 3 (wideband data transmission), with EN 300 328.
    "eu-2400-2483.5": Band(2400e6, 2483.5e6),
}


def occupied_band_hz(carrier_hz: float, waveform: Waveform) -> tuple[float, float]:
    """Lowest and highest frequency that a sounding signal occupies, in Hz.

    Those of the outermost subcarriers, so 62/64 of the sample rate for the default waveform.
    """
    edges = waveform.outermost_hz
    return carrier_hz + edges[0], carrier_hz + edges[1]


def bands_holding(low_hz: float, high_hz: float) -> tuple[str, ...]:
    """Names of the known bands (:data:`BANDS`) that hold a signal of these frequencies."""
    return tuple(name for name, band in BANDS.items() if band.holds(low_hz, high_hz))
