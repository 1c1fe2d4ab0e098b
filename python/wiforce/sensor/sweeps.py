# SPDX-License-Identifier: GPL-3.0-or-later
"""Loading and unloading, distinguished by the order in which a press was measured."""

import numpy as np

# A branch ends where the force turns by more than this part of its span, which a load cell's noise
# does not reach. Shorter branches are no sweeps, and data with more of them are in no order.
_TURN, _LEAST_BRANCH, _ORDERED_SHARE = 0.2, 4, 0.8


def sweep_directions(force_n: np.ndarray) -> np.ndarray:
    """Whether the force of a press rose or fell, from the order of its rows.

    Returns ndarray of int, shape (n,): 1 while loading, -1 while unloading. All 0 where the rows
    are in no order of measurement.

    Parameters
    ----------
    force_n : ndarray, shape (n,)
        Of one press, in the order in which it was measured.
    """
    direction = np.zeros(len(force_n), int)
    for start, stop, sign in _branches(force_n):
        if stop - start >= _LEAST_BRANCH:
            direction[start:stop] = sign
    if np.mean(direction != 0) < _ORDERED_SHARE:
        direction[:] = 0
    return direction


def _branches(force_n: np.ndarray) -> list[tuple[int, int, int]]:
    """First row, row after the last one, and sign of each rise and fall of the force."""
    turn = _TURN * np.ptp(force_n)
    found, start, extreme, sign = [], 0, 0, 0
    for row in range(1, len(force_n)):
        change = force_n[row] - force_n[extreme]
        if not sign and abs(change) > turn:
            sign = 1 if change > 0 else -1
        if sign * change >= 0:
            extreme = row if sign else extreme
        elif abs(change) > turn:
            found.append((start, extreme + 1, sign))
            start, extreme, sign = extreme + 1, row, -sign
    return [*found, (start, len(force_n), sign)]
