# SPDX-License-Identifier: GPL-3.0-or-later
"""From a few calibrated locations to all of them, and the variance that this leaves.

What the contact adds to the line's own phase changes with location because the end nearer to the
press moves more: it passes from one level to another somewhere about the middle. Where and how
sharply is not known beforehand. Each :class:`Transition` is a Gaussian process (universal kriging)
with the trend ``a + b S((l - L/2 - shift) / fade)``, mirrored for port 2, and a Matern 5/2
residual. Its restricted likelihood given the calibrated curves, times a broad prior, is its
probability; the prediction is the mean over all transitions, its variance that within plus that
between them. C. E. Rasmussen and C. K. I. Williams, *Gaussian Processes for Machine Learning*,
2006, sections 2.7 and 5.4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..io.text.schema import declared, key
from ..io.text.values import LARGEST, Choice, Number
from .line import LEAST
from .splines import Array, CubicSpline, node_slopes

# The shapes S differ in their tails: exponential on both sides, slow on both sides, or one level up
# to the middle that is left from there: exponentially with a round start, exponentially at once, or
# as a Gaussian.
_SHAPES: dict[str, Callable[[Array], Array]] = {
    "tanh": np.tanh,
    "algebraic": lambda x: x / np.hypot(1.0, x),
    "gompertz": lambda x: 2 * np.exp(-np.exp(np.minimum(-2 * x, 50.0))) - 1,
    "one-sided-exponential": lambda x: 1 - 2 * np.exp(-2 * np.maximum(x, 0.0)),
    "one-sided-gaussian": lambda x: 1 - 2 * np.exp(-2 * np.maximum(x, 0.0) ** 2),
}
SHAPES = tuple(_SHAPES)
# Grid of the posterior: closer than what a calibration can tell apart, or the node that happens to
# fit would be believed alone.
_FADES_MM = np.geomspace(5.0, 80.0, 49)
_SHIFTS_MM = np.linspace(-5.0, 15.0, 33)
_RESIDUAL_LENGTHS_MM = np.array([10.0, 25.0])
# Where the prior expects the transition, and how widely: a beam several millimetres thick cannot
# pass from one level to the other within a few, nor needs it the whole line.
_FADE_PRIOR_MM, _FADE_PRIOR_LOG_STD, _SHIFT_PRIOR_STD_MM = 14.0, 0.6, 7.0
# The residual is believed to be at least of this size, relative to the change with location, with
# the weight of this many observations: no transition has one of these shapes exactly, and what is
# no contact has none.
_LEAST_RESIDUAL, _LEAST_RESIDUAL_UNPHYSICAL, _LEAST_RESIDUAL_WEIGHT = 0.015, 0.05, 4.0
# Nodes of the grid within these of a likelier one are summarised with it, until so little of the
# posterior is left. Predictions then differ by 0.01 of their standard deviation for smooth contact
# laws, by 0.1 for those with kinks. Where the posterior is so wide that more transitions than these
# remained, nodes further apart are summarised.
_SAME_LOG_FADE, _SAME_SHIFT_MM, _LEFT_OUT = 0.3, 2.6, 0.02
_MOST_TRANSITIONS = 16
_NUGGET = 1e-6
_STEP_MM = 0.25


@declared
class Transition:
    """One way in which the contact may change along the line."""

    shape: str = key(Choice(words=SHAPES), doc="Form of the transition between its two levels.")
    probability: float = key(
        Number(low=LEAST, high=1), doc="Those of all transitions of a carrier sum to 1."
    )
    fade_mm: float = key(
        Number(unit="mm", low=LEAST, high=LARGEST), doc="Length over which the contact changes."
    )
    fade_relative_std: float = key(
        Number(low=0, high=10), doc="Its standard deviation, relative to it."
    )
    shift_mm: float = key(
        Number(unit="mm", low=-LARGEST, high=LARGEST),
        doc="Distance of the transition from the middle of the line, away from the port.",
    )
    shift_std_mm: float = key(Number(unit="mm", low=0, high=LARGEST), doc="Its standard deviation.")
    residual_length_mm: float = key(
        Number(unit="mm", low=LEAST, high=LARGEST),
        doc="Correlation length of what the shape does not explain.",
    )
    residual_variance: float = key(
        Number(low=0, high=LARGEST),
        doc="Variance of that, relative to the variance over the calibrated locations.",
    )

    def hypotheses(self) -> Array:
        """Four equally likely (fade, shift), with the mean and covariance of these; (4, 2)."""
        fade = self.fade_mm * np.exp(
            np.sqrt(2.0) * self.fade_relative_std * np.array([1, -1, 0, 0])
        )
        shift = self.shift_mm + np.sqrt(2.0) * self.shift_std_mm * np.array([0, 0, 1, -1])
        return np.column_stack([fade, shift])


def _change(location: Array, shape: str, fade_shift: Array, length_mm: float, port: int) -> Array:
    """S of one shape for each pair (fade, shift); shape (H, n)."""
    fade, shift = fade_shift.T[..., None]
    from_middle = location[None, :] - length_mm / 2
    return _SHAPES[shape](((from_middle if port == 0 else -from_middle) - shift) / fade)


def _matern(distance: Array, length: float) -> Array:
    q = np.sqrt(5.0) * distance / length
    return (1 + q + q * q / 3) * np.exp(-q)


def _kernel(at: Array, length: float) -> Array:
    return _matern(np.abs(at[:, None] - at[None, :]), length) + _NUGGET * np.eye(at.size)


@lru_cache(maxsize=4)  # a calibration needs one for each location that it leaves out
def _grid(length_mm: float) -> tuple[Array, Array]:
    """Locations (G,) of a table, and their :func:`node_slopes`."""
    grid = np.linspace(0.0, length_mm, int(np.ceil(length_mm / _STEP_MM)) + 1)
    return grid, node_slopes(grid)


@dataclass(frozen=True, eq=False, repr=False)
class LocationInterpolation:
    """Weights of J calibrated locations at any location, and the variance of the result."""

    location_mm: np.ndarray
    length_mm: float
    transitions: tuple[Transition, ...]

    @cached_property
    def _tables(self) -> list[CubicSpline]:
        """Splines over location: mean weights, their covariance, residual variance; by port."""
        (grid, slopes), ports = _grid(self.length_mm), []
        for port in (0, 1):
            predictions = zip(
                *(self._kriging(grid, t, port) for t in self.transitions), strict=True
            )
            weights, variance, seen = map(np.concatenate, predictions)
            share = seen * np.repeat([t.probability for t in self.transitions], 4) / 4
            if not np.any(share):
                rule = "must change between the calibrated locations (are they in mm?)"
                raise InputError("sensor: interpolation", rule)
            share = share / np.sum(share)
            mean = np.einsum("h,hgj->gj", share, weights)
            spread = np.einsum("h,hgj,hgi->gji", share, weights, weights)
            spread -= mean[:, :, None] * mean[:, None, :]
            residual = np.repeat([t.residual_variance for t in self.transitions], 4)
            within = (share * residual) @ variance
            ports.append((mean, spread, within))
        tables = (np.stack(both, axis=1) for both in zip(*ports, strict=True))
        return [CubicSpline(grid, table, slopes) for table in tables]

    def _kriging(
        self, grid: Array, transition: Transition, port: int
    ) -> tuple[Array, Array, np.ndarray]:
        """Weights (4, G, J), variance (4, G) and visibility (4,) of a transition's hypotheses."""
        at, length = self.location_mm, transition.residual_length_mm
        count, pairs = at.size, transition.hypotheses()

        def trend(location: Array) -> Array:
            change = _change(location, transition.shape, pairs, self.length_mm, port)
            return np.stack([np.ones_like(change), change], axis=-1)

        trend_at = trend(at)
        seen = np.ptp(trend_at[..., 1], axis=1) ** 2 > _NUGGET
        trend_at[~seen, :, 1] = at - at.mean()  # of no weight, but solved for with the others
        system = np.zeros((len(pairs), count + 2, count + 2))
        system[:, :count, :count] = _kernel(at, length)
        system[:, :count, count:] = trend_at
        system[:, count:, :count] = np.swapaxes(trend_at, 1, 2)
        near = _matern(np.abs(grid[:, None] - at[None, :]), length)
        near = np.broadcast_to(near, (len(pairs), *near.shape))
        right = np.concatenate([near, trend(grid)], axis=-1)
        solution = np.linalg.solve(system, np.swapaxes(right, 1, 2))
        variance = 1.0 - np.einsum("hkg,hgk->hg", solution, right)
        return np.swapaxes(solution[:, :count], 1, 2), np.maximum(variance, 0.0), seen

    def weights(self, location_mm: ArrayLike) -> Array:
        """Of each port; shape (..., 2, J)."""
        return self._tables[0](self._inside(location_mm))

    def variance(self, location_mm: ArrayLike, values: Array) -> Array:
        """Variance (..., 2) of values at locations, given the calibrated ones (..., 2, J)."""
        _, spread, within = self._tables
        inside = self._inside(location_mm)
        along = np.einsum("...ji,...i->...j", spread(inside), values)
        between = np.maximum(np.sum(values * along, axis=-1), 0.0)
        return between + np.maximum(within(inside), 0.0) * np.var(values, axis=-1, ddof=1)

    def _inside(self, location_mm: ArrayLike) -> Array:
        return np.clip(np.asarray(location_mm, float), 0.0, self.length_mm)


