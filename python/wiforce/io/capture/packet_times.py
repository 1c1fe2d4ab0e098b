# SPDX-License-Identifier: GPL-3.0-or-later
"""Times of packets as devices report them: clocks that step back, and stamps out of order."""

from __future__ import annotations

import numpy as np

# Time that a clock is behind at most where stamps are merely out of order, in s: a host stamps
# packets when a program runs, up to some milliseconds late. Larger ones are steps of the clock.
_DISORDER_S = 0.01
# What remains unknown of the time when a clock has stepped back, in s: longer than the clock of a
# tag is predicted over a gap (20 s, estimation/clocks/clock_tracking.py), which is then acquired
# again.
CLOCK_STEP_S = 30.0
# Packets between two steps of a clock, on average, below which times are in no order at all.
_LEAST_BETWEEN = 64


def ordered_times(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Times that rise, with a gap in the place of each step of the clock.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        In the order in which packets were received, in s.

    Returns
    -------
    order : ndarray of int, shape (n,)
        Packets by their time.
    time_s : ndarray, shape (n,)
        Of these packets, not falling.
    steps : int
        Times at which the clock has stepped back.

    Raises
    ------
    ValueError
        With the index of a packet, for times that step back all the time.

    Examples
    --------
    >>> stamps = np.concatenate([10 + 0.001 * np.arange(100), 3 + 0.001 * np.arange(100)])
    >>> order, time_s, steps = ordered_times(stamps)
    >>> steps, round(float(time_s[100] - time_s[99]), 3)
    (1, 30.0)
    """
    times = time_s.astype(float)
    back = np.flatnonzero(np.diff(times) < -_DISORDER_S) + 1
    if len(back) and len(times) < _LEAST_BETWEEN * (len(back) + 1):
        raise ValueError(int(back[0]))
    later = np.zeros(len(times))
    later[back] = times[back - 1] - times[back] + CLOCK_STEP_S
    times = times + np.cumsum(later)
    order = np.argsort(times, kind="stable")
    return order, times[order], len(back)
