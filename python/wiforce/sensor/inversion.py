# SPDX-License-Identifier: GPL-3.0-or-later
"""Phases to force and location, with covariance and flags."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..wiforce_kernels import INVERSION_FLAGS, press_posterior
from .splines import Array, node_slopes

if TYPE_CHECKING:
    from .model import SensorModel


_FORCE_NODES = 160
_LOCATION_STEP_MM = 0.5
# How far beyond the calibration a solution is looked for. It is flagged as extrapolated.
_MARGIN_MM = 6.0
_MARGIN_FORCE = 0.25
# A short nearer to an end than this is not looked for.
_CLEAR_OF_END_MM = 1.0
# Degrees turned over all forces times those over all locations: 2.4 GHz on 80 mm have 30 000.
_MOST_TURNS_DEG2 = 500_000.0


def _check_turns(phase_deg: Array, where: str) -> None:
    """Refuses curves drawn through an error: the table of their inverse would have no end."""
    turns = [np.abs(np.diff(phase_deg, axis=a)).max(axis=(1 - a, 2)).sum() for a in (0, 1)]
    if not turns[0] * turns[1] <= _MOST_TURNS_DEG2:
        rule = "must turn less over forces and locations"
        raise InputError(where, rule, " and ".join(f"{turn:.3g} deg" for turn in turns))


# Standard deviation of a phase of which nothing is known.
DEFAULT_STD_DEG = 1.0
# Phases fit no press when their residual is larger than that of so many presses: 3 standard
# deviations of a normal variable.
_CONSISTENT = 0.9973
# The words of each sum of flags.
FLAG_WORDS = [
    tuple(word for word, flag in INVERSION_FLAGS.items() if code & flag)
    for code in range(2 * max(INVERSION_FLAGS.values()))
]


def misfit_limit(phases: int, share: float) -> float:
    """Sum of squares of so many normal variables that is exceeded in a share of all cases."""
    if phases == 2:
        return -2 * math.log(share)
    from scipy.special import chdtri  # for several carriers; slow to import

    return float(chdtri(phases, share))


@dataclass(frozen=True, eq=False)
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
        return [FLAG_WORDS[code] for code in self.codes.tolist()]


class Inverter:
    """Inverts one model at some carriers, by ``lib/kernel/inversion/press_posterior.h``.

    Solutions are looked for among rising ``force_n`` and ``location_mm``, the nodes of its table of
    the P phases, two per carrier. A model whose phases are not finite, or turn on and on, is
    refused.
    """

    def __init__(self, model: SensorModel, carriers: tuple[int, ...]) -> None:
        low, high = model.force_span_n
        first, last = model.location_span_mm
        top = high + _MARGIN_FORCE * (high - low)
        self.force_n = np.geomspace(model.onset_force_n, top, _FORCE_NODES)
        start = max(first - _MARGIN_MM, _CLEAR_OF_END_MM)
        stop = min(last + _MARGIN_MM, model.length_mm - _CLEAR_OF_END_MM)
        count = int(np.ceil((stop - start) / _LOCATION_STEP_MM)) + 1
        self.location_mm = np.linspace(start, stop, count)
        # Broadcast, so that the curves over force are evaluated once for all locations.
        grid, shape = (self.force_n[:, None], self.location_mm[None]), (_FORCE_NODES, count, 2)
        phase, std = (
            np.concatenate([np.broadcast_to(of(*grid, c), shape) for c in carriers], axis=-1)
            for of in (model.short_deg, model.carrier_std_deg)
        )
        _check_turns(phase, f"sensor {model.name}: phases")
        self.size = phase.shape[-1]
        # An error of the ruler moves both phases as another location does, by the same distance.
        self.ruler_mm2 = (model.ruler_std_mm or 0.0) ** 2
        by_force = np.tensordot(node_slopes(np.log(self.force_n)), phase, 1)
        across = node_slopes(self.location_mm)
        by_location, by_both = (across @ values for values in (phase, by_force))
        self.posterior = press_posterior(
            self.force_n,
            self.location_mm,
            np.stack([phase, by_force, by_location, by_both, std**2], axis=-1),
            model.calibrated,
            misfit_limit(self.size, 1 - _CONSISTENT),
        )

    def at(self, force_n: ArrayLike, location_mm: ArrayLike) -> Array:
        """Phases, their slopes by force and location, and variances, (4, ..., P), not wrapped.

        Of presses brought into the domain.
        """
        force, location = np.broadcast_arrays(
            np.clip(force_n, *self.force_n[[0, -1]]),
            np.clip(location_mm, *self.location_mm[[0, -1]]),
        )
        found = self.posterior.model_at(force.ravel(), location.ravel())
        return np.moveaxis(found, 1, 0).reshape(4, *force.shape, self.size)

    def covariance(
        self, force_n: ArrayLike, location_mm: ArrayLike, variance_deg2: ArrayLike | None = None
    ) -> Array:
        """Covariances (..., 2, 2) of force and location by errors of the phases (..., P).

        By those of the model, which no average lowers, where none are given.
        """
        _, *slopes, variance = self.at(force_n, location_mm)
        variance = np.maximum(variance if variance_deg2 is None else variance_deg2, 1e-12)
        normal = np.einsum("a...p,b...p,...p->...ab", slopes, slopes, 1 / variance)
        # No more can be unknown than the domain is wide: the prior is uniform.
        normal[..., 0, 0] += 12.0 / np.ptp(self.force_n) ** 2
        normal[..., 1, 1] += 12.0 / np.ptp(self.location_mm) ** 2
        covariance: Array = np.linalg.inv(normal)
        covariance[..., 1, 1] += self.ruler_mm2
        return covariance

    def invert(
        self,
        phases_deg: ArrayLike,
        std_deg: ArrayLike | None = None,
        location_mm: ArrayLike | None = None,
    ) -> Inversion:
        """See :meth:`SensorModel.invert`."""
        phases = np.atleast_2d(np.asarray(phases_deg, float))
        if phases.ndim != 2 or phases.shape[1] != self.size:
            rule = f"must have {self.size} columns"
            raise InputError("phases_deg", rule, np.shape(phases_deg))
        std = standard_deviations(std_deg, phases.shape)
        given = np.nan if location_mm is None else np.asarray(location_mm, float)
        location = np.broadcast_to(given, len(phases))
        first, last = self.location_mm[[0, -1]]
        outside = location[(location < first) | (location > last)]
        if outside.size:
            rule = f"must lie from {first:g} to {last:g} mm"
            raise InputError("location_mm", rule, float(outside[0]))
        known = ~np.isnan(location)
        values, codes = np.empty((len(phases), 6)), np.empty(len(phases), np.uint8)
        for rows, at in ((known, location[known]), (~known, None)):
            values[rows], codes[rows] = self.posterior.invert(phases[rows], std[rows], at)
        values[~known, -1] += self.ruler_mm2
        return inversion_of(values, codes)

    def code_of(
        self, force: float, force_std: float, location: float, location_std: float, std: Array
    ) -> int:
        """Sum of the flags of a press that was found in another way."""
        code = 0
        if self.posterior.extrapolated(force, location, force_std**2, location_std**2):
            code |= INVERSION_FLAGS["extrapolated"]
        if self.posterior.unobservable(force, location, np.max(std)):
            code |= INVERSION_FLAGS["force-unobservable"]
        return code


def standard_deviations(std_deg: ArrayLike | None, shape: tuple[int, ...]) -> Array:
    """Standard deviations of phases, checked and broadcast to their shape; 1 deg by default."""
    given = np.asarray(DEFAULT_STD_DEG if std_deg is None else std_deg, float)
    if not np.all((given >= 0) & (given < np.inf)):
        raise InputError("std_deg", "must be finite and not negative", given.tolist())
    return np.broadcast_to(given, shape)


def inversion_of(values: Array, codes: Array) -> Inversion:
    """Inversion of rows (n, 6): force, location, and the rows of their covariance."""
    return Inversion(values[:, 0], values[:, 1], values[:, 2:].reshape(-1, 2, 2), codes)
