# SPDX-License-Identifier: GPL-3.0-or-later
"""From a few calibrated locations to all of them, and how far wrong that may be.

What the contact adds to the line's own phase changes with location because the end nearer to the
press moves more: it goes over from one level to another somewhere about the middle. Where and how
sharply is not known beforehand. Each hypothesis h = (shape, fade, shift, scale) is a Gaussian
process (universal kriging) with the trend ``a + b S((l - L/2 - shift) / fade)``, mirrored for port
2, and a Matern 5/2 residual of length ``scale``. Its restricted likelihood on the calibrated
curves, times a broad prior, is its probability; the prediction is the mean over hypotheses, and its
variance that within plus that between them. C. E. Rasmussen and C. K. I. Williams, *Gaussian
Processes for Machine Learning*, 2006, sections 2.7 and 5.4.

The shapes S differ in their tails: 0 ``tanh(x)``, exponential on both sides; 1
``x / sqrt(1 + x^2)``, slow on both sides; the others hold one level up to the middle and leave it
from there: 2 exponentially with a round start, 3 exponentially at once, 4 as a Gaussian.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from ..errors import InputError

SHAPES = np.arange(5)
# Closer than what a calibration tells apart: else the one that happens to fit would be believed
# alone.
_FADES_MM = np.geomspace(5.0, 80.0, 49)
_SHIFTS_MM = np.linspace(-5.0, 15.0, 33)
_SCALES_MM = np.array([10.0, 25.0])
# Where the prior expects the change-over, and how widely: a beam of several mm thickness cannot
# change over within a few mm, nor needs it the whole line.
_FADE_PRIOR_MM, _FADE_PRIOR_LOG_STD, _SHIFT_PRIOR_STD_MM = 14.0, 0.6, 7.0
# The residual is believed to be at least of this size, relative to the change with location, with
# the weight of this many observations: no change-over has one of these shapes exactly, and what is
# no contact has none.
_LEAST_RESIDUAL, _LEAST_RESIDUAL_UNPHYSICAL, _LEAST_RESIDUAL_WEIGHT = 0.015, 0.05, 4.0
_MOST_HYPOTHESES = 64
_NUGGET = 1e-6
_STEP_MM = 0.25


def _change_over(location, hypotheses, length_mm, port):
    """S for each hypothesis; shape (H, n)."""
    shape, fade, shift = (column[:, None] for column in hypotheses.T[:3])
    from_middle = location[None, :] - length_mm / 2
    x = ((from_middle if port == 0 else -from_middle) - shift) / fade
    beyond = np.maximum(x, 0.0)
    steps = (
        np.tanh(x),
        x / np.hypot(1.0, x),
        2 * np.exp(-np.exp(np.minimum(-2 * x, 50.0))) - 1,
        1 - 2 * np.exp(-2 * beyond),
        1 - 2 * np.exp(-2 * beyond**2),
    )
    return np.choose(shape.astype(int), steps)


def _trend(location, hypotheses, length_mm, port):
    """1 and S for each hypothesis; shape (H, n, 2)."""
    step = _change_over(location, hypotheses, length_mm, port)
    return np.stack([np.ones_like(step), step], axis=-1)


def _matern(distance, scale):
    q = np.sqrt(5.0) * distance[None] / scale[:, None, None]
    return (1 + q + q * q / 3) * np.exp(-q)


def _kernel(at, scale):
    distance = np.abs(at[:, None] - at[None, :])
    return _matern(distance, scale) + _NUGGET * np.eye(at.size)


@dataclass(frozen=True)
class LocationInterpolation:
    """Weights of the calibrated locations at any location, and the variance of the result.

    Outside the calibrated span the trends go on, and the variance grows.

    Attributes
    ----------
    location_mm : ndarray, shape (J,)
    length_mm : float
    hypotheses : ndarray, shape (H, 6)
        Rows of shape, fade (mm), shift (mm), scale (mm), probability, and the residual's variance
        relative to the variance over the calibrated locations.
    """

    location_mm: np.ndarray
    length_mm: float
    hypotheses: np.ndarray

    @cached_property
    def _tables(self):
        """Splines over location, per port: mean weights, their covariance, residual variance."""
        grid = np.linspace(0.0, self.length_mm, int(np.ceil(self.length_mm / _STEP_MM)) + 1)
        probability = self.hypotheses[:, 4]
        tables = []
        for port in (0, 1):
            weights, variance = self._kriging(grid, port)
            mean = np.einsum("h,hgj->gj", probability, weights)
            spread = np.einsum("h,hgj,hgi->gji", probability, weights, weights)
            spread -= mean[:, :, None] * mean[:, None, :]
            within = np.einsum("h,h,hg->g", probability, self.hypotheses[:, 5], variance)
            tables.append([CubicSpline(grid, table) for table in (mean, spread, within)])
        return tables

    def _kriging(self, grid, port):
        """Weights (H, G, J) and unit variance (H, G) of universal kriging."""
        at, count, scale = self.location_mm, self.location_mm.size, self.hypotheses[:, 3]
        trend_at = _trend(at, self.hypotheses, self.length_mm, port)
        system = np.zeros((len(scale), count + 2, count + 2))
        system[:, :count, :count] = _kernel(at, scale)
        system[:, :count, count:] = trend_at
        system[:, count:, :count] = np.swapaxes(trend_at, 1, 2)
        right = np.concatenate(
            [
                _matern(np.abs(grid[:, None] - at[None, :]), scale),
                _trend(grid, self.hypotheses, self.length_mm, port),
            ],
            axis=-1,
        )
        try:
            solution = np.linalg.solve(system, np.swapaxes(right, 1, 2))
        except np.linalg.LinAlgError:
            rule = "must hold shapes that change between the calibrated locations"
            raise InputError("sensor: interpolation", rule) from None
        variance = 1.0 - np.einsum("hkg,hgk->hg", solution, right)
        return np.swapaxes(solution[:, :count], 1, 2), np.maximum(variance, 0.0)

    def weights(self, location_mm, port):
        """Shape (..., J)."""
        return self._tables[port][0](self._inside(location_mm))

    def variance(self, location_mm, port, values):
        """Variance of the interpolated value, from not knowing how it goes between locations.

        Parameters
        ----------
        location_mm : ndarray, shape (...)
        values : ndarray, shape (..., J)
            The values at the calibrated locations.
        """
        _, spread, within = self._tables[port]
        inside = self._inside(location_mm)
        between = np.einsum("...j,...ji,...i->...", values, spread(inside), values)
        return np.maximum(between, 0.0) + np.maximum(within(inside), 0.0) * np.var(
            values, axis=-1, ddof=1
        )

    def _inside(self, location_mm):
        return np.clip(np.asarray(location_mm, float), 0.0, self.length_mm)


def learn_interpolation(location_mm, length_mm, values, noise_variance, physical=True):
    """The hypotheses about the location dimension, weighed by the calibrated curves.

    Parameters
    ----------
    location_mm : ndarray, shape (J,)
    length_mm : float
    values : ndarray, shape (2, J, n)
        What the contact adds to the line's phase, for each port, location and a few forces.
    noise_variance : float
        Variance of these values from noise in the calibration.
    physical : bool
        False where the values cannot come from a contact (their steps are larger than a press is
        wide): then only slow trends are considered.

    Returns
    -------
    LocationInterpolation
    """
    at = np.asarray(location_mm, float)
    hypotheses, log_prior = _hypotheses(at, length_mm, physical)
    variance = max(np.mean(np.var(values, axis=1, ddof=1)), 1e-12)
    floor = max(noise_variance / variance, 1e-8)
    least = _LEAST_RESIDUAL if physical else _LEAST_RESIDUAL_UNPHYSICAL
    misfit = np.full(len(log_prior), _LEAST_RESIDUAL_WEIGHT * least**2)
    observations, log_determinant = _LEAST_RESIDUAL_WEIGHT, np.zeros(len(log_prior))
    for port in (0, 1):
        components = _components(values[port] / np.sqrt(variance), floor)
        rank = components.shape[1]
        squares, trace, determinant = _restricted(at, hypotheses, length_mm, port, components)
        misfit += squares + floor * rank * trace
        observations += rank * (at.size - 2)
        log_determinant += rank * determinant
    amplitude = misfit / observations
    log_posterior = log_prior - 0.5 * (observations * np.log(amplitude) + log_determinant)
    probability = np.exp(log_posterior - log_posterior.max())
    probability /= probability.sum()
    chosen, share = _condense(probability)
    weighed = np.column_stack([hypotheses[chosen], share, amplitude[chosen]])
    return LocationInterpolation(at, float(length_mm), weighed)


def _condense(probability):
    """A few indices and probabilities that stand for many, by systematic sampling."""
    marks = (np.arange(_MOST_HYPOTHESES) + 0.5) / _MOST_HYPOTHESES
    drawn = np.searchsorted(np.cumsum(probability), marks)
    chosen, times = np.unique(np.minimum(drawn, len(probability) - 1), return_counts=True)
    return chosen, times / _MOST_HYPOTHESES


def _hypotheses(at, length_mm, physical):
    """Shape, fade, shift and scale (H, 4) of what is considered, and log prior (H,)."""
    if not physical:
        slow = [[1.0, 4.0 * length_mm, 0.0, scale] for scale in _SCALES_MM]
        return np.array(slow), np.zeros(len(slow))
    axes = np.meshgrid(SHAPES, _FADES_MM, _SHIFTS_MM, _SCALES_MM, indexing="ij")
    hypotheses = np.column_stack([axis.ravel() for axis in axes])
    # enough of the change-over must lie among the calibrated locations to be told from a constant
    steps = [np.ptp(_change_over(at, hypotheses, length_mm, port), axis=1) for port in (0, 1)]
    seen = np.min(steps, axis=0) > 0.2 * np.minimum(2.0, np.ptp(at) / hypotheses[:, 1])
    hypotheses = hypotheses[seen]
    fade, shift = hypotheses[:, 1], hypotheses[:, 2]
    log_prior = -0.5 * (np.log(fade / _FADE_PRIOR_MM) / _FADE_PRIOR_LOG_STD) ** 2
    return hypotheses, log_prior - 0.5 * (shift / _SHIFT_PRIOR_STD_MM) ** 2


def _components(values, floor):
    """Orthogonal combinations of the forces, in units of one force, that rise above the noise."""
    left, singular, _ = np.linalg.svd(values - values.mean(axis=0), full_matrices=False)
    scaled = left * singular / np.sqrt(values.shape[1])
    strong = singular**2 / values.size > 4 * floor
    strong[0] = True
    return scaled[:, strong]


def _restricted(at, hypotheses, length_mm, port, components):
    """Restricted likelihood: generalised squares left by the trend, trace of their matrix, log

    determinant; each of shape (H,).
    """
    step = _change_over(at, hypotheses, length_mm, port)
    squares, trace, determinant = np.zeros((3, len(hypotheses)))
    for scale in np.unique(hypotheses[:, 3]):
        which = hypotheses[:, 3] == scale
        inverse = np.linalg.inv(_kernel(at, np.array([scale]))[0])
        ones, changing = inverse.sum(axis=0), step[which] @ inverse
        # of 1 with 1, 1 with S, S with S
        normal = ones.sum(), changing.sum(axis=1), np.sum(changing * step[which], axis=1)
        by_one, by_step = ones @ components, changing @ components
        squares[which] = np.sum(components * (inverse @ components)) - _explained(
            normal, by_one @ by_one, by_step @ by_one, np.sum(by_step**2, axis=1)
        )
        trace[which] = np.trace(inverse) - _explained(
            normal, ones @ ones, changing @ ones, np.sum(changing**2, axis=1)
        )
        plain = at.size * np.sum(step[which] ** 2, axis=1) - np.sum(step[which], axis=1) ** 2
        size = normal[0] * normal[2] - normal[1] ** 2
        determinant[which] = np.log(size / plain) - np.linalg.slogdet(inverse)[1]
    return np.maximum(squares, 0.0), trace, determinant


def _explained(normal, one, both, step):
    """What least squares on 1 and S explain, of the squares and the product of both projections."""
    size = normal[0] * normal[2] - normal[1] ** 2
    return (normal[2] * one - 2 * normal[1] * both + normal[0] * step) / size