def learn_interpolation(
    location_mm: ArrayLike,
    length_mm: float,
    values: Array,
    noise_variance: float,
    physical: bool = True,
) -> LocationInterpolation:
    """The transitions that explain calibrated curves at J locations, with their probabilities.

    ``values`` (2, J, n), in deg, are what the contact adds to the line's phase at a few forces;
    where they are not ``physical``, with steps wider than a press, only slow trends are considered.
    """
    at = np.asarray(location_mm, float)
    curves = _Curves(at, float(length_mm), values, noise_variance, physical)
    candidates = []  # (shape, residual length), nodes (fade, shift), log posterior, variance
    for shape in SHAPES if physical else ("algebraic",):
        pairs, log_prior = _nodes(at, shape, length_mm, physical)
        for length in _RESIDUAL_LENGTHS_MM:
            log_likelihood, variance = curves.likelihood(shape, pairs, length)
            candidates.append(((shape, length), pairs, log_prior + log_likelihood, variance))
    most = max(np.max(c[2], initial=-np.inf) for c in candidates)
    total = sum(np.sum(np.exp(c[2] - most)) for c in candidates)
    for width in (1.0, 2.0, 4.0, np.inf):
        found = []
        for (shape, length), pairs, log_posterior, variance in candidates:
            share = np.exp(log_posterior - most) / total
            found += _summaries(shape, float(length), pairs, share, variance, width)
        transitions = _likeliest(found)
        if len(transitions) <= _MOST_TRANSITIONS:
            break
    return LocationInterpolation(at, float(length_mm), transitions)


