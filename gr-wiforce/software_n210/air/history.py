# SPDX-License-Identifier: GPL-3.0-or-later
"""Recent samples on the device's time line."""

from collections import deque

import numpy as np


class SampleHistory:
    """Recent samples on the device's time line; zero where there are none."""

    def __init__(self):
        self._segments = deque()

    def append(self, tick, spacing, samples):
        """Add samples that start at `tick`, one every `spacing` ticks."""
        self._segments.append((tick, spacing, samples))

    def forget(self, tick):
        """Drop samples that ended before `tick`."""
        while self._segments:
            start, spacing, samples = self._segments[0]
            if start + (len(samples) + 1) * spacing > tick:
                break
            self._segments.popleft()

    def take(self, tick, spacing, count):
        """`count` samples from `tick` on, every `spacing` ticks: the nearest sample each."""
        out = np.zeros(count, np.complex64)
        for start, step, samples in self._segments:
            if step == spacing:
                first = (tick - start + step // 2) // step
                low, high = max(0, -first), min(count, len(samples) - first)
                if low < high:
                    out[low:high] = samples[first + low : first + high]
            else:
                index = (tick - start + step // 2 + np.arange(count) * spacing) // step
                inside = (index >= 0) & (index < len(samples))
                out[inside] = samples[index[inside]]
        return out
