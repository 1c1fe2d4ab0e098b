# SPDX-License-Identifier: GPL-3.0-or-later
"""Random quantities of a simulated scene: one generator per kind, so that kinds are independent."""

from collections.abc import Iterator

import numpy as np

_MOST_PATHS = 64
# First part of the seeds of effects; 0 to 5 are those of the generators of RandomSources.
_EFFECT_KEY = 6
# Their order determines the seeds: append only.
EFFECTS = (
    "bursts",
    "hopper",
    "front_end",
    "lamps",
    "ripple",
    "fan",
    "walker",
    "other_tags",
    "clock",
    "drift",
    "hand",
    "packets",
    "radio_noise",
)


class Seeds:
    """Generators of one effect, by counter.

    What is drawn for a counter, such as the index of a block of samples, does not depend on what
    was drawn before. Effects that draw in this way can start anywhere in the stream.

    Parameters
    ----------
    seed : int
        Of the scene.
    effect : str
        One of :data:`EFFECTS`.
    """

    def __init__(self, seed: int, effect: str) -> None:
        self._seed, self._key = seed, (_EFFECT_KEY, EFFECTS.index(effect))

    def generator(self, *counters: int) -> np.random.Generator:
        """The generator of these counters.

        Parameters
        ----------
        *counters : int
            Not negative.
        """
        key = (*self._key, *counters)
        return np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=key))


class RandomSources:
    """Generators of a scene's random quantities, one per kind, so that kinds stay independent.

    Antennas other than the first have their own paths and noise, and rotate each path of tags and
    moving objects by a phase of its own.

    Parameters
    ----------
    seed : int
        Of the scene.
    antenna : int
        From 0.

    Attributes
    ----------
    paths, clocks, movers, noise, oscillators : numpy.random.Generator
    """

    def __init__(self, seed: int, antenna: int) -> None:
        seeds = np.random.SeedSequence(seed).spawn(5)
        generators = map(np.random.default_rng, seeds)
        self.paths, self.clocks, self.movers, self.noise, self.oscillators = generators
        self._seed = seed
        self._rotations: Iterator[complex] = iter(np.ones(_MOST_PATHS))
        if antenna:
            own = np.random.SeedSequence(seed, spawn_key=(len(seeds), antenna)).spawn(2)
            self.paths, self.noise = map(np.random.default_rng, own)
            self._rotations = iter(np.exp(2j * np.pi * self.paths.random(_MOST_PATHS)))

    def rotated(self, taps: np.ndarray) -> np.ndarray:
        """The taps of the next path, as this antenna has them."""
        return taps * next(self._rotations)

    def effect(self, name: str) -> Seeds:
        """The generators of an effect, which all antennas share."""
        return Seeds(self._seed, name)
