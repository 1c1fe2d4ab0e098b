# SPDX-License-Identifier: GPL-3.0-or-later
"""Phases to force and location, with covariance and flags."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from ..errors import InputError
from ..wiforce_kernels import HIDDEN_N, HIDDEN_RATIO, calibrated_span, phase_inverter
from .forward import ForwardMap
from .inversetable import InverseTable
from .profile import tabulate
from .search import Search

# Standard deviation of a phase of which nothing is known.
DEFAULT_STD_DEG = 1.0
# Below this part of the domain's forces a standard deviation from the slopes at the solution is
# trusted; above, the likelihood is integrated.
_LOCAL = 0.08
# So much larger a variance of the whole likelihood is taken instead of that from the slopes.
_WIDER = 1.5
# Phases fit no press when all solutions are this improbable.
_IMPROBABLE = 0.9973
# Part of the likelihood that lies where force is hidden, from which on it counts as hidden.
_MOSTLY = 0.2
# Flags as bits (those of lib/kernel/inversion/phase_inverter.h), and the names of each combination.
_AMBIGUOUS, _UNOBSERVABLE, _INCONSISTENT, _EXTRAPOLATED = 1, 2, 4, 8
_NAMES = ("ambiguous", "force-unobservable", "inconsistent", "extrapolated")
_COMBINATIONS = [
    tuple(name for bit, name in enumerate(_NAMES) if code >> bit & 1) for code in range(16)
]


@dataclass(frozen=True)
class Inversion:
    """Readings of n pairs of phases.

    Attributes
    ----------
    force_n, force_std_n, location_mm, location_std_mm : ndarray, shape (n,)
        NaN where a phase is not finite. Standard deviations hold the phases' noise and the model's
        own error.
    covariance : ndarray, shape (n, 2, 2)
        Of (force, location).
    flags : list of tuple of str
        ``extrapolated`` (outside what was calibrated), ``ambiguous`` (another press would show the
        same phases), ``force-unobservable`` (force and location cannot be told apart),
        ``inconsistent`` (no single press shows such phases).
    """

    force_n: np.ndarray
    force_std_n: np.ndarray
    location_mm: np.ndarray
    location_std_mm: np.ndarray
    covariance: np.ndarray
    flags: list


class Inverter:
    """Inverts one model at one or several carriers; tables are built at the first use.

    Parameters
    ----------
    model : SensorModel
    carriers : tuple of int
        Indices of the model's carriers whose phases are given, in this order.

    Attributes
    ----------
    forward : ForwardMap
    """

    def __init__(self, model, carriers):
        self._model = model
        self._carriers = carriers
        self.forward = ForwardMap(model, carriers)
        self._search = Search(self.forward)
        self._limit = chi2.ppf(_IMPROBABLE, self.forward.size)
        self._local_n = _LOCAL * np.ptp(self.forward.force_n)
        self._low, self._high = self.forward.force_n[[0, -1]]
        self._left, self._right = self.forward.location_mm[[0, -1]]
        self._span = calibrated_span(*model.calibrated)

    @cached_property
    def _tables(self):
        profile = tabulate(self.forward, self._model.in_span, self._hidden_n_per_deg)
        table = InverseTable(self.forward, self._model.in_span, profile)
        domain = (self._low, self._high), (self._left, self._right)
        return phase_inverter(table.rows, table.row_of, profile, self._span, *domain, self._limit)

    def prepare(self):
        """Builds the tables now, which takes a second or so, instead of at the first reading."""
        if len(self._carriers) == 1:
            _ = self._tables

    def invert(self, phases_deg, std_deg=None, location_mm=None):
        """See :meth:`SensorModel.invert`."""
        phases = np.asarray(phases_deg, float)
        if phases.ndim < 2:
            phases = np.atleast_2d(phases)
        if phases.ndim != 2 or phases.shape[1] != self.forward.size:
            rule = f"must have {self.forward.size} columns"
            raise InputError("phases_deg", rule, np.shape(phases_deg))
        std = _standard_deviations(std_deg, phases.shape)
        if location_mm is not None:
            return self._at_location(phases, std, location_mm)
        if len(self._carriers) > 1:
            return self._one_by_one(phases, std)
        return self._tabled(phases, std)

    def solutions(self, phases_deg, std_deg=None):
        """All solutions for one reading, the best first: see :class:`.search.Solutions`."""
        phases = np.asarray(phases_deg, float).reshape(1, -1)
        std = _standard_deviations(std_deg, phases.shape)
        return self._search.solutions(phases[0], std[0] ** 2)

    # one carrier: the tables

    def _tabled(self, phases, std):
        values, codes, unknown = self._tables.invert(phases, std)
        for i in unknown:
            values[i], codes[i] = self._searched(phases[i], std[i])
        return inversion_of(values, [_COMBINATIONS[code] for code in codes.tolist()])

    # anything else: the search

    def _one_by_one(self, phases, std):
        results = [self._searched(p, s) for p, s in zip(phases, std, strict=True)]
        values = np.array([r[0] for r in results]).reshape(-1, 6)
        return inversion_of(values, [_COMBINATIONS[r[1]] for r in results])

    def _searched(self, phases, std):
        """Force, location and their covariance of one reading (6,), and its flags' code."""
        if not np.all(np.isfinite(phases)):
            return np.full(6, np.nan), _INCONSISTENT
        variance = std**2
        found = self._search.solutions(phases, variance)
        inside = self._model.in_span(found.force_n, found.location_mm)
        # the calibrated span decides between solutions that fit alike
        fits = found.misfit <= self._limit
        chosen = int(np.argmax(inside & fits)) if np.any(inside & fits) else 0
        rivals = (inside | ~inside[chosen]) & fits
        mean = np.array([found.force_n[chosen], found.location_mm[chosen]])
        covariance = found.covariance[chosen]
        inconsistent = found.misfit[chosen] > self._limit
        unobservable = self.hidden(*mean, std)
        if not inconsistent:
            whole = self._search.moments(phases, variance)
            # slopes at the solution say little of a likelihood that is wide or has a long tail
            if whole[1][0, 0] > max(self._local_n**2, _WIDER * covariance[0, 0]):
                mean, covariance, points, likelihood = whole
                unobservable = likelihood @ self.hidden(*points.T, std) > _MOSTLY
        ambiguous = np.count_nonzero(rivals) > 1
        if ambiguous:
            away = np.column_stack([found.force_n, found.location_mm])[rivals] - mean
            covariance = covariance + away.T @ away / len(away)
        if inconsistent:
            covariance = covariance * found.misfit[chosen] / self._limit
        code = (
            _AMBIGUOUS * bool(ambiguous)
            | _UNOBSERVABLE * bool(unobservable)
            | _INCONSISTENT * bool(inconsistent)
            | _EXTRAPOLATED * self._extrapolated(*mean, covariance[0, 0], covariance[1, 1])
        )
        return np.array([*mean, *covariance.ravel()]), code

    def _extrapolated(self, force, location, force_variance, location_variance):
        """Whether a solution lies outside the span by more than its standard deviation."""
        return self._span.extrapolated(force, location, force_variance, location_variance)

    def hidden(self, force, location, std=1.0):
        """Whether force cannot be told from location, at the nearest nodes; broadcast."""
        free = self._hidden_n_per_deg(force, location)
        return free * max(np.max(std), 1.0) > HIDDEN_N

    def _hidden_n_per_deg(self, force, location):
        """Newtons per degree of phase error; 0 where knowing the location gains little."""
        i = np.searchsorted(self.forward.force_n, force)
        j = np.searchsorted(self.forward.location_mm, location)
        shape = self._sensitivity.shape[1:]
        free, ratio = self._sensitivity[:, np.minimum(i, shape[0] - 1), np.minimum(j, shape[1] - 1)]
        return np.where(ratio > HIDDEN_RATIO, free, 0.0)

    @cached_property
    def _sensitivity(self):
        """At the forward map's nodes: newtons per degree of phase error, and by what factor a known

        location would cut that; shape (2, forces, locations).
        """
        grid = np.meshgrid(self.forward.force_n, self.forward.location_mm, indexing="ij")
        slopes = self.forward.slopes(grid[0].ravel(), grid[1].ravel())
        normal = np.einsum("npa,npb->nab", slopes, slopes)
        determinant = np.maximum(np.linalg.det(normal), 1e-300)
        free = np.sqrt(normal[:, 1, 1] / determinant)
        ratio = free * np.sqrt(normal[:, 0, 0])
        return np.stack([free, ratio]).reshape(2, *grid[0].shape)

    def flags_at(self, found, std, ambiguous, inconsistent):
        """Flags of a (force, its std, location, its std) that was found in another way."""
        force, force_std, location, location_std = found
        return _names(
            extrapolated=self._extrapolated(force, location, force_std**2, location_std**2),
            ambiguous=ambiguous,
            unobservable=bool(self.hidden(force, location, std)),
            inconsistent=inconsistent,
        )

    def systematic(self, force_n, location_mm):
        """Covariance (2, 2) of force and location that the model's own error leaves.

        It is the same at every reading of a press, however many are averaged.
        """
        at = np.array([force_n]), np.array([location_mm])
        slopes = self.forward.slopes(*at)[0]
        variance = np.maximum(self.forward.variances(*at)[0], 1e-12)
        normal = slopes.T @ (slopes / variance[:, None])
        # no more can be unknown than the domain is wide
        normal[0, 0] += 12.0 / (self._high - self._low) ** 2
        normal[1, 1] += 12.0 / (self._right - self._left) ** 2
        return np.linalg.inv(normal)

    # location known

    def _at_location(self, phases, std, location_mm):
        location = np.broadcast_to(np.asarray(location_mm, float), len(phases))
        values = np.full((len(phases), 6), np.nan)
        flags = [("inconsistent",)] * len(phases)
        for place in np.unique(location[np.isfinite(location)]):
            if not self._left <= place <= self._right:
                rule = f"must lie from {self._left:g} to {self._right:g}"
                raise InputError("location_mm", rule, float(place))
            rows = np.flatnonzero((location == place) & np.isfinite(phases).all(axis=1))
            curve = self._search.at_location(place)
            for i in rows:
                force, variance, misfit, several = curve.invert(phases[i], std[i] ** 2)
                values[i] = force, place, variance, 0.0, 0.0, 0.0
                flags[i] = _names(
                    extrapolated=self._extrapolated(force, place, variance, 0.0),
                    ambiguous=several,
                    inconsistent=misfit > self._limit,
                )
        return inversion_of(values, flags)


def _standard_deviations(std_deg, shape):
    given = np.asarray(DEFAULT_STD_DEG if std_deg is None else std_deg, float)
    few = given.size <= 2  # one reading must not wait for numpy
    if not (all(map(_is_std, given.flat)) if few else np.all(_is_std(given))):
        raise InputError("std_deg", "must be finite and not negative", given.tolist())
    std = np.empty(shape)
    std[...] = given
    return std


def _is_std(value):
    return (value >= 0) & (value < np.inf)


def _names(extrapolated=False, ambiguous=False, unobservable=False, inconsistent=False):
    names = (
        ("ambiguous", ambiguous),
        ("force-unobservable", unobservable),
        ("inconsistent", inconsistent),
        ("extrapolated", extrapolated),
    )
    return tuple(name for name, raised in names if raised)


def inversion_of(values, flags):
    """Inversion of rows (n, 6): force, location, and the rows of their covariance."""
    return Inversion(
        force_n=values[:, 0],
        force_std_n=np.sqrt(values[:, 2]),
        location_mm=values[:, 1],
        location_std_mm=np.sqrt(values[:, 5]),
        covariance=values[:, 2:].reshape(-1, 2, 2),
        flags=flags,
    )
