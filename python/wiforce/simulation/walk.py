# SPDX-License-Identifier: GPL-3.0-or-later
"""Random walks: quantities that wander without a preferred value."""

import numpy as np

# Knots that are drawn at once.
_DRAWN = 4096


class RandomWalk:
    """A random walk from 0 at time 0, and its integral.

    Parameters
    ----------
    std_per_sqrt_s : float
        Standard deviation after 1 s.
    rng : numpy.random.Generator
        Of this walk alone.
    limit : float
        The walk is reflected at +-``limit``.
    spacing_s : float
        Time between knots; between them the walk is linear.

    Notes
    -----
    The walk is kept from time 0 on, 16 bytes per knot, and so can be evaluated in any order.
    """

    def __init__(
        self,
        std_per_sqrt_s: float,
        rng: np.random.Generator,
        limit: float = np.inf,
        spacing_s: float = 10e-3,
    ) -> None:
        self._step, self._rng, self._limit = std_per_sqrt_s * np.sqrt(spacing_s), rng, limit
        self._spacing_s = spacing_s
        self._last = 0.0  # before reflection
        self._values, self._integrals = np.zeros(1), np.zeros(1)

    def at(self, time_s: np.ndarray | float) -> np.ndarray:
        """The walk at given times.

        Returns ndarray of float, shape of ``time_s``.

        Parameters
        ----------
        time_s : array_like of float, any shape
            Not negative; negative times count as 0.
        """
        knot, inside = self._knots(time_s)
        return self._values[knot] + inside * (self._values[knot + 1] - self._values[knot])

    def integral(self, time_s: np.ndarray | float) -> np.ndarray:
        """Its integral over time, from time 0.

        Returns ndarray of float, shape of ``time_s``.

        Parameters
        ----------
        time_s : array_like of float, any shape
        """
        knot, inside = self._knots(time_s)
        start = self._values[knot]
        rise = self._values[knot + 1] - start
        return self._integrals[knot] + self._spacing_s * (start * inside + rise * inside**2 / 2)

    def _knots(self, time_s: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        """The knot before each time, and the part of the interval after it."""
        position = np.maximum(np.asarray(time_s, float) / self._spacing_s, 0.0)
        knot = position.astype(np.int64)
        if knot.size:
            self._extend(int(knot.max()) + 2)
        return knot, position - knot

    def _extend(self, count: int) -> None:
        """Draw whole lots of knots until there are at least ``count``."""
        missing = count - len(self._values)
        if missing <= 0:
            return
        steps = self._rng.standard_normal(-(-missing // _DRAWN) * _DRAWN) * self._step
        walk = self._last + np.cumsum(steps)
        self._last = float(walk[-1])
        new = np.r_[self._values[-1], _reflected(walk, self._limit)]
        areas = np.cumsum((new[1:] + new[:-1]) / 2) * self._spacing_s
        self._integrals = np.r_[self._integrals, self._integrals[-1] + areas]
        self._values = np.r_[self._values, new[1:]]


def _reflected(walk: np.ndarray, limit: float) -> np.ndarray:
    if not np.isfinite(limit):
        return walk
    folded = (walk + limit) % (4 * limit)
    return np.where(folded < 2 * limit, folded - limit, 3 * limit - folded)