def _nodes(at: Array, shape: str, length_mm: float, physical: bool) -> tuple[Array, Array]:
    """Pairs (fade, shift) that are considered (H, 2), and their log prior (H,)."""
    if not physical:
        return np.array([[4.0 * length_mm, 0.0]]), np.zeros(1)
    fade, shift = (axis.ravel() for axis in np.meshgrid(_FADES_MM, _SHIFTS_MM, indexing="ij"))
    pairs = np.column_stack([fade, shift])
    # enough of the transition must lie among the calibrated locations to differ from a constant
    steps = [np.ptp(_change(at, shape, pairs, length_mm, port), axis=1) for port in (0, 1)]
    seen = np.min(steps, axis=0) > 0.2 * np.minimum(2.0, np.ptp(at) / fade)
    log_prior = -0.5 * (np.log(fade / _FADE_PRIOR_MM) / _FADE_PRIOR_LOG_STD) ** 2
    log_prior -= 0.5 * (shift / _SHIFT_PRIOR_STD_MM) ** 2
    return pairs[seen], log_prior[seen]


class _Curves:
    """Calibrated values over location, and how well a transition explains them."""

    def __init__(
        self, at: Array, length_mm: float, values: Array, noise_variance: float, physical: bool
    ) -> None:
        variance = max(np.mean(np.var(values, axis=1, ddof=1)), 1e-12)
        self._at, self._length_mm = at, length_mm
        self._floor = max(noise_variance / variance, 1e-8)
        self._least = _LEAST_RESIDUAL if physical else _LEAST_RESIDUAL_UNPHYSICAL
        self._components = [_components(port / np.sqrt(variance), self._floor) for port in values]

    def likelihood(self, shape: str, pairs: Array, length: float) -> tuple[Array, Array]:
        """Restricted log likelihood, and residual variance, of pairs (fade, shift); each (H,)."""
        observations = _LEAST_RESIDUAL_WEIGHT
        squares_sum = np.full(len(pairs), _LEAST_RESIDUAL_WEIGHT * self._least**2)
        log_determinant = np.zeros(len(pairs))
        for port, components in enumerate(self._components):
            change = _change(self._at, shape, pairs, self._length_mm, port)
            squares, trace, determinant = _restricted(self._at, change, length, components)
            rank = components.shape[1]
            squares_sum += squares + self._floor * rank * trace
            observations += rank * (self._at.size - 2)
            log_determinant += rank * determinant
        variance = squares_sum / observations
        return -0.5 * (observations * np.log(variance) + log_determinant), variance


