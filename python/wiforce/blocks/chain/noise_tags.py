# SPDX-License-Identifier: GPL-3.0-or-later
"""Noise of folded vectors as stream tags; lib/noise_tags.h does the same for the C++ blocks."""

from collections import deque
from typing import Any

import numpy as np
import pmt

from ...estimation.groups import Array


def noise_value(noise: Array) -> Any:
    """Value of the tag ``noise`` for some folded vectors that follow each other.

    Parameters
    ----------
    noise : ndarray, shape (n, 2)
        Smallest and largest difference of the repetitions of each, as a power per sample.

    Returns
    -------
    pmt
        f32vector of 2 n values.

    Examples
    --------
    >>> pmt.f32vector_elements(noise_value(np.array([[0.5, 1.0]])))
    [0.5, 1.0]
    """
    return pmt.init_f32vector(noise.size, np.asarray(noise, np.float32).ravel())


class NoiseTags:
    """Reads the tags ``noise`` of one input.

    Examples
    --------
    >>> tags = NoiseTags()
    >>> tags.add(7, noise_value(np.array([[1.0, 2.0], [3.0, 4.0]])))
    >>> tags.noise(6, 3).tolist()
    [[0.0, 0.0], [1.0, 2.0], [3.0, 4.0]]
    """

    def __init__(self) -> None:
        self._runs: deque[tuple[int, Array]] = deque()

    def add(self, item: int, value: Any) -> None:
        """Take the tag of an item; tags must come in the order of their items."""
        self._runs.append((item, np.array(pmt.f32vector_elements(value)).reshape(-1, 2)))

    def noise(self, first: int, count: int) -> Array:
        """Noise of some items, shape (count, 2); zeros where it is unknown.

        Tags of earlier items are forgotten.
        """
        noise = np.zeros((count, 2))
        while self._runs and self._runs[0][0] + len(self._runs[0][1]) <= first:
            self._runs.popleft()
        for item, values in self._runs:
            begin, end = max(item, first), min(item + len(values), first + count)
            if begin < end:
                noise[begin - first : end - first] = values[begin - item : end - item]
        return noise
