# SPDX-License-Identifier: GPL-3.0-or-later
"""Comparison of a device's clock with the host's UTC."""

import time
from collections.abc import Callable

# The device's clock is compared again after this time: 25 ppm of it are 0.25 ms.
_EVERY_S = 10.0
_QUERIES = 3


class ClockComparison:
    """Compares the clocks of host and device now and then.

    The device is asked for its time, and the host's clock is read before and after. Their mean is
    the UTC of the answer; half of their difference is the uncertainty, to which that of the host's
    clock adds.

    ``device_time``: returns the device's time in seconds; may raise RuntimeError; ``utc``, ``now``:
    return UTC and a steady time in seconds.
    """

    def __init__(
        self,
        device_time: Callable[[], float],
        utc: Callable[[], float] = time.time,
        now: Callable[[], float] = time.monotonic,
    ):
        self._device_time, self._utc, self._now = device_time, utc, now
        self._compared_s = -float("inf")

    def look(self) -> tuple[float, float] | None:
        """Compare the clocks where the last comparison is ten seconds old.

        Returns tuple of (float, float) or None: offset of UTC from the device's clock and its
        uncertainty, in s, by the quickest of three answers; None where none is due, or the device
        does not answer.
        """
        if self._now() - self._compared_s < _EVERY_S:
            return None
        self._compared_s = self._now()
        best = None
        for _ in range(_QUERIES):
            before_s = self._utc()
            try:
                device_s = self._device_time()
            except RuntimeError:  # UHD's, when the device does not answer
                return None
            half_s = (self._utc() - before_s) / 2
            if half_s >= 0 and (best is None or half_s < best[1]):
                best = before_s + half_s - device_s, half_s
        return best
