# SPDX-License-Identifier: GPL-3.0-or-later
"""Phases to force and location, with covariance and flags."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from ..errors import InputError
from .forward import ForwardMap
from .inversetable import (
    FORCE,
    IN_SPAN,
    JACOBIAN,
    LOCATION,
    SECOND_FORCE,
    SECOND_LOCATION,
    TRUSTED_DEG,
    VARIANCE,
    InverseTable,
)
from .profile import ProfileTable
from .search import Search

# Standard deviation of a phase of which nothing is known.
DEFAULT_STD_DEG = 1.0
# Force is hardly observable where an error of 1 deg (or of the reading's own standard deviation, if
# larger) costs this much, and knowing the location would cut it by this factor.
_UNOBSERVABLE_N, _UNOBSERVABLE_RATIO = 0.5, 2.5
# Below this part of the domain's forces a standard deviation from the slopes at the solution is
# trusted; above, the likelihood is integrated.
_LOCAL = 0.08
# So much larger a variance of the whole likelihood is taken instead of that from the slopes.
_WIDER = 1.5
# Phases fit no press when all solutions are this improbable.
_IMPROBABLE = 0.9973
# Part of the likelihood that lies where force is hidden, from which on it counts as hidden.
_MOSTLY = 0.2
# Part of it outside the calibrated span, below which the solution is not.
_RIM = 0.02
_CHUNK = 8192
# Flags as bits, and the names that each combination stands for.
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

    @cached_property
    def _table(self):
        return InverseTable(self.forward, self._model.in_span, self._profiles)

    @cached_property
    def _profiles(self):
        return ProfileTable(self.forward, self._model.in_span, self._hidden_n_per_deg)

    def prepare(self):
        """Builds the tables now, which takes a second or so, instead of at the first reading."""
        if len(self._carriers) == 1:
            _ = self._table

    def invert(self, phases_deg, std_deg=None, location_mm=None):
        """See :meth:`SensorModel.invert`."""
        phases = np.asarray(phases_deg, float)
        if phases.size == 2 and self.forward.size == 2 and location_mm is None:
            return self._single(phases.reshape(1, 2), std_deg)
        phases = np.atleast_2d(phases)
        if phases.ndim != 2 or phases.shape[1] != self.forward.size:
            rule = f"must have {self.forward.size} columns"
            raise InputError("phases_deg", rule, np.shape(phases_deg))
        std = _standard_deviations(std_deg, phases.shape)
        if location_mm is not None:
            return self._at_location(phases, std, location_mm)
        if len(self._carriers) > 1:
            return self._one_by_one(phases, std)
        return self._batch(phases, std)

    def solutions(self, phases_deg, std_deg=None):
        """All solutions for one reading, the best first: see :class:`.search.Solutions`."""
        phases = np.asarray(phases_deg, float).reshape(1, -1)
        std = _standard_deviations(std_deg, phases.shape)
        return self._search.solutions(phases[0], std[0] ** 2)

    # one carrier, many readings: the table

    def _batch(self, phases, std):
        values = np.full((len(phases), 5), np.nan)
        codes = np.zeros(len(phases), np.uint8)
        for start in range(0, len(phases), _CHUNK):
            part = slice(start, start + _CHUNK)
            left = self._batch_part(phases[part], std[part], values[part], codes[part])
            left = start + np.flatnonzero(left)
            if left.size:
                values[left], codes[left] = self._profiled(phases[left], std[left])
        return inversion_of(values, [_COMBINATIONS[code] for code in codes.tolist()])

    def _batch_part(self, phases, std, values, codes):
        """Fills ``values`` (n, 5): force, location, and their variances and covariance, and

        ``codes`` (n,); gives which readings (n,) the table does not hold.
        """
        table = self._table
        finite = np.isfinite(phases).all(axis=1)
        scaled = np.where(finite[:, None], phases, 0.0) * table.per_deg
        cell = np.floor(scaled)
        first, second = ((scaled - cell - 0.5) / table.per_deg).T
        cell = np.mod(cell, table.cells).astype(np.int64)
        cell = cell[:, 0] * table.cells + cell[:, 1]
        quick = (table.count[cell] == 1) & finite
        row = table.rows[np.where(quick, table.first[cell], 0)].T
        force = row[FORCE] + _taylor(row, first, second, JACOBIAN, SECOND_FORCE)
        location = row[LOCATION] + _taylor(row, first, second, JACOBIAN + 2, SECOND_LOCATION)
        noise = std.T**2 + row[VARIANCE : VARIANCE + 2]
        a, b, c, d = _jacobian(row, first, second)
        force_variance = a * a * noise[0] + b * b * noise[1]
        quick &= (force >= self._low) & (force <= self._high)
        quick &= (location >= self._left) & (location <= self._right)
        quick &= std.max(axis=1) <= row[TRUSTED_DEG]
        values[:, 0], values[:, 1] = force, location
        values[:, 2] = force_variance
        values[:, 3] = c * c * noise[0] + d * d * noise[1]
        values[:, 4] = a * c * noise[0] + b * d * noise[1]
        codes[self._unobservable((a, b, c, d), std.T)] |= _UNOBSERVABLE
        # look closely only where there may be a flag
        rim = np.flatnonzero(quick & (row[IN_SPAN] == 0))
        codes[rim[self._extrapolated(*values[rim, :4].T)]] |= _EXTRAPOLATED
        return ~quick

    def _profiled(self, phases, std):
        """Values (n, 5) and codes (n,) by the profile of the likelihood over force."""
        table = self._profiles
        cell, offset = table.cells(np.where(np.abs(phases) < 1e9, phases, 0.0))
        first, count, variance = table.first[cell], table.count[cell], std**2
        found = table.read(first, offset, variance)
        open_ = (found[:, 5] > self._limit) | (count == 0)
        two = np.flatnonzero(count == 2)
        other = table.read(first[two] + 1, offset[two], variance[two])
        fits = other[:, 5] <= self._limit
        turns = dict(zip(two[fits].tolist(), other[fits], strict=True))
        only = two[fits & open_[two]]
        found[only], open_[only] = other[fits & open_[two]], False
        values, codes = found[:, :5], self._codes(found)
        for i in np.flatnonzero(open_):
            values[i], codes[i] = self._searched(phases[i], std[i])
        for i in np.setdiff1d(two[fits], only):
            values[i], codes[i] = self._of_turns(np.stack([found[i], turns[i]]))
        return values, codes

    def _codes(self, found):
        """Flags of rows that a profile gave."""
        codes = _AMBIGUOUS * (found[:, 8] > 0) | _UNOBSERVABLE * (found[:, 6] > _MOSTLY)
        rim = np.flatnonzero(found[:, 7] > _RIM)
        if rim.size:
            codes[rim[self._extrapolated(*found[rim, :4].T)]] |= _EXTRAPOLATED
        return codes

    def _of_turns(self, found):
        """Values (5,) and code of one reading that fits at two turns of phase."""
        # the calibrated span decides between solutions that fit alike
        inside = self._model.in_span(found[:, 0], found[:, 1])
        rivals = found[inside] if np.any(inside) else found
        chosen = rivals[np.argmin(rivals[:, 5])].copy()
        away = rivals[:, :2] - chosen[:2]
        chosen[2:4] += np.mean(away**2, axis=0)
        chosen[4] += np.mean(away[:, 0] * away[:, 1])
        chosen[8] = max(chosen[8], len(rivals) > 1)
        return chosen[:5], self._codes(chosen[None])[0]

    def _unobservable(self, inverse, std):
        """Whether force cannot be told from location, given the inverse Jacobian's elements."""
        a, b, c, d = inverse
        spread = np.maximum(std, 1.0)
        free = a * a * spread[0] ** 2 + b * b * spread[1] ** 2
        # slopes by force are the first column of the Jacobian: (d, -c) over the determinant
        determinant = a * d - b * c
        by_force = (d / spread[0]) ** 2 + (c / spread[1]) ** 2
        known = determinant**2 / np.maximum(by_force, 1e-300)
        return (free > _UNOBSERVABLE_N**2) & (free > _UNOBSERVABLE_RATIO**2 * known)

    def _extrapolated(self, force, location, force_variance, location_variance):
        """Whether a solution lies outside the span by more than its standard deviation."""
        inside = np.asarray(self._model.in_span(force, location))
        if np.all(inside):
            return ~inside
        for a in (-1, 0, 1):
            for b in (-1, 0, 1):
                inside = inside | self._model.in_span(
                    force + a * np.sqrt(force_variance), location + b * np.sqrt(location_variance)
                )
        return ~inside

    # one carrier, one reading: the same steps without arrays

    def _single(self, phases, std_deg):
        table = self._table
        std_1, std_2 = _two_standard_deviations(std_deg)
        psi_1, psi_2 = phases[0].tolist()
        if not (abs(psi_1) < 1e9 and abs(psi_2) < 1e9):
            return inversion_of(np.full((1, 5), np.nan), [_COMBINATIONS[_INCONSISTENT]])
        per_deg, cells = table.per_deg, table.cells
        scaled_1, scaled_2 = psi_1 * per_deg, psi_2 * per_deg
        cell_1, cell_2 = int(scaled_1 // 1), int(scaled_2 // 1)
        cell = cell_1 % cells * cells + cell_2 % cells
        if table.count[cell] == 1:
            row = table.rows[table.first[cell]].tolist()
            first = (scaled_1 - cell_1 - 0.5) / per_deg
            second = (scaled_2 - cell_2 - 0.5) / per_deg
            force = row[FORCE] + _taylor(row, first, second, JACOBIAN, SECOND_FORCE)
            location = row[LOCATION] + _taylor(row, first, second, JACOBIAN + 2, SECOND_LOCATION)
            a, b, c, d = _jacobian(row, first, second)
            noise_1 = std_1 * std_1 + row[VARIANCE]
            noise_2 = std_2 * std_2 + row[VARIANCE + 1]
            variance = a * a * noise_1 + b * b * noise_2
            inside = self._low <= force <= self._high and self._left <= location <= self._right
            if inside and max(std_1, std_2) <= row[TRUSTED_DEG]:
                across = c * c * noise_1 + d * d * noise_2
                values = (force, location, variance, across, a * c * noise_1 + b * d * noise_2)
                # only a steep inverse can hide the force: most readings need no closer look
                spread = max(std_1, std_2, 1.0)
                steep = (abs(a) + abs(b)) * spread > _UNOBSERVABLE_N
                if row[IN_SPAN] and not steep:
                    return inversion_of(np.array([values]), [()])
                names = _names(
                    extrapolated=not row[IN_SPAN] and bool(self._extrapolated(*values[:4])),
                    unobservable=bool(self._unobservable((a, b, c, d), np.array([std_1, std_2]))),
                )
                return inversion_of(np.array([values]), [names])
        found = self._profiles.read_one(psi_1, psi_2, std_1 * std_1, std_2 * std_2)
        if found is None or not found[5] <= self._limit:
            values, codes = self._profiled(phases, np.array([[std_1, std_2]]))
            return inversion_of(values, [_COMBINATIONS[codes[0]]])
        names = _names(
            ambiguous=found[8] > 0,
            unobservable=found[6] > _MOSTLY,
            extrapolated=found[7] > _RIM and bool(self._extrapolated(*found[:4])),
        )
        return inversion_of(np.array([found[:5]]), [names])

    # anything else: the search

    def _one_by_one(self, phases, std):
        results = [self._searched(p, s) for p, s in zip(phases, std, strict=True)]
        values = np.array([r[0] for r in results]).reshape(-1, 5)
        return inversion_of(values, [_COMBINATIONS[r[1]] for r in results])

    def _searched(self, phases, std):
        """Force, location, variances and covariance of one reading (5,), and its flags' code."""
        if not np.all(np.isfinite(phases)):
            return np.full(5, np.nan), _INCONSISTENT
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
            | _EXTRAPOLATED * bool(self._extrapolated(*mean, covariance[0, 0], covariance[1, 1]))
        )
        values = [*mean, covariance[0, 0], covariance[1, 1], covariance[0, 1]]
        return np.array(values), code

    def hidden(self, force, location, std=1.0):
        """Whether force cannot be told from location, at the nearest nodes; broadcast."""
        free = self._hidden_n_per_deg(force, location)
        return free * max(np.max(std), 1.0) > _UNOBSERVABLE_N

    def _hidden_n_per_deg(self, force, location):
        """Newtons per degree of phase error; 0 where knowing the location gains little."""
        i = np.searchsorted(self.forward.force_n, force)
        j = np.searchsorted(self.forward.location_mm, location)
        shape = self._sensitivity.shape[1:]
        free, ratio = self._sensitivity[:, np.minimum(i, shape[0] - 1), np.minimum(j, shape[1] - 1)]
        return np.where(ratio > _UNOBSERVABLE_RATIO, free, 0.0)

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
            extrapolated=bool(self._extrapolated(force, location, force_std**2, location_std**2)),
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
        values = np.full((len(phases), 5), np.nan)
        flags = [("inconsistent",)] * len(phases)
        for place in np.unique(location[np.isfinite(location)]):
            if not self._left <= place <= self._right:
                rule = f"must lie from {self._left:g} to {self._right:g}"
                raise InputError("location_mm", rule, float(place))
            rows = np.flatnonzero((location == place) & np.isfinite(phases).all(axis=1))
            curve = self._search.at_location(place)
            for i in rows:
                values[i, 0], values[i, 2], misfit, several = curve.invert(phases[i], std[i] ** 2)
                values[i, [1, 3, 4]] = place, 0.0, 0.0
                flags[i] = _names(
                    extrapolated=bool(self._extrapolated(*values[i, :4])),
                    ambiguous=several,
                    inconsistent=misfit > self._limit,
                )
        return inversion_of(values, flags)