def _components(values: Array, floor: float) -> Array:
    """Orthogonal combinations of the forces, in units of one force, that rise above the noise."""
    vectors, singular, _ = np.linalg.svd(values - values.mean(axis=0), full_matrices=False)
    scaled = vectors * singular / np.sqrt(values.shape[1])
    strong = singular**2 / values.size > 4 * floor
    strong[0] = True
    return scaled[:, strong]


def _restricted(
    at: Array, change: Array, length: float, components: Array
) -> tuple[Array, Array, Array]:
    """Squares (H,) that the trend leaves, trace of their matrix, log determinant."""
    inverse = np.linalg.inv(_kernel(at, length))
    ones = inverse.sum(axis=0)
    # What of the change a constant does not explain: the trend's normal matrix is diagonal then.
    rest = change - (change @ ones / ones.sum())[:, None]
    weighted = rest @ inverse
    normal = np.sum(rest * weighted, axis=1)
    explained = np.sum((ones @ components) ** 2) / ones.sum()
    explained = explained + np.sum((weighted @ components) ** 2, axis=1) / normal
    hat = ones @ ones / ones.sum() + np.sum(weighted**2, axis=1) / normal
    squares = np.sum(components * (inverse @ components)) - explained
    plain = np.log(at.size * np.sum((change - change.mean(axis=1, keepdims=True)) ** 2, axis=1))
    determinant = np.log(ones.sum() * normal) - plain - np.linalg.slogdet(inverse)[1]
    return np.maximum(squares, 0.0), np.trace(inverse) - hat, determinant


def _summaries(
    shape: str, length: float, pairs: Array, share: Array, variance: Array, width: float
) -> list[Transition]:
    """Transitions for the nodes of one shape, those within ``width`` of the constants in one."""
    log_fade, shift = np.log(pairs[:, 0]), pairs[:, 1]
    unassigned, found = share.copy(), []
    while unassigned.size and unassigned.max() > 1e-3 * _LEFT_OUT:
        centre = int(np.argmax(unassigned))
        near = np.abs(log_fade - log_fade[centre]) < width * _SAME_LOG_FADE
        near &= (np.abs(shift - shift[centre]) < width * _SAME_SHIFT_MM) & (unassigned > 0)
        probability = unassigned[near].sum()
        weight = unassigned[near] / probability
        fade_mean, shift_mean = weight @ log_fade[near], weight @ shift[near]
        found.append(
            Transition(
                shape=shape,
                probability=float(probability),
                fade_mm=float(np.exp(fade_mean)),
                fade_relative_std=float(np.sqrt(weight @ (log_fade[near] - fade_mean) ** 2)),
                shift_mm=float(shift_mean),
                shift_std_mm=float(np.sqrt(weight @ (shift[near] - shift_mean) ** 2)),
                residual_length_mm=length,
                residual_variance=float(weight @ variance[near]),
            )
        )
        unassigned[near] = 0.0
    return found


def _likeliest(found: list[Transition]) -> tuple[Transition, ...]:
    """As many transitions as hold nearly all of the posterior, the likeliest first."""
    found = sorted(found, key=lambda t: -t.probability)
    total = np.cumsum([t.probability for t in found])
    kept = found[: int(np.searchsorted(total, 1 - _LEFT_OUT)) + 1]
    share = sum(t.probability for t in kept)
    return tuple(replace(t, probability=t.probability / share) for t in kept)
