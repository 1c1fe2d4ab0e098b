# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene's link budget gives, and how deep other carriers would read."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..io.readings import WEAK_PHASE_DEG
from ..scene import Scene
from ..scene.link import Link
from ..signal.carrier import BANDS, occupied_band_hz
from .expected import phase_std_deg, receive_levels, why_not_readable
from .plan import Plan

# Standard deviation of an angle of which nothing is known: 360 deg / sqrt(12).
_UNKNOWN_DEG = 104.0
# Factors of the depth that are searched: from a thousandth to a thousand times that of the scene.
_FACTORS, _HALVINGS = (1e-3, 1e3), 40


@dataclass(frozen=True)
class CarrierReach:
    """What a carrier reads through a scene's link."""

    carrier_hz: float
    band: str  # whose centre it is; empty for the scene's own carrier
    snr_db: float  # as the scene's, and ``static_db`` as its ``static_clutter_db``
    static_db: float
    phase_std_deg: float  # noise of the phases of a reading, of the worst end
    # Depth of the innermost layer in mm, or without layers distance of the tag from the receiver in
    # m, at which readings become ``weak``; 0 where all are. Below the scene's carrier a degree is
    # more of the line: the limit is then that of the same distance on the line.
    reach: float


def carrier_reaches(plan: Plan) -> list[CarrierReach]:
    """The scene's carrier and those of all bands that hold its signal; empty without a link."""
    scene = plan.require_scene()
    link = scene.simulation.link
    if link is None:
        return []
    own_hz = scene.radio.center_frequency_hz
    unit_deg = float(phase_std_deg(plan).max()) / np.sqrt(receive_levels(scene).total)
    tags = range(len(scene.sensors))
    depth = link.layers[-1].thickness_mm if link.layers else link.receiver_m

    def found(link: Link, carrier_hz: float) -> tuple[float, float, float]:
        clock_hz = scene.sensors[0].clock_hz
        snr_db, static_db = link.levels_db(carrier_hz, scene.waveform(), clock_hz)
        stated = replace(scene.simulation, snr_db=snr_db, static_clutter_db=static_db)
        there = replace(scene, simulation=stated)
        levels = receive_levels(there, carrier_hz)
        if any(why_not_readable(there, tag, levels) for tag in tags):
            return snr_db, static_db, _UNKNOWN_DEG
        return snr_db, static_db, float(unit_deg * np.sqrt(levels.total))

    def reach(carrier_hz: float) -> float:
        limit_deg = WEAK_PHASE_DEG * min(1.0, carrier_hz / own_hz)
        low, high = np.log(_FACTORS)
        if found(_deeper(link, _FACTORS[0]), carrier_hz)[2] > limit_deg:
            return 0.0
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            weak = found(_deeper(link, np.exp(middle)), carrier_hz)[2] > limit_deg
            low, high = (low, middle) if weak else (middle, high)
        return float(np.exp(low)) * depth

    return [CarrierReach(hz, band, *found(link, hz), reach(hz)) for hz, band in _carriers(scene)]


def _carriers(scene: Scene) -> Iterator[tuple[float, str]]:
    own_hz = scene.radio.center_frequency_hz
    yield own_hz, ""
    low_hz, high_hz = occupied_band_hz(own_hz, scene.waveform())
    centres: dict[float, str] = {}
    for name, band in BANDS.items():
        if band.high_hz - band.low_hz >= high_hz - low_hz:
            centres.setdefault((band.low_hz + band.high_hz) / 2, name)
    yield from centres.items()


def _deeper(link: Link, factor: float) -> Link:
    if link.layers:
        *outer, last = link.layers
        last = replace(last, thickness_mm=factor * last.thickness_mm)
        return replace(link, layers=(*outer, last))
    distances = factor * link.transmitter_m, factor * link.receiver_m
    return replace(link, transmitter_m=distances[0], receiver_m=distances[1])


def link_lines(plan: Plan, reaches: list[CarrierReach]) -> Iterator[str]:
    """The link budget as lines for a terminal; the first carrier is the scene's."""
    scene = plan.require_scene()
    link, hz = scene.simulation.link, scene.radio.center_frequency_hz
    if link is None:
        return
    unit = f"mm of {link.layers[-1].material}" if link.layers else "m"
    yield (
        f"link: {link.tag_path_loss_db(hz):.1f} dB by way of the tag, "
        f"{link.direct_path_loss_db(hz):.1f} dB straight"
    )
    yield f"{'carrier':>12}{'snr_db':>8}{'static path':>13}{'phase std':>13}  reads up to"
    for each in reaches:
        std_deg = each.phase_std_deg
        std = f"{std_deg:.2g} deg" if std_deg < _UNKNOWN_DEG else "unknown"
        yield (
            f"{each.carrier_hz / 1e6:8.5g} MHz{each.snr_db:8.1f}{each.static_db:10.1f} dB"
            f"{std:>13}  {each.reach:.2g} {unit} {each.band}".rstrip()
        )
    deepest = max(reaches, key=lambda each: each.reach)
    reached = f"{deepest.carrier_hz / 1e6:.5g} MHz, {deepest.reach:.2g} {unit}"
    yield f"deepest: {reached if deepest.reach else 'none reads clearly at any depth'}"
