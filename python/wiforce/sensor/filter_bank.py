# SPDX-License-Identifier: GPL-3.0-or-later
"""A press at every location of a grid, each with a Kalman filter of its force.

The evidence of a filter weighs its location (a Rao-Blackwellised grid filter). Phase noise is
Student-t. The grid closes in as the location becomes known.
"""

import numpy as np

from ..signal.carrier import wrap_deg

# Degrees of freedom of the phase noise: published readings scatter so.
NOISE_FREEDOM = 4.0

_FINE_POINTS = 61
_HALF_WIDTHS = 6.0
_CLOSE_IN = 2.0
_FINEST_MM = 1e-3
_FORCE_NODES = 400
_ITERATIONS = 4
_SETTLED_N = 0.01


class _PhaseCurves:
    """Phases over force at each location of a grid, for quick look-up; linear between nodes."""

    def __init__(self, forward, location_mm):
        self.location_mm = location_mm
        self._log = np.linspace(
            np.log(forward.force_n[0]), np.log(forward.force_n[-1]), _FORCE_NODES
        )
        self._step = self._log[1] - self._log[0]
        from scipy.interpolate import RectBivariateSpline  # for tracked presses only

        logs = np.log(forward.force_n)
        self._phase = np.stack(
            [
                RectBivariateSpline(logs, forward.location_mm, plane, s=0)(self._log, location_mm)
                for plane in np.moveaxis(forward.phase_deg, -1, 0)
            ],
            axis=-1,
        )
        self._columns = np.arange(len(location_mm))
        middle = np.full(len(location_mm), np.sqrt(forward.force_n[0] * forward.force_n[-1]))
        slope = np.gradient(self._phase[_FORCE_NODES // 2], location_mm, axis=0)
        # what the model errs by, and what a location between two of the grid would
        self.variance = forward.variances(middle, location_mm)
        self.variance += (slope * np.gradient(location_mm)[:, None]) ** 2 / 12

    def __call__(self, force_n):
        """Phases and their slopes by force at one force per location; each (M, P)."""
        place = (np.log(force_n) - self._log[0]) / self._step
        node = np.clip(place.astype(int), 0, _FORCE_NODES - 2)
        low = self._phase[node, self._columns]
        rise = self._phase[node + 1, self._columns] - low
        slope = rise / (self._step * force_n)[:, None]
        return low + rise * (place - node)[:, None], slope


class FilterBank:
    """One filter of the force per location.

    Parameters
    ----------
    forward : ForwardMap
    location_mm : ndarray, shape (M,)
        Rising, equally spaced.
    start_n, start_std_n : float
        Force before the first reading and its standard deviation.

    Attributes
    ----------
    mean, variance : ndarray, shape (M,)
        Of the force, N and N^2.
    log_weight : ndarray, shape (M,)
        Of the location; 0 at the likeliest.
    """

    def __init__(self, forward, location_mm, start_n, start_std_n):
        self._forward = forward
        self.curves = _PhaseCurves(forward, location_mm)
        self.mean = np.full(len(location_mm), float(start_n))
        self.variance = np.full(len(location_mm), float(start_std_n) ** 2)
        self.log_weight = np.zeros(len(location_mm))

    def walk(self, variance):
        """Lets the force change by a random step of this variance (N^2)."""
        self.variance = self.variance + variance

    def update(self, phases_deg, std_deg):
        """Takes one reading; gives how badly the best location explains it (squared, whitened).

        Parameters
        ----------
        phases_deg, std_deg : ndarray, shape (P,)
            Phases of both ends at each carrier, modulo 360, and their noise.
        """
        low, high = self._forward.force_n[[0, -1]]
        noise = std_deg**2 + self.curves.variance
        freedom = NOISE_FREEDOM + len(phases_deg)
        force = np.clip(self.mean, low, high)
        for _ in range(_ITERATIONS):
            expected, slope = self.curves(force)
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

    def weights(self):
        """Probability of each location (M,)."""
        weight = np.exp(self.log_weight)
        return weight / weight.sum()

    def place(self):
        """Mean (mm) and variance (mm^2) of the location; any between two nodes is as likely."""
        location, weight = self.curves.location_mm, self.weights()
        mean = weight @ location
        return mean, weight @ (location - mean) ** 2 + np.min(np.diff(location)) ** 2 / 12

    def about_place(self, first, last):
        """A fine grid about the location, within these ends."""
        mean, variance = self.place()
        half = _HALF_WIDTHS * np.sqrt(variance)
        return np.linspace(max(mean - half, first), min(mean + half, last), _FINE_POINTS)

    def close_in(self):
        """A bank on a finer grid where the location is known better than the grid is wide."""
        location = self.curves.location_mm
        spacing = np.min(np.diff(location))
        if np.sqrt(self.place()[1]) > _CLOSE_IN * spacing or spacing <= _FINEST_MM:
            return self
        finer = self.about_place(location[0], location[-1])
        if finer[1] - finer[0] >= spacing:
            return self
        bank = FilterBank(self._forward, finer, 0.0, 1.0)
        bank.mean = np.interp(finer, location, self.mean)
        bank.variance = np.interp(finer, location, self.variance)
        bank.log_weight = _parabolas(location, self.log_weight, finer)
        return bank


def _parabolas(at, values, new):
    """Through the three nearest nodes: log weights are close to parabolas."""
    middle = np.clip(np.searchsorted(at, new - 0.5 * (at[1] - at[0])), 1, len(at) - 2)
    x = (new - at[middle]) / (at[1] - at[0])
    before, centre, behind = values[middle - 1], values[middle], values[middle + 1]
    result = centre + 0.5 * (behind - before) * x + 0.5 * (before - 2 * centre + behind) * x * x
    return result - result.max()
