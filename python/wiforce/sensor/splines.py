# SPDX-License-Identifier: GPL-3.0-or-later
"""Cubic splines that every reading needs.

``scipy.interpolate`` has the same, but takes as long to import as all else that a reading of a
capture needs; the tests compare both.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[Any]


def node_slopes(nodes: Array) -> Array:
    """Slopes of a cubic spline at 4 or more rising nodes, as a matrix (n, n) times its values.

    "Not-a-knot"; C. de Boor, *A Practical Guide to Splines*, 1978, chapter IV, equations 4 and 6.
    """
    steps = np.diff(nodes)
    count, inner = len(nodes), np.arange(1, len(nodes) - 1)
    system, right = np.zeros((2, count, count))
    system[inner, inner - 1], system[inner, inner + 1] = steps[1:], steps[:-1]
    system[inner, inner] = 2 * (steps[1:] + steps[:-1])
    before, after = 3 * steps[1:] / steps[:-1], 3 * steps[:-1] / steps[1:]
    right[inner, inner - 1], right[inner, inner + 1] = -before, after
    right[inner, inner] = before - after
    for row, sign, (first, second) in ((0, 1, steps[:2]), (count - 1, -1, steps[:-3:-1])):
        span = first + second
        system[row, row], system[row, row + sign] = second, span
        own = (first + 2 * span) * second / first / span
        other = first**2 / second / span
        right[row, row], right[row, row + sign] = -sign * own, sign * (own - other)
        right[row, row + 2 * sign] = sign * other
    slopes: Array = np.linalg.solve(system, right)
    return slopes


class CubicSpline:
    """SciPy's cubic spline through values (n, ...) at nodes (n,), by their :func:`node_slopes`."""

    def __init__(self, nodes: Array, values: Array, slopes: Array) -> None:
        self._nodes, self._values = nodes, values
        self._slopes = np.tensordot(slopes, values, 1)

    def __call__(self, at: ArrayLike) -> Array:
        """Values at some places, shape (...); of shape (..., *values.shape[1:])."""
        at = np.asarray(at, float)
        last = len(self._nodes) - 2
        left = np.clip(np.searchsorted(self._nodes, at, side="right") - 1, 0, last)
        step = self._nodes[left + 1] - self._nodes[left]
        share = (at - self._nodes[left]) / step
        rest = 1 - share
        # Hermite's polynomials.
        parts = (
            ((1 + 2 * share) * rest**2, self._values[left]),
            (share * rest**2 * step, self._slopes[left]),
            ((3 - 2 * share) * share**2, self._values[left + 1]),
            (-rest * share**2 * step, self._slopes[left + 1]),
        )
        tail = (1,) * (self._values.ndim - 1)
        found: Array = sum(np.reshape(f, at.shape + tail) * values for f, values in parts)
        return found


def basis_splines(knots: Array, at: ArrayLike, derivative: int = 0, degree: int = 3) -> Array:
    """All B-splines (..., len(knots) - degree - 1) of rising knots, or their derivatives.

    The outer knots stand degree + 1 times. C. de Boor, *A Practical Guide to Splines*, chapter X.
    """
    at = np.asarray(at, float)
    if degree == 0:
        piece = np.searchsorted(knots, at, side="right") - 1
        inner = np.flatnonzero(np.diff(knots) > 0)
        piece = np.clip(piece, inner[0], inner[-1])
        own: Array = (piece[..., None] == np.arange(len(knots) - 1)).astype(float)
        return own
    lower = basis_splines(knots, at, max(derivative - 1, 0), degree - 1)
    widths = knots[degree:-1] - knots[: -degree - 1], knots[degree + 1 :] - knots[1:-degree]
    rising, falling = (np.divide(1, w, out=np.zeros(len(w)), where=w > 0) for w in widths)
    if derivative:
        return degree * (lower[..., :-1] * rising - lower[..., 1:] * falling)
    rising = (at[..., None] - knots[: -degree - 1]) * rising
    falling = (knots[degree + 1 :] - at[..., None]) * falling
    found: Array = rising * lower[..., :-1] + falling * lower[..., 1:]
    return found
