# SPDX-License-Identifier: GPL-3.0-or-later
"""Presses on a surface from the readings of its strips: profiles, posterior, estimate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, log_ndtr, logsumexp

from ..signal.carrier import wrap_deg
from .skin import Skin

if TYPE_CHECKING:
    from typing_extensions import Self

    from ..sensor.model import SensorModel


Array = NDArray[np.float64]

# Forces of a profile, and the standard deviations that they span. The likelihood between two of
# them is constant within 3 %.
_FORCES, _REACH = 25, 4.5
# Steps of Gauss and Newton for the location at each force, from that of the inversion.
_STEPS = 2


class _Rows:
    """Arrays of n readings."""

    def __getitem__(self, rows: slice | NDArray[np.intp]) -> Self:
        return type(self)(*(values[rows] for values in vars(self).values()))


@dataclass(frozen=True)
class StripProfile(_Rows):
    """Profile likelihood over the force of n readings of one strip."""

    force_n: Array  # (n, k), equally spaced, from the onset or higher
    # (n, k), of the likelihood integrated over the location and to the next force
    log_weight: Array
    location_mm: Array  # (n, k), that explains the phases best at each force, with ``variance_mm2``
    variance_mm2: Array


def strip_profile(
    model: SensorModel, frequency_hz: float, phases_deg: Array, std_deg: Array
) -> StripProfile:
    """Profile likelihood over the force of a touched strip's phases (n, 2), about its inversion."""
    inverter = model.inverter(frequency_hz)
    found = inverter.invert(phases_deg, std_deg)
    low, high = inverter.force_n[[0, -1]]
    first = np.clip(found.force_n - _REACH * found.force_std_n, low, high)
    last = np.clip(found.force_n + _REACH * found.force_std_n, low, high)
    last = np.maximum(last, first + 1e-6 * high)
    force = first[:, None] + (last - first)[:, None] * np.linspace(0.0, 1.0, _FORCES)
    covariance = found.covariance
    slope = covariance[:, 0, 1] / np.maximum(covariance[:, 0, 0], 1e-12)
    location = found.location_mm[:, None] + slope[:, None] * (force - found.force_n[:, None])
    start, stop = inverter.location_mm[[0, -1]]
    wanted, noise = phases_deg[:, None], std_deg[:, None] ** 2
    location = np.clip(location, start, stop)
    variance = np.maximum(noise + inverter.at(force, location)[3], 1e-9)
    for _ in range(_STEPS):
        phases, _, by_location, _ = inverter.at(force, location)
        residual = wrap_deg(wanted - phases)
        curvature = np.maximum((by_location**2 / variance).sum(axis=-1), 1e-9)
        step = (by_location * residual / variance).sum(axis=-1) / curvature
        location = np.clip(location + step, start, stop)
    # The residual at the last location but one, less what the last step has taken off it.
    left = (residual**2 / variance).sum(axis=-1) - curvature * step**2
    log_weight = -0.5 * (left + np.log(variance).sum(axis=-1) + np.log(curvature))
    log_weight += np.log((last - first) / (_FORCES - 1))[:, None]
    ruler = (model.ruler_std_mm or 0.0) ** 2
    return StripProfile(force, log_weight, location, 1 / curvature + ruler)


# A strip that is pressed from 0.9 N on is detected from 1.2 N on: this is
# three standard deviations.
_ONSET_STD_N = 0.1
# Points across at which the posterior is first drawn, per spacing; then over the part in which it
# is within exp(-_DEPTH) of its largest value.
_ROUGH_PER_SPACING, _FINE, _DEPTH = 12, 41, 12.0
# Hermite points along x; their spread over that of a normal posterior, so that skewed ones are
# covered. Points of Gauss and Legendre's rule along force, as far as the strips allow.
_HERMITE, _WIDER, _LEGENDRE = 5, 1.3, 9
_LOWEST_N = 1e-3
# Least squares starts from a press anywhere: a normal variable with the variance of one that is
# uniform, length^2 / 12, over all forces and this length along x, several strips of 80 mm. Its
# weight against a strip's own 0.5 mm is 1e-4.
_UNIFORM, _PRIOR_MM = 12, 200.0
# Readings at a time, which limits memory to 50 MB.
_AT_ONCE = 16


