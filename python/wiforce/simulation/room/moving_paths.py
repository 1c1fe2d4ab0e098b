# SPDX-License-Identifier: GPL-3.0-or-later
"""The paths of a simulated scene whose gain changes: what moves, and the tags."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..levels import Levels
from ..random_sources import RandomSources
from ..streams import Ramp
from ..tags.hand import NearHand
from ..tags.other_tags import UnlistedTag
from ..tags.tag import SwitchedTag
from .fan import FanBlades
from .mains import MainsLamps
from .paths import MOVING_PATHS, MovingPath, tag_taps
from .person import Person

if TYPE_CHECKING:
    from ...scene import Scene


@dataclass(frozen=True)
class ModulatedPath:
    """A path with a gain of its own at every sample.

    Attributes
    ----------
    taps : ndarray, shape (n,)
        FIR taps, float or complex.
    gain : callable
        First sample and count to ndarray of complex64, shape (count,).
    """

    taps: np.ndarray
    gain: Callable[[int, int], np.ndarray]


def modulated_paths(
    scene: "Scene", levels: Levels, sources: RandomSources, ramp: Ramp
) -> list[ModulatedPath]:
    """The paths by way of everything but the scene's tags.

    Parameters
    ----------
    levels : Levels
        Of the scene.
    sources : RandomSources
        Of the scene.
    ramp : Ramp
        Knots at which slow gains are computed.
    """
    simulation = scene.simulation

    def slow(taps: np.ndarray, amplitude: float, gain: Callable) -> ModulatedPath:
        """A path whose gain, a function of time, is interpolated between knots."""

        def at(first: int, count: int) -> np.ndarray:
            return ramp.interpolate(gain(ramp.knots(first, count)), first, count)

        return ModulatedPath(sources.rotated(levels.scaled(taps, amplitude)), at)

    paths = []
    if simulation.moving_clutter_db is not None:
        hertz = simulation.moving_clutter_hz
        level = levels.amplitude(simulation.moving_clutter_db) / np.sqrt(MOVING_PATHS)
        movers = [MovingPath(sources.movers, hertz, i == 0) for i in range(MOVING_PATHS)]
        paths += [slow(mover.taps, level, mover.gain) for mover in movers]
    if simulation.fan:
        fan = FanBlades(simulation.fan, sources.effect("fan"))
        paths.append(slow(fan.taps, levels.amplitude(simulation.fan.level_db), fan.gain))
    if simulation.walker:
        person = Person(
            simulation.walker, scene.radio.center_frequency_hz, sources.effect("walker")
        )
        level = levels.amplitude(simulation.walker.level_db)
        for limb in person.limbs:
            paths.append(slow(limb.taps, level * limb.amplitude, limb.gain))
    if simulation.lamps:
        lamps = MainsLamps(simulation.lamps, sources.effect("lamps"))
        paths.append(slow(lamps.taps, levels.amplitude(simulation.lamps.level_db), lamps.gain))
    for index, stated in enumerate(simulation.other_tags):
        other = UnlistedTag(stated, scene, sources.effect("other_tags").generator(index))
        taps = levels.scaled(other.taps, 10 ** (stated.level_db / 20))
        paths.append(ModulatedPath(sources.rotated(taps), other.reflection))
    return paths


def tag_paths(
    scene: "Scene", levels: Levels, sources: RandomSources, ramp: Ramp
) -> tuple[dict[str, SwitchedTag], list[ModulatedPath]]:
    """The scene's tags, and the paths by way of them.

    Parameters
    ----------
    scene, levels, sources, ramp
        As for :func:`modulated_paths`.

    Returns
    -------
    tags : dict of str to SwitchedTag
        By sensor name.
    paths : list of ModulatedPath
    """
    simulation = scene.simulation
    tags, paths = {}, []
    for index, tag in enumerate(simulation.tags):
        switched = SwitchedTag(scene, index, sources, ramp)
        fade = tag_taps(sources.paths, scene.waveform(), simulation.tag_coherence_hz)
        rotation = sources.rotated(np.ones(1))
        level = 10 ** (tag.level_db / 20)
        tags[switched.name] = switched
        paths.append(ModulatedPath(rotation * levels.scaled(fade, level), switched.reflection))
        if tag.hand:
            hand = NearHand(tag.hand, switched, scene, sources.effect("hand").generator(index))
            taps = levels.scaled(hand.taps, level * 10 ** (tag.hand.level_db / 20))
            paths.append(ModulatedPath(rotation * taps, _product(switched, hand, ramp)))
    return tags, paths


def _product(tag: SwitchedTag, hand: NearHand, ramp: Ramp) -> Callable[[int, int], np.ndarray]:
    """Gain of the path by way of tag and hand."""

    def at(first: int, count: int) -> np.ndarray:
        gain = ramp.interpolate(hand.gain(ramp.knots(first, count)), first, count)
        return gain * tag.reflection(first, count)

    return at
