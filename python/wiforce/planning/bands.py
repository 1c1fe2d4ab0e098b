# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a scene's signal lies in a band that may be transmitted in."""

from collections.abc import Iterator

from ..scene import Scene
from ..signal.bands import BANDS, bands_holding, occupied_band_hz


def outside_band(scene: Scene) -> Iterator[str]:
    """A warning when the signal leaves the band that the scene states.

    Yields str: a sentence; nothing when the signal lies inside, or no band is stated.
    """
    name = scene.environment.band
    if name is None:
        return
    low_hz, high_hz = occupied_band_hz(scene.radio.center_frequency_hz, scene.waveform())
    band = BANDS[name]
    if not band.holds(low_hz, high_hz):
        yield (
            f"band: the signal occupies {low_hz / 1e6:.6g} to {high_hz / 1e6:.6g} MHz, which "
            f"leaves environment.band {name} "
            f"({band.low_hz / 1e6:g} to {band.high_hz / 1e6:g} MHz): "
            "change radio.center_frequency_hz or radio.sample_rate_hz"
        )


def licence_note(scene: Scene) -> str | None:
    """A remark when no band is stated and the signal lies in none that is free of licences."""
    low_hz, high_hz = occupied_band_hz(scene.radio.center_frequency_hz, scene.waveform())
    if scene.packets is not None:  # who sends the packets is licensed, or needs no licence
        return None
    if scene.environment.band is not None or bands_holding(low_hz, high_hz):
        return None
    return (
        f"the signal occupies {low_hz / 1e6:.6g} to {high_hz / 1e6:.6g} MHz, which is inside none "
        f"of the licence-free bands {', '.join(BANDS)}: transmit over cables, or with a licence"
    )