@dataclass(frozen=True)
class SurfaceEvidence(_Rows):
    """What n readings of all S strips show."""

    # Of arrays (n, S, k), with the locations along x; meaningless where untouched.
    profiles: StripProfile
    # (n, S); neither this nor ``untouched`` for strips that are left out
    touched: NDArray[np.bool_]
    untouched: NDArray[np.bool_]
    other_n: Array  # (n, S), force that something else may add to each strip: a standard deviation

    def __len__(self) -> int:
        return len(self.touched)

    def of_touched(self, strips: NDArray[np.bool_], other_n: Array) -> SurfaceEvidence:
        """The same with all other touched strips left out; (S,) each."""
        other = np.broadcast_to(other_n, self.touched.shape)
        return SurfaceEvidence(self.profiles, self.touched & strips, self.untouched, other)


@dataclass(frozen=True)
class SurfacePress(_Rows):
    """Presses of n readings."""

    mean: Array  # (n, 3), force in N, x and y in mm
    covariance: Array  # (n, 3, 3)
    misfit: Array  # (n,), squared residual of the strips at the best press, in standard deviations
    freedom: Array  # (n,), of which so much is expected


class SurfacePosterior:
    """The posterior of force, x and y, all forces and points being equally likely beforehand.

    The force on strip i is normal about ``share(y - y_i) F`` with ``share_std F``, its location
    about x with ``location_std_mm``. Touched strips give the likelihood of their phases, untouched
    ones the probability of less than the onset. It is summed over y, and integrated over force and
    x about the least squares at each y, over forces that touch no untouched strip: few points would
    be left.
    """

    def __init__(self, skin: Skin) -> None:
        self._skin = skin
        low, high = skin.y_mm[[0, -1]]
        count = round((high - low) / skin.spacing_mm + 2) * _ROUGH_PER_SPACING + 1
        beyond = skin.spacing_mm
        self._y = np.linspace(low - beyond, high + beyond, count)
        spans = [strip.ends_mm for strip in skin.strips]
        self._x_span = min(span[0] for span in spans), max(span[1] for span in spans)
        tops = [s.model.inverter(skin.frequency_hz).force_n[-1] for s in skin.strips]
        between = float(skin.spreading.mean_share(skin.spacing_mm / 2))
        self._top_n = max(tops) / max(between, 0.05)
        nodes, weights = np.polynomial.hermite_e.hermegauss(_HERMITE)
        # Weights for integrals of the function itself, not of it times the normal density.
        self._along = _WIDER * nodes, np.log(weights) + 0.5 * nodes**2
        self._of_force = np.polynomial.legendre.leggauss(_LEGENDRE)

    def __call__(self, evidence: SurfaceEvidence) -> SurfacePress:
        """The posterior's mean and covariance; at least one strip of each reading is touched."""
        starts = range(0, len(evidence), _AT_ONCE)
        parts = [self._some(evidence[start : start + _AT_ONCE]) for start in starts]
        return SurfacePress(
            *map(np.concatenate, zip(*(vars(p).values() for p in parts), strict=True))
        )

    def roughly(self, evidence: SurfaceEvidence) -> SurfacePress:
        """The least-squares press of such evidence, without a covariance: much faster."""
        y = np.broadcast_to(self._y, (len(evidence), len(self._y)))
        mean, _, _, squares = self._conditional(evidence, y)
        misfit, freedom, best = self._misfit(evidence, y, mean[..., 0], squares)
        at_best = np.take_along_axis(mean, best[..., None], axis=1)[:, 0]
        found = np.column_stack([at_best, self._y[best[:, 0]]])
        return SurfacePress(found, np.zeros((len(evidence), 3, 3)), misfit, freedom)

    def _some(self, evidence: SurfaceEvidence) -> SurfacePress:
        y = np.broadcast_to(self._y, (len(evidence), len(self._y)))
        rough = self._conditional(evidence, y)[2]
        near = rough > rough.max(axis=1, keepdims=True) - _DEPTH
        first, last = near.argmax(axis=1), len(self._y) - 1 - near[:, ::-1].argmax(axis=1)
        low = self._y[np.maximum(first - 1, 0)]
        high = self._y[np.minimum(last + 1, len(self._y) - 1)]
        y = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, _FINE)
        mean, covariance, _, squares = self._conditional(evidence, y)
        root = np.linalg.cholesky(covariance)
        least, most = self._forces(evidence, mean[..., 0], root[..., 0, 0], y)
        half, (nodes, weights) = (most - least) / 2, self._of_force
        forces = ((least + most) / 2)[..., None] + half[..., None] * nodes
        away = root[..., 1, :1] / root[..., :1, 0] * (forces - mean[..., :1])
        x = (mean[..., 1:] + away)[..., None] + root[..., 1, 1, None, None] * self._along[0]
        force = np.repeat(forces, _HERMITE, axis=-1)
        x = x.reshape(force.shape)
        across = np.broadcast_to(y[:, :, None], force.shape)
        log = self._log_likelihood(evidence, force, x, across)
        log += (np.log(weights)[:, None] + self._along[1]).ravel()
        log = (log + np.log(half * root[..., 1, 1])[..., None]).reshape(len(evidence), -1)
        best = log.max(axis=1, keepdims=True)
        weight = np.exp(log - best)
        weight /= weight.sum(axis=1, keepdims=True)
        press = np.stack([force, x, across], axis=-1).reshape(len(evidence), -1, 3)
        found = np.einsum("np,npa->na", weight, press)
        centred = press - found[:, None]
        spread = np.einsum("np,npa,npb->nab", weight, centred, centred)
        # What lies between two points across.
        step = (high - low) / (_FINE - 1)
        spread[:, 2, 2] += step**2 / 12
        misfit, freedom, _ = self._misfit(evidence, y, mean[..., 0], squares)
        return SurfacePress(found, spread, misfit, freedom)

    def _forces(
        self, evidence: SurfaceEvidence, force: Array, std: Array, y: Array
    ) -> tuple[Array, Array]:
        """Least and largest force (n, Y) that touched and untouched strips allow at each y."""
        share = self._skin.shares(y) - _REACH * self._skin.spreading.share_std
        below = self._skin.untouched_below_n + _REACH * _ONSET_STD_N
        allowed = np.full(share.shape, np.inf)
        np.divide(below, share, out=allowed, where=evidence.untouched[:, None] & (share > 0))
        most = np.minimum(force + _REACH * std, allowed.min(axis=-1))
        least = np.maximum(np.minimum(force - _REACH * std, most - std), _LOWEST_N)
        return least, np.maximum(most, least + _LOWEST_N)

    def _strip_std(self, force: Array) -> Array:
        """Standard deviation of the force on any strip."""
        return self._skin.spreading.share_std * force

    def _conditional(
        self, evidence: SurfaceEvidence, y: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Mean (n, Y, 2), covariance (n, Y, 2, 2) and log evidence (n, Y) of (force, x) at each y.

        Of touched strips, with their squared residuals (n, Y); untouched ones count as far as the
        least likely force contradicts them.
        """
        m, x, ff, fx, xx = _moments(evidence)
        xx = xx + self._skin.spreading.location_std_mm**2
        shares, touched = self._skin.shares(y), evidence.touched[:, None].astype(float)  # (n, Y, S)
        force = (touched * shares * m).sum(axis=-1)
        force /= np.maximum((touched * shares**2).sum(axis=-1), 1e-4)
        force = np.clip(force, _LOWEST_N, self._top_n)
        middle = 0.5 * (self._x_span[0] + self._x_span[1])
        prior_force, prior_x = _UNIFORM / self._top_n**2, _UNIFORM / _PRIOR_MM**2

        def inverse(force: Array) -> tuple[Array, Array, Array]:
            """Inverse covariances (n, Y, S) with the errors of the law; 0 where not touched."""
            a, c = ff + self._strip_std(force)[..., None] ** 2 + 1e-9, xx + 1e-9
            determinant = np.maximum(a * c - fx**2, 1e-18)
            return touched * c / determinant, -touched * fx / determinant, touched * a / determinant

        for _ in range(3):
            a, b, c = inverse(force)
            nff = (a * shares**2).sum(axis=-1) + prior_force
            nfx, nxx = (b * shares).sum(axis=-1), c.sum(axis=-1) + prior_x
            rf = (shares * (a * m + b * x)).sum(axis=-1) + prior_force * self._top_n / 2
            rx = (b * m + c * x).sum(axis=-1) + prior_x * middle
            determinant = nff * nxx - nfx**2
            force = np.clip((nxx * rf - nfx * rx) / determinant, _LOWEST_N, self._top_n)
        along = (nff * rx - nfx * rf) / determinant
        mean = np.stack([force, along], axis=-1)
        covariance = np.stack([nxx, -nfx, -nfx, nff], axis=-1).reshape(*nff.shape, 2, 2)
        covariance /= determinant[..., None, None]
        a, b, c = inverse(force)
        df, dx = m - shares * force[..., None], x - along[..., None]
        squares = (a * df**2 + 2 * b * df * dx + c * dx**2).sum(axis=-1)
        least = np.maximum(force - _REACH * np.sqrt(covariance[..., 0, 0]), _LOWEST_N)
        misfit = squares + (self._above(evidence, shares, least) ** 2).sum(axis=-1)
        size = touched * np.log(np.maximum(a * c - b**2, 1e-300))
        log = -0.5 * misfit + 0.5 * size.sum(axis=-1) - 0.5 * np.log(determinant)
        return mean, covariance, log, squares

    def _above(self, evidence: SurfaceEvidence, shares: Array, force: Array) -> Array:
        """Standard deviations by which untouched strips bear more than the onset, (n, Y, S)."""
        std = np.hypot(self._strip_std(force)[..., None], _ONSET_STD_N)
        above = (shares * force[..., None] - self._skin.untouched_below_n) / std
        return np.maximum(above, 0) * evidence.untouched[:, None]

    def _log_likelihood(self, evidence: SurfaceEvidence, force: Array, x: Array, y: Array) -> Array:
        """Of the strips' phases and touches at points (n, Y, q)."""
        total = np.where((force > _LOWEST_N) & (force < self._top_n), 0.0, -np.inf)
        safe = np.maximum(force, _LOWEST_N)
        std = self._strip_std(safe)
        spread = self._skin.spreading.location_std_mm**2
        for i, strip_y in enumerate(self._skin.y_mm):
            borne = self._skin.spreading.share_of(i, y - strip_y) * safe
            onset = self._skin.untouched_below_n[i]
            if (rows := np.flatnonzero(evidence.untouched[:, i])).size:
                below = (onset - borne[rows]) / np.hypot(std[rows], _ONSET_STD_N)
                total[rows] += log_ndtr(below)
            if not (rows := np.flatnonzero(evidence.touched[:, i])).size:
                continue
            p = evidence[rows].profiles
            at, weight = p.force_n[:, None, None, i], p.log_weight[:, None, None, i]
            where, variance = p.location_mm[:, None, None, i], p.variance_mm2[:, None, None, i]
            # Forces of the profile stand for the intervals about them: Gaussians so wide add up to
            # a constant within 2 exp(-2 (0.6 pi)^2) = 0.2 % (Poisson's sum).
            interval = 0.6 * (p.force_n[:, i, 1] - p.force_n[:, i, 0])
            other = np.hypot(evidence.other_n[rows, i], interval)
            width = np.hypot(std[rows], other[:, None, None])[..., None]
            variance = variance + spread
            exponent = ((at - borne[rows][..., None]) / width) ** 2
            exponent += (where - x[rows][..., None]) ** 2 / variance + np.log(variance)
            total[rows] += logsumexp(weight - 0.5 * exponent, axis=-1) - np.log(width[..., 0])
        return total

    def _misfit(
        self, evidence: SurfaceEvidence, y: Array, force: Array, squares: Array
    ) -> tuple[Array, Array, NDArray[np.intp]]:
        """Least squared residual over y, its degrees of freedom, and where it is (n, 1)."""
        above = self._above(evidence, self._skin.shares(y), force)
        squares = squares + (above**2).sum(axis=-1)
        best = squares.argmin(axis=1)[:, None]
        misfit = np.take_along_axis(squares, best, axis=1)[:, 0]
        contradicting = np.take_along_axis((above > 0).sum(axis=-1), best, axis=1)[:, 0]
        freedom = 2 * evidence.touched.sum(axis=1) - 3 + contradicting
        return misfit, np.maximum(freedom, 1), best


def _moments(evidence: SurfaceEvidence) -> Array:
    """Means of each strip's own force and x, and their covariance ff, fx, xx; (5, n, 1, S)."""
    p = evidence.profiles
    log = np.where(evidence.touched[..., None], p.log_weight, 0.0)
    weight = np.exp(log - log.max(axis=-1, keepdims=True))
    weight /= weight.sum(axis=-1, keepdims=True)
    force, x = (weight * p.force_n).sum(axis=-1), (weight * p.location_mm).sum(axis=-1)
    df, dx = p.force_n - force[..., None], p.location_mm - x[..., None]
    ff = (weight * df**2).sum(axis=-1) + evidence.other_n**2
    fx = (weight * df * dx).sum(axis=-1)
    xx = (weight * (dx**2 + p.variance_mm2)).sum(axis=-1)
    return np.stack([force, x, ff, fx, xx])[:, :, None]


Flags = NDArray[np.bool_]

# Strips contradict each other when their residual is larger than that of so many presses, as for
# the phases of one strip (sensor/inversion.py).
_CONSISTENT = 0.9973
# A press may load a strip that another one is read from by this part of the force that shorts it:
# it then makes no contact of its own there.
_CROSS = 0.6
# Standard deviations of y within which a press may lie.
_LIKELY = 2.0


@dataclass(frozen=True)
class SurfaceFound:
    """Presses of G groups, up to P at a time."""

    touch: NDArray[np.intp]  # (G, P), 1, 0, or -1 where it is not known
    mean: Array  # (G, P, 3), force in N, x and y in mm; NaN where not touched
    covariance: Array  # (G, P, 3, 3)
    inconsistent: Flags  # (G, P), no press explains what the strips show
    # (G, P), beyond what the strips cover, or may be by two standard deviations of y
    outside: Flags
    main: NDArray[np.intp]  # (G, P), the strip that bears most of the press


class SurfaceEstimator:
    """Reads the presses on a skin, 1 or 2 at a time.

    Where one does not explain the strips, they are divided at some y. Two are accepted where none
    makes contact on the other's strips; what it adds to the force there is an error.
    """

    def __init__(self, skin: Skin, presses: int = 1) -> None:
        self.skin, self._presses = skin, presses
        self._posterior = SurfacePosterior(skin)
        # Where each of the presses was in the last group; None where it was not.
        self._last: list[Array | None] = [None] * presses

    def read(
        self, phases_deg: Array, std_deg: Array, usable: Flags, touched: Flags
    ) -> SurfaceFound:
        """Presses from phases and noise (G, S, 2) of ``usable`` strips (G, S), by y."""
        count, presses = len(usable), self._presses
        none_touched = np.where(usable.all(axis=1), 0, -1)
        touch = np.repeat(none_touched[:, None], presses, axis=1)
        mean = np.full((count, presses, 3), np.nan)
        covariance = np.full((count, presses, 3, 3), np.nan)
        inconsistent = np.zeros((count, presses), bool)
        rows = np.flatnonzero((usable & touched).any(axis=1))
        found = self._found(phases_deg, std_deg, usable, touched, rows) if rows.size else {}
        for row in range(count):
            if row not in found:
                self._last = [None] * presses
                continue
            parts, contradicts = found[row]
            places = self._places([part.mean[0] for part in parts])
            for place, part in zip(places, parts, strict=True):
                touch[row, place] = 1
                mean[row, place], covariance[row, place] = part.mean[0], part.covariance[0]
            inconsistent[row] = contradicts
        inconsistent &= touch == 1
        spans = np.array([self.skin.x_span_mm, self.skin.y_span_mm])
        # Beyond the surface the law is unknown, but presses there are read as if it applied.
        across_std = np.sqrt(covariance[..., 2, 2])
        margin = _LIKELY * np.stack([np.zeros_like(across_std), across_std], axis=-1)
        with np.errstate(invalid="ignore"):
            beyond = (mean[..., 1:] - margin < spans[:, 0]) | (mean[..., 1:] + margin > spans[:, 1])
        main = self.skin.shares(np.nan_to_num(mean[..., 2])).argmax(axis=-1)
        return SurfaceFound(touch, mean, covariance, inconsistent, beyond.any(axis=-1), main)

    def _found(
        self,
        phases: Array,
        std: Array,
        usable: Flags,
        touched: Flags,
        rows: NDArray[np.intp],
    ) -> dict[int, tuple[list[SurfacePress], bool]]:
        """The presses of each touched group, and whether they do not explain the strips."""
        evidence = self._evidence(phases[rows], std[rows], usable[rows], touched[rows])
        one = self._posterior(evidence)
        contradicts = one.misfit > chdtri(one.freedom, 1 - _CONSISTENT)
        # By the Birge ratio, as for the phases of one strip (lib/kernel/inversion).
        ratio = np.where(contradicts, one.misfit / one.freedom, 1.0)
        one = replace(one, covariance=one.covariance * ratio[:, None, None])
        found = {int(row): ([one[i : i + 1]], bool(contradicts[i])) for i, row in enumerate(rows)}
        if self._presses > 1:
            for i in np.flatnonzero(contradicts):
                two = self._divide(evidence[i : i + 1])
                if two is not None:
                    found[int(rows[i])] = two, False
        return found

    def _divide(self, evidence: SurfaceEvidence) -> list[SurfacePress] | None:
        """Two presses that explain one reading; None where there are none."""
        strips, touched = np.arange(len(self.skin.strips)), evidence.touched[0]
        best: tuple[float, list[SurfaceEvidence]] | None = None
        for first in range(1, len(strips)):
            sides = strips < first, strips >= first
            if not all((touched & side).any() for side in sides):
                continue
            alone = [evidence.of_touched(side, np.zeros(1)) for side in sides]
            presses = [self._posterior.roughly(part).mean[0] for part in alone[::-1]]
            others = [force * self.skin.shares(y) for force, _, y in presses]  # what strips bear
            if any(
                (other > _CROSS * self.skin.onset_force_n)[touched & side].any()
                for other, side in zip(others, sides, strict=True)
            ):
                continue
            parts = [
                evidence.of_touched(side, other) for side, other in zip(sides, others, strict=True)
            ]
            rough = [self._posterior.roughly(part) for part in parts]
            if any(part.misfit[0] > chdtri(part.freedom[0], 1 - _CONSISTENT) for part in rough):
                continue
            misfit = float(sum(part.misfit[0] for part in rough))
            if best is None or misfit < best[0]:
                best = misfit, parts
        return None if best is None else [self._posterior(part) for part in best[1]]

    def _places(self, presses: list[Array]) -> tuple[int, ...]:
        """Which of the rows each press goes on in: that of the nearest press of the last group."""

        def cost(order: tuple[int, ...]) -> tuple[float, float]:
            apart = sum(_distance(p, self._last[i]) for p, i in zip(presses, order, strict=True))
            # Among equals, the heaviest press comes first.
            return apart, -presses[order.index(0)][0] if 0 in order else 0.0

        places = min(permutations(range(self._presses), len(presses)), key=cost)
        self._last = [None] * self._presses
        for place, press in zip(places, presses, strict=True):
            self._last[place] = press
        return places

    def _evidence(
        self, phases: Array, std: Array, usable: Flags, touched: Flags
    ) -> SurfaceEvidence:
        """What the strips show, with their locations along x."""
        profiles = np.ones((4, *usable.shape, _FORCES))
        for i, strip in enumerate(self.skin.strips):
            rows = np.flatnonzero(usable[:, i] & touched[:, i])
            own = strip_profile(strip.model, self.skin.frequency_hz, phases[rows, i], std[rows, i])
            x = strip.x_of(own.location_mm - self.skin.spreading.offset_mm(i))
            profiles[:, rows, i] = own.force_n, own.log_weight, x, own.variance_mm2
        nothing = np.zeros(usable.shape)
        shown = StripProfile(*profiles)
        return SurfaceEvidence(shown, usable & touched, usable & ~touched, nothing)


# Distance in mm of a press from one that was not there: farther than any surface is wide.
_ABSENT_MM = 1e5


def _distance(press: Array, last: Array | None) -> float:
    return _ABSENT_MM if last is None else float(np.hypot(*(press[1:] - last[1:])))
