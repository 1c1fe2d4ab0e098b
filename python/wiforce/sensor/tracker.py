# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of one sensor over time, filtered and smoothed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..signal.carrier import wrap_deg
from ..wiforce_kernels import INVERSION_FLAGS
from .inversion import (
    FLAG_WORDS,
    Inversion,
    Inverter,
    inversion_of,
    misfit_limit,
    standard_deviations,
)
from .splines import Array

if TYPE_CHECKING:
    from .model import SensorModel

# Degrees of freedom of the phase noise: published readings scatter so.
NOISE_FREEDOM = 4.0

_FINE_POINTS = 61
_HALF_WIDTHS = 6.0
_CLOSE_IN = 2.0
_FINEST_MM = 1e-3
_ITERATIONS = 4
_SETTLED_N = 0.01
# Force, its standard deviation, location, its own, and flags.
Reported = tuple[float, float, float, float, tuple[str, ...]]


class FilterBank:
    """A filter of the force at each of M locations, with the log weight of the location."""

    def __init__(
        self, inverter: Inverter, location_mm: Array, start_n: float, start_std_n: float
    ) -> None:
        self._inverter, self.location_mm = inverter, location_mm
        middle_n = np.sqrt(inverter.force_n[0] * inverter.force_n[-1])
        _, _, slope, variance = inverter.at(middle_n, location_mm)
        # what the model errs by, and what a location between two of the grid would
        self._model_variance = variance + (slope * np.gradient(location_mm)[:, None]) ** 2 / 12
        self.mean = np.full(len(location_mm), float(start_n))
        self.variance = np.full(len(location_mm), float(start_std_n) ** 2)
        self.log_weight = np.zeros(len(location_mm))

    def walk(self, variance: float) -> None:
        """Lets the force change by a random step of this variance (N^2)."""
        self.variance = self.variance + variance

    def update(self, phases_deg: Array, std_deg: Array) -> float:
        """Take phases (P,), modulo 360, and noise; least squared residual of a location."""
        low, high = self._inverter.force_n[[0, -1]]
        noise = std_deg**2 + self._model_variance
        freedom = NOISE_FREEDOM + len(phases_deg)
        force = np.clip(self.mean, low, high)
        for _ in range(_ITERATIONS):
            expected, slope, *_ = self._inverter.at(force, self.location_mm)
            # linearised at ``force``, seen from the prior mean
            error = wrap_deg(phases_deg - expected - slope * (self.mean - force)[:, None])
            weighted = slope / noise
            information = self.variance * np.sum(weighted * slope, axis=1)
            gradient = np.sum(weighted * error, axis=1)
            # the innovation's length, by the matrix inversion lemma
            distance = np.sum(error**2 / noise, axis=1)
            distance -= self.variance * gradient**2 / (1 + information)
            # an outlier's noise counts for more: the Student-t as a scaled normal
            scale = np.maximum((NOISE_FREEDOM + distance) / freedom, 1.0)
            variance = self.variance / (1 + information / scale)
            settled = np.clip(self.mean + variance * gradient / scale, low, high)
            moved = np.max(np.abs(settled - force))
            force = settled
            if moved < _SETTLED_N:
                break
        self.log_weight -= 0.5 * (np.sum(np.log(noise), axis=1) + np.log1p(information))
        self.log_weight -= 0.5 * freedom * np.log1p(distance / NOISE_FREEDOM)
        self.log_weight -= self.log_weight.max()
        self.mean, self.variance = force, variance
        return float(np.min(distance))

    def weights(self) -> Array:
        """Probability of each location (M,)."""
        weight = np.exp(self.log_weight)
        return weight / weight.sum()

    def place(self) -> tuple[float, float]:
        """Mean (mm) and variance (mm^2) of the location; any between two nodes is as likely."""
        location, weight = self.location_mm, self.weights()
        mean = weight @ location
        variance = weight @ (location - mean) ** 2 + np.min(np.diff(location)) ** 2 / 12
        return float(mean), float(variance)

    def about_place(self, first: float, last: float) -> Array:
        """A fine grid about the location, within these ends."""
        mean, variance = self.place()
        half = _HALF_WIDTHS * np.sqrt(variance)
        return np.linspace(max(mean - half, first), min(mean + half, last), _FINE_POINTS)

    def close_in(self) -> FilterBank:
        """A bank on a finer grid where the location is known better than the grid is wide."""
        location = self.location_mm
        spacing = np.min(np.diff(location))
        if np.sqrt(self.place()[1]) > _CLOSE_IN * spacing or spacing <= _FINEST_MM:
            return self
        finer = self.about_place(location[0], location[-1])
        if finer[1] - finer[0] >= spacing:
            return self
        bank = FilterBank(self._inverter, finer, 0.0, 1.0)
        bank.mean = np.interp(finer, location, self.mean)
        bank.variance = np.interp(finer, location, self.variance)
        bank.log_weight = _parabolas(location, self.log_weight, finer)
        return bank


