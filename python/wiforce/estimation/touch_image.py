# SPDX-License-Identifier: GPL-3.0-or-later
"""The phase changes that a touch can cause, as a set of points, and distances from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..signal.carrier import wrapped
from .groups import Array


class TouchImage:
    """Phase changes of touched lines.

    Parameters
    ----------
    image_deg : ndarray, shape (n, 2)
        Changes against the untouched line, densely over force and location.

    Examples
    --------
    >>> image = TouchImage(np.array([[40.0, 10.0], [20.0, 30.0]]))
    >>> image.distance((41.0, 12.0), (1.0, 2.0))
    2.0
    >>> image.is_within(1.9, (41.0, 12.0), (1.0, 2.0))
    False
    """

    def __init__(self, image_deg: Array) -> None:
        self._points = np.ascontiguousarray(np.asarray(image_deg, float).T)
        # The point that was nearest last. It saves searches, and changes no result.
        self._nearest = (float(self._points[0, 0]), float(self._points[1, 0]))

    def is_within(
        self, limit: float, change_deg: tuple[float, float], spreads_deg: Sequence[float]
    ) -> bool:
        """Whether a touch lies within so many squared standard deviations of a change.

        Parameters
        ----------
        limit : float
        change_deg : (float, float)
        spreads_deg : sequence of float, length 2
            Standard deviations of the change.

        Returns
        -------
        bool
        """
        first = wrapped(self._nearest[0] - change_deg[0]) / spreads_deg[0]
        second = wrapped(self._nearest[1] - change_deg[1]) / spreads_deg[1]
        if first**2 + second**2 <= limit:
            return True
        return self.distance(change_deg, spreads_deg) <= limit

    def distance(self, change_deg: tuple[float, float], spreads_deg: Sequence[float]) -> float:
        """Squared standard deviations of a change from the nearest touch.

        Parameters
        ----------
        change_deg : (float, float)
        spreads_deg : sequence of float, length 2
            Standard deviations of the change.

        Returns
        -------
        float
        """
        apart = self._points - np.array(change_deg)[:, None]
        apart -= 360 * np.rint(apart / 360)
        apart /= np.array(spreads_deg)[:, None]
        distances = (apart * apart).sum(axis=0)
        best = int(np.argmin(distances))
        self._nearest = (float(self._points[0, best]), float(self._points[1, best]))
        return float(distances[best])
