# SPDX-License-Identifier: GPL-3.0-or-later
"""Times of packets in a typical phase group of a scene, before anything is received."""

import numpy as np

from ...scene import Scene

# Of the typical group's times; any other seed gives the same expected errors within 0.1 dB.
_SEED = 1


def typical_times_s(scene: Scene) -> np.ndarray:
    """Times of the packets of a typical phase group, from its centre.

    Returns ndarray of float, shape (N,): in s, rising.

    Parameters
    ----------
    scene : Scene
        With packets.
    """
    count, period_s = scene.phase_group.snapshots, scene.group_period_s
    if scene.packets is not None and scene.packets.gaps == "regular":
        return (np.arange(count) + 0.5) * (period_s / count) - period_s / 2
    # Given their number, the times of a Poisson process are uniform.
    return np.sort(np.random.default_rng(_SEED).uniform(-period_s / 2, period_s / 2, count))