def _parabolas(at: Array, values: Array, new: Array) -> Array:
    """Through the three nearest nodes: log weights are close to parabolas."""
    middle = np.clip(np.searchsorted(at, new - 0.5 * (at[1] - at[0])), 1, len(at) - 2)
    x = (new - at[middle]) / (at[1] - at[0])
    before, centre, behind = values[middle - 1], values[middle], values[middle + 1]
    result = centre + 0.5 * (behind - before) * x + 0.5 * (before - 2 * centre + behind) * x * x
    return result - result.max()


# Force's random walk, N per root of a second.
FORCE_WALK_N = 4.0
# A press starts this far above the onset, give or take the same.
START_ABOVE_ONSET_N = 1.1

_COARSE_MM = 0.5
# After so many readings in a row that no location explains, the press is taken for a new one.
_LOST_AFTER = 3
_LOST = 0.99999
_TWO_PLACES_MM = 6.0


class PressTracker:
    """Follows one sensor's presses reading by reading, at all carriers unless one is given.

    ``force_walk_n`` is the force's change in 1 s; a press begins 1.1 N above the onset, give or
    take.
    """

    def __init__(
        self,
        model: SensorModel,
        group_period_s: float,
        frequency_hz: float | None = None,
        force_walk_n: float = FORCE_WALK_N,
    ) -> None:
        settings = ("group_period_s", group_period_s), ("force_walk_n", force_walk_n)
        for name, value in settings:
            if not (np.isfinite(value) and value > 0):
                raise InputError(name, "must be positive", value)
        self._inverter = model.inverter(frequency_hz)
        self._walk = force_walk_n**2 * group_period_s
        self._start_n = model.onset_force_n + START_ABOVE_ONSET_N
        self._limit = misfit_limit(self._inverter.size, 1 - _LOST)
        self._bank: FilterBank | None = None  # of the press that is followed
        self._lost = 0
        first, last = self._inverter.location_mm[[0, -1]]
        count = int(np.ceil((last - first) / _COARSE_MM)) + 1
        self._coarse = np.linspace(first, last, count)

    def reset(self) -> None:
        """Forgets the press."""
        self._bank, self._lost = None, 0

    def update(self, phases_deg: ArrayLike, std_deg: ArrayLike, touched: bool = True) -> Reported:
        """Force, std, location, std and flags of phases (2,) or (2 C,); NaN if untouched."""
        if not touched:
            self.reset()
            return np.nan, np.nan, np.nan, np.nan, ()
        phases, std = self._checked(phases_deg, std_deg)
        if self._bank is None:
            bank = self._new_bank(self._coarse)
        else:
            bank = self._bank
            bank.walk(self._walk)
        lost = False
        if np.all(np.isfinite(phases)):
            lost = bank.update(phases, std) > self._limit
            self._lost = self._lost + 1 if lost else 0
            if self._lost >= _LOST_AFTER:
                # another press has begun, or this one slides
                bank, self._lost = self._new_bank(self._coarse), 0
                bank.update(phases, std)
            bank = bank.close_in()
        self._bank = bank
        return self._report(bank, std, lost)

    def _new_bank(self, location_mm: Array) -> FilterBank:
        return FilterBank(self._inverter, location_mm, self._start_n, START_ABOVE_ONSET_N)

    def _checked(self, phases_deg: ArrayLike, std_deg: ArrayLike) -> tuple[Array, Array]:
        phases = np.asarray(phases_deg, float)
        if phases.shape != (self._inverter.size,):
            rule = f"must have shape ({self._inverter.size},)"
            raise InputError("phases_deg", rule, phases.shape)
        return phases, standard_deviations(std_deg, phases.shape)

    def _report(self, bank: FilterBank, std: Array, lost: bool) -> Reported:
        weight = bank.weights()
        force = float(weight @ bank.mean)
        variance = weight @ (bank.variance + (bank.mean - force) ** 2)
        place, spread = bank.place()
        systematic = self._inverter.covariance(force, place)
        variance, spread = variance + systematic[0, 0], spread + systematic[1, 1]
        values = (force, float(np.sqrt(variance)), place, float(np.sqrt(spread)))
        code = self._inverter.code_of(*values, std)
        if lost:
            code |= INVERSION_FLAGS["inconsistent"]
        if _two_places(bank.location_mm, weight):
            code |= INVERSION_FLAGS["ambiguous"]
        return (*values, FLAG_WORDS[code])

    def smooth(self, phases_deg: ArrayLike, std_deg: ArrayLike) -> Inversion:
        """Force over a press and its location, by all readings (n, 2) or (n, 2 C) of it together.

        Followed to its end and once more from there: Rauch-Tung-Striebel per location, then the
        mixture of all.
        """
        phases = np.atleast_2d(np.asarray(phases_deg, float))
        if not phases.size:
            raise InputError("phases_deg", "must hold a reading or more", phases.shape)
        std = np.broadcast_to(np.asarray(std_deg, float), phases.shape)
        self.reset()
        for reading, noise in zip(phases, std, strict=True):
            self.update(reading, noise)
        assert self._bank is not None
        ends = self._inverter.location_mm[[0, -1]]
        bank = self._new_bank(self._bank.about_place(*ends))
        history = []
        for i, (reading, noise) in enumerate(zip(phases, std, strict=True)):
            if i:
                bank.walk(self._walk)
            before = bank.variance
            if np.all(np.isfinite(reading)):
                bank.update(reading, noise)
            history.append((before, bank.mean, bank.variance))
        weight, location = bank.weights(), bank.location_mm
        place, spread = bank.place()
        _, mean, variance = history[-1]
        smoothed = [(mean, variance)]
        for (_, own_mean, own), (before, *_) in zip(history[-2::-1], history[:0:-1], strict=True):
            gain = own / before
            mean = own_mean + gain * (mean - own_mean)
            variance = own + gain**2 * (variance - before)
            smoothed.append((mean, variance))
        means, variances = np.swapaxes(smoothed[::-1], 0, 1)
        force = means @ weight
        away = means - force[:, None]
        covariance = self._inverter.covariance(force, place)
        covariance[:, 0, 0] += (variances + away**2) @ weight
        covariance[:, 1, 1] += spread
        covariance[:, [0, 1], [1, 0]] += (away @ (weight * (location - place)))[:, None]
        values = np.column_stack([force, np.full(len(force), place), covariance.reshape(-1, 4)])
        found = inversion_of(values, np.zeros(len(force), np.uint8))
        rows = zip(force, found.force_std_n, found.location_std_mm, std, strict=True)
        for i, (each, force_std, place_std, noise) in enumerate(rows):
            found.codes[i] = self._inverter.code_of(each, force_std, place, place_std, noise)
        return found


def _two_places(location: Array, weight: Array) -> bool:
    """Whether the location may be at two places with little in between."""
    heavy = location[weight > 0.1 * weight.max()]
    return bool(np.max(np.diff(heavy), initial=0.0) > _TWO_PLACES_MM)
