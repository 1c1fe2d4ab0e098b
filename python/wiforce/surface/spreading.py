# SPDX-License-Identifier: GPL-3.0-or-later
"""How a skin spreads the force of a press over the strips beneath it."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Spreading:
    """Share of a press that a strip bears, by its distance across from the press.

    Between its points the curve is a monotone cubic; it is the same on both sides of a press, and
    zero behind its last point.

    Parameters
    ----------
    distance_mm : tuple of float
        Rising, from 0.
    shares : tuple of float
        Share of the force at each distance.
    share_std : float
        Standard deviation of a share, which is the error of this law: it enters that of every
        reading.
    location_std_mm : float
        Standard deviation of the location that a strip shows of a press, against the press's own.
    location_offsets_mm : tuple of float
        By how much too far from its port 1 each strip shows a press on average; nothing where this
        is empty.
    """

    distance_mm: tuple[float, ...]
    shares: tuple[float, ...]
    share_std: float
    location_std_mm: float
    location_offsets_mm: tuple[float, ...] = ()

    @cached_property
    def _curve(self) -> "PchipInterpolator":
        from scipy.interpolate import PchipInterpolator

        # Mirrored, so that the curve is level beneath the press.
        across, share = np.array(self.distance_mm), np.array(self.shares)
        return PchipInterpolator(
            np.concatenate([-across[:0:-1], across]), np.concatenate([share[:0:-1], share])
        )

    def share(self, distance_mm: ArrayLike) -> Array:
        """Share of the force at distances from the press.

        Parameters
        ----------
        distance_mm : array_like
            Of either sign.
        """
        distance = np.abs(np.asarray(distance_mm, float))
        last = self.distance_mm[-1]
        found: Array = np.where(distance <= last, self._curve(np.minimum(distance, last)), 0.0)
        return found

    def offset_mm(self, strip: int) -> float:
        """Mean error of the location that a strip shows.

        Parameters
        ----------
        strip : int
            Index in the order of y.
        """
        return self.location_offsets_mm[strip] if self.location_offsets_mm else 0.0

    def share_of(self, strip: int, distance_mm: ArrayLike) -> Array:
        """Share of one strip; here that of any.

        Parameters
        ----------
        strip : int
            Index in the order of y.
        distance_mm : array_like
            y of the press less that of the strip.
        """
        return self.share(distance_mm)


@dataclass(frozen=True)
class StripSpreading(Spreading):
    """A law in which every strip has a curve of its own, since strips near an edge bear more.

    Parameters
    ----------
    distance_mm : tuple of float
        y of a press less that of the strip, rising.
    shares : tuple of float
        Mean of the strips' curves.
    share_std, location_std_mm, location_offsets_mm
        As for :class:`Spreading`.
    of_strips : tuple of tuple of float
        Share of each strip at each distance.
    """

    of_strips: tuple[tuple[float, ...], ...] = ()

    @cached_property
    def _curves(self) -> "list[PchipInterpolator]":
        from scipy.interpolate import PchipInterpolator

        return [PchipInterpolator(self.distance_mm, row) for row in (*self.of_strips, self.shares)]

    def share(self, distance_mm: ArrayLike) -> Array:
        """Mean of the strips' shares."""
        return self.share_of(-1, distance_mm)

    def share_of(self, strip: int, distance_mm: ArrayLike) -> Array:
        """Share of one strip; beyond the curve's ends that at the end."""
        distance = np.clip(distance_mm, self.distance_mm[0], self.distance_mm[-1])
        found: Array = np.asarray(self._curves[strip](distance))
        return found


# Points of a Gaussian, and its reach in widths: beyond, 1.1 % of the largest share are left.
_POINTS, _REACH = 25, 3.0


def gaussian_spreading(
    share: float, width_mm: float, share_std: float, location_std_mm: float
) -> Spreading:
    """A law that falls with the distance d as exp(-d^2 / (2 width^2)).

    Parameters
    ----------
    share : float
        Share of a strip right beneath the press.
    share_std, location_std_mm : float
        As for :class:`Spreading`.
    """
    distance = np.linspace(0.0, _REACH * width_mm, _POINTS)
    floor = np.exp(-0.5 * _REACH**2)
    shares = share * (np.exp(-0.5 * (distance / width_mm) ** 2) - floor) / (1 - floor)
    return Spreading(tuple(distance.tolist()), tuple(shares.tolist()), share_std, location_std_mm)