def _standard_deviations(std_deg, shape):
    std = np.broadcast_to(DEFAULT_STD_DEG if std_deg is None else np.asarray(std_deg, float), shape)
    if not np.all(std >= 0) or np.any(np.isinf(std)):
        raise InputError("std_deg", "must be finite and not negative", np.asarray(std_deg).tolist())
    return std


def _two_standard_deviations(std_deg):
    if isinstance(std_deg, float) and 0 <= std_deg < 1e9:
        return std_deg, std_deg
    return _standard_deviations(std_deg, (1, 2))[0].tolist()


def _jacobian(row, first, second):
    """Derivatives of force and location by the phases, off the centre of the cell."""
    f, g = SECOND_FORCE, SECOND_LOCATION
    return (
        row[JACOBIAN] + row[f] * first + row[f + 1] * second,
        row[JACOBIAN + 1] + row[f + 1] * first + row[f + 2] * second,
        row[JACOBIAN + 2] + row[g] * first + row[g + 1] * second,
        row[JACOBIAN + 3] + row[g + 1] * first + row[g + 2] * second,
    )


def _taylor(row, first, second, jacobian, bend):
    return (
        row[jacobian] * first
        + row[jacobian + 1] * second
        + 0.5 * row[bend] * first * first
        + row[bend + 1] * first * second
        + 0.5 * row[bend + 2] * second * second
    )


def _names(extrapolated=False, ambiguous=False, unobservable=False, inconsistent=False):
    names = (
        ("ambiguous", ambiguous),
        ("force-unobservable", unobservable),
        ("inconsistent", inconsistent),
        ("extrapolated", extrapolated),
    )
    return tuple(name for name, raised in names if raised)


def inversion_of(values, flags):
    """Inversion of rows (n, 5): force, location, their variances, and their covariance."""
    covariance = values[:, [2, 4, 4, 3]].reshape(-1, 2, 2)
    return Inversion(
        force_n=values[:, 0],
        force_std_n=np.sqrt(values[:, 2]),
        location_mm=values[:, 1],
        location_std_mm=np.sqrt(values[:, 3]),
        covariance=covariance,
        flags=flags,
    )
