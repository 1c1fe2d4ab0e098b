# SPDX-License-Identifier: GPL-3.0-or-later
"""Phases to force and location, with covariance and flags."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..wiforce_kernels import INVERSION_FLAGS, press_posterior
from .forward import ForwardMap

if TYPE_CHECKING:
    from .model import SensorModel

# Standard deviation of a phase of which nothing is known.
DEFAULT_STD_DEG = 1.0
# Phases fit no press when their residual is larger than that of so many presses: 3 standard
# deviations of a normal variable.
_CONSISTENT = 0.9973
# The words of each sum of flags.
_WORDS = [
    tuple(word for word, flag in INVERSION_FLAGS.items() if code & flag)
    for code in range(2 * max(INVERSION_FLAGS.values()))
]


def misfit_limit(phases: int, share: float) -> float:
    """Sum of squares of normal variables that is exceeded in a share of all cases.

    Parameters
    ----------
    phases : int
        Number of variables.
    share : float
    """
    if phases == 2:
        return -2 * math.log(share)
    from scipy.special import chdtri  # for several carriers; slow to import

    return float(chdtri(phases, share))


@dataclass(frozen=True)
class Inversion:
    """Readings of n pairs of phases.

    Attributes
    ----------
    force_n, location_mm : ndarray, shape (n,)
        Posterior means; NaN where a phase is not finite.
    covariance : ndarray, shape (n, 2, 2)
        Of (force, location). It includes the phases' noise and the model's own error.
    codes : ndarray of uint8, shape (n,)
        Sums of the flags' values in ``INVERSION_FLAGS``.

    Examples
    --------
    >>> from gnuradio.wiforce.sensor import load_sensor
    >>> found = load_sensor("line-900mhz").invert([[106.6, 106.6]], 0.5)
    >>> found.force_n.round(1).tolist(), found.location_mm.round(1).tolist(), found.flags
    ([4.0], [40.0], [()])
    """

    force_n: np.ndarray
    location_mm: np.ndarray
    covariance: np.ndarray
    codes: np.ndarray

    @cached_property
    def force_std_n(self) -> np.ndarray:
        """Standard deviations of the force (N), shape (n,)."""
        return np.sqrt(self.covariance[:, 0, 0])

    @cached_property
    def location_std_mm(self) -> np.ndarray:
        """Standard deviations of the location (mm), shape (n,)."""
        return np.sqrt(self.covariance[:, 1, 1])

    @cached_property
    def flags(self) -> list[tuple[str, ...]]:
        """Flags in words, a tuple per reading.

        ``extrapolated`` (outside what was calibrated), ``ambiguous`` (another press would show the
        same phases), ``force-unobservable`` (force and location cannot be distinguished),
        ``inconsistent`` (no single press shows such phases).
        """
        return [_WORDS[code] for code in self.codes.tolist()]


class Inverter:
    """Inverts one model at one or several carriers.

    Parameters
    ----------
    carriers : tuple of int
        Indices of the model's carriers whose phases are given, in this order.

    Attributes
    ----------
    forward : ForwardMap

    Notes
    -----
    The posterior of (force, location) given the phases of a reading, integrated by
    ``lib/kernel/inversion/press_posterior.h``.
    """

    def __init__(self, model: "SensorModel", carriers: tuple[int, ...]):
        self.forward = ForwardMap(model, carriers)
        # An error of the ruler moves both phases as another location does, by the same distance.
        self._ruler_mm2 = (model.ruler_std_mm or 0.0) ** 2
        self._posterior = press_posterior(
            self.forward.force_n,
            self.forward.location_mm,
            self.forward.table(),
            model.calibrated,
            misfit_limit(self.forward.size, 1 - _CONSISTENT),
        )

    def invert(
        self,
        phases_deg: ArrayLike,
        std_deg: ArrayLike | None = None,
        location_mm: ArrayLike | None = None,
    ) -> Inversion:
        """See :meth:`SensorModel.invert`."""
        phases = np.asarray(phases_deg, float)
        if phases.ndim < 2:
            phases = np.atleast_2d(phases)
        if phases.ndim != 2 or phases.shape[1] != self.forward.size:
            rule = f"must have {self.forward.size} columns"
            raise InputError("phases_deg", rule, np.shape(phases_deg))
        std = _standard_deviations(std_deg, phases.shape)
        if location_mm is not None:
            location_mm = self._known_location(location_mm, len(phases))
        values, codes = self._posterior.invert(phases, std, location_mm)
        if location_mm is None:
            values[:, -1] += self._ruler_mm2
        return inversion_of(values, codes)

    def _known_location(self, location_mm, count):
        location = np.broadcast_to(np.asarray(location_mm, float), count)
        first, last = self.forward.location_mm[[0, -1]]
        outside = location[(location < first) | (location > last)]
        if outside.size:
            rule = f"must lie from {first:g} to {last:g} mm"
            raise InputError("location_mm", rule, float(outside[0]))
        return location

    def unobservable(self, force, location, std=1.0):
        """Whether force and location cannot be distinguished with this noise (deg); broadcast."""
        return self._posterior.unobservable(force, location, np.max(std))

    def code_of(self, force, force_std, location, location_std, std):
        """Sum of the flags of a press that was found in another way."""
        code = 0
        if self._posterior.extrapolated(force, location, force_std**2, location_std**2):
            code |= INVERSION_FLAGS["extrapolated"]
        if self.unobservable(force, location, std):
            code |= INVERSION_FLAGS["force-unobservable"]
        return code

    def systematic(self, force_n, location_mm):
        """Covariance (2, 2) of force and location that the model's own error leaves.

        It is the same at every reading of a press, however many are averaged.
        """
        at = np.array([force_n]), np.array([location_mm])
        slopes = self.forward.slopes(*at)[0]
        variance = np.maximum(self.forward.variances(*at)[0], 1e-12)
        normal = slopes.T @ (slopes / variance[:, None])
        # no more can be unknown than the domain is wide
        normal[0, 0] += 12.0 / np.ptp(self.forward.force_n) ** 2
        normal[1, 1] += 12.0 / np.ptp(self.forward.location_mm) ** 2
        covariance = np.linalg.inv(normal)
        covariance[1, 1] += self._ruler_mm2
        return covariance


def _standard_deviations(std_deg, shape):
    given = np.asarray(DEFAULT_STD_DEG if std_deg is None else std_deg, float)
    if not np.all((given >= 0) & (given < np.inf)):
        raise InputError("std_deg", "must be finite and not negative", given.tolist())
    return np.broadcast_to(given, shape)


def inversion_of(values, codes):
    """Inversion of rows (n, 6): force, location, and the rows of their covariance."""
    return Inversion(values[:, 0], values[:, 1], values[:, 2:].reshape(-1, 2, 2), codes)


def words_of(code):
    """The flags of a sum, in words."""
    return _WORDS[code]
