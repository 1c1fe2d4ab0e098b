# SPDX-License-Identifier: GPL-3.0-or-later
"""The inverse of a model as a table over the two phases of one carrier.

The plane of (psi_1, psi_2) is cut into cells of half a degree, or one degree where the image is
large, as it is at high carriers: there a degree moves force and location less. For every cell that
the model's image reaches, and every solution there, a row holds the solution at the cell's centre
and its first and second derivatives by the phases. A reading then costs one look-up and a Taylor
step: a Newton step whose Jacobian was computed beforehand.
"""

import numpy as np

from ..signal.carrier import wrap_deg

# Columns of a row that are read again here.
_FORCE, _JACOBIAN, _VARIANCE, _TRUSTED_DEG = 0, 2, 12, 15

# Standard deviations for which that is tried.
_TRIED_DEG = (0.3, 0.5, 0.8, 1.2, 2.0, 3.0, 5.0, 8.0)
# How much mean and variance of the whole likelihood may differ from what the slopes say.
_SHIFT_STD, _VARIANCE_RATIO = 0.3, 1.4

# Largest image, in square degrees, that is cut into cells of half a degree.
_LARGE_IMAGE_DEG2 = 8000.0
# Steps of the fine grid with which the image is drawn, in cells.
_FINE = 0.7
_NEWTON_STEPS = 3
# Two solutions in a cell are different when they are this far apart.
_APART_MM = 3.0
# Beyond these a Taylor step from the centre of a cell is not trusted: relative size of the second
# derivatives at its corner, newtons per degree, and what the nodes within it span.
_LARGEST_BEND, _LARGEST_SLOPE_N_PER_DEG, _LARGEST_EXTENT = 0.35, 2.0, 1.5


class InverseTable:
    """All solutions for any pair of phases, by cell.

    Parameters
    ----------
    forward : ForwardMap
        Of one carrier.
    in_span : callable
        ``in_span(force_n, location_mm)``: whether that was calibrated.
    profile : likelihood_profile
        Of the same map, see :func:`.profile.tabulate`.

    Attributes
    ----------
    rows : ndarray, shape (R, 16)
        As ``row`` in ``lib/kernel/inversion/inverse_table.h``.
    row_of : ndarray of int32, shape (cells * cells,)
        The row of each cell that has exactly one solution, which a Taylor step finds; else -1.
    """

    def __init__(self, forward, in_span, profile):
        self._forward = forward
        self._per_deg = 1 if _image_area(forward) > _LARGE_IMAGE_DEG2 else 2
        self._cells = 360 * self._per_deg
        cells, force, location, extent = self._draw()
        target = self._centres(cells)
        force, location, error = self._newton(force, location, target)
        slopes = forward.slopes(force, location)
        inverse = _inverse(slopes)
        second = _second_derivatives(inverse, forward.curvatures(force, location))
        good = _trusted(error, inverse, second, extent, 0.5 / self._per_deg)
        rows = np.column_stack(
            [
                force,
                location,
                inverse.reshape(-1, 4),
                second.reshape(-1, 6),
                forward.variances(force, location),
                _all_in_span(in_span, force, location, 0.6 / self._per_deg * inverse),
                np.zeros(len(force)),
            ]
        )
        _, owner, count = np.unique(cells, return_inverse=True, return_counts=True)
        alone = good & np.isfinite(rows).all(axis=1) & (count[owner] == 1)
        cells, self.rows = cells[alone], np.ascontiguousarray(rows[alone])
        self.rows[:, _TRUSTED_DEG] = self._trusted_deg(self._centres(cells), profile)
        self.row_of = np.full(self._cells**2, -1, np.int32)
        self.row_of[cells] = np.arange(len(cells))

    def _trusted_deg(self, phases, profile):
        """Largest standard deviation up to which the slopes tell the likelihood, (R,):

        as wide as they say, without a tail where force is hidden, without another solution.
        """
        force, inverse, own = self.rows[:, _FORCE], self.rows[:, _JACOBIAN:][:, :2], _VARIANCE
        trusted, still = np.zeros((2, len(force)))
        still += 1
        for std in _TRIED_DEG:
            whole = profile.read(phases, np.full_like(phases, std**2))
            variance = np.sum(inverse**2 * (std**2 + self.rows[:, own : own + 2]), axis=1)
            shift = np.abs(whole[:, 0] - force) / np.sqrt(variance)
            ratio = whole[:, 2] / variance
            with np.errstate(invalid="ignore"):
                still *= (shift < _SHIFT_STD) & (ratio < _VARIANCE_RATIO)
                still *= (ratio > 1 / _VARIANCE_RATIO) & (whole[:, 8] == 0)
            trusted = np.where(still > 0, std, trusted)
        return trusted

    def _draw(self):
        """One start per cell and solution.

        Returns
        -------
        cells (R,), force (R,) and location (R,) of the node nearest to the centre, and the span of
        force and location over the cell (R, 2).
        """
        force, location = self._fine_grid()
        phase = np.stack(
            [spline(np.log(force), location) for spline in self._forward._phase], axis=-1
        )
        force, location = (axis.ravel() for axis in np.meshgrid(force, location, indexing="ij"))
        phase = phase.reshape(-1, 2)
        cells = self._index(phase)
        offset = np.abs(wrap_deg(phase - self._centres(cells))).max(axis=1)
        order = np.lexsort((location, cells))
        cells, force, location, offset = (v[order] for v in (cells, force, location, offset))
        fresh = np.ones(len(cells), bool)
        fresh[1:] = (np.diff(cells) != 0) | (np.diff(location) > _APART_MM)
        branch = np.cumsum(fresh) - 1
        starts = np.flatnonzero(fresh)
        nearest = np.lexsort((offset, branch))[starts]
        extent = [
            np.maximum.reduceat(v, starts) - np.minimum.reduceat(v, starts)
            for v in (force, location)
        ]
        return cells[nearest], force[nearest], location[nearest], np.stack(extent, axis=-1)

    def _fine_grid(self):
        """Axes on which neighbouring phases differ by less than a cell."""
        steps = _FINE / self._per_deg
        along_force = np.abs(np.diff(self._forward.phase_deg, axis=0)).max(axis=(1, 2))
        along_location = np.abs(np.diff(self._forward.phase_deg, axis=1)).max(axis=(0, 2))
        return (
            _subdivide(self._forward.force_n, along_force / steps),
            _subdivide(self._forward.location_mm, along_location / steps),
        )

    def _newton(self, force, location, target):
        """Solutions at the targets, and the phase error left (deg)."""
        for _ in range(_NEWTON_STEPS):
            residual = wrap_deg(target - self._forward.phases(force, location))
            step = np.einsum(
                "nij,nj->ni", _inverse(self._forward.slopes(force, location)), residual
            )
            # a cell at the rim of the image may have its centre outside: follow only so far
            step = np.clip(np.nan_to_num(step), [-0.3, -2.0], [0.3, 2.0])
            force, location = self._forward.clip(force + step[:, 0], location + step[:, 1])
        residual = wrap_deg(target - self._forward.phases(force, location))
        return force, location, np.abs(residual).max(axis=1)

    def _index(self, phases_deg):
        """Cell of each pair of phases (n, 2)."""
        cell = np.floor(phases_deg * self._per_deg).astype(np.int64) % self._cells
        return cell[:, 0] * self._cells + cell[:, 1]

    def _centres(self, cells):
        halves = np.stack([cells // self._cells, cells % self._cells], axis=-1) + 0.5
        return halves / self._per_deg


def _image_area(forward):
    """Area of the model's image, in square degrees."""
    by_force, by_location = np.gradient(forward.phase_deg, axis=(0, 1))
    areas = by_force[..., 0] * by_location[..., 1] - by_force[..., 1] * by_location[..., 0]
    return np.sum(np.abs(areas))


def _trusted(error, inverse, second, extent, half):
    """Whether the Taylor step holds all over the cell and finds all there is; bool (R,)."""
    first_order = half * np.abs(inverse).sum(axis=2)
    second_order = half**2 * np.abs(second).sum(axis=2)
    with np.errstate(invalid="ignore"):
        straight = np.all(second_order < _LARGEST_BEND * first_order, axis=1)
        # where the image folds, one cell holds forces further apart than its slopes allow
        single = np.all(extent < _LARGEST_EXTENT * (2 * first_order), axis=1)
    steep = np.abs(inverse[:, 0]).max(axis=1) >= _LARGEST_SLOPE_N_PER_DEG
    return (error < 1e-3) & straight & single & ~steep


def _all_in_span(in_span, force, location, reach):
    """Whether the cell's four corners, and a little beyond, lie within the span; bool (R,)."""
    reach = np.abs(reach).sum(axis=2)
    inside = np.ones(len(force), bool)
    with np.errstate(invalid="ignore"):
        for a in (-1, 1):
            for b in (-1, 1):
                inside &= in_span(force + a * reach[:, 0], location + b * reach[:, 1])
    return inside


def _subdivide(nodes, pieces):
    """Nodes with every interval cut into at least ``pieces`` (one number per interval) parts."""
    count = np.maximum(np.ceil(pieces).astype(int), 1)
    parts = [
        np.linspace(a, b, n, endpoint=False)
        for a, b, n in zip(nodes[:-1], nodes[1:], count, strict=True)
    ]
    return np.concatenate([*parts, nodes[-1:]])


def _inverse(slopes):
    """Inverses of 2 x 2 matrices (n, 2, 2); infinite where singular."""
    a, b, c, d = (slopes[:, i, j] for i in (0, 1) for j in (0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / (a * d - b * c)
        return np.stack([d, -b, -c, a], axis=-1).reshape(-1, 2, 2) * scale[:, None, None]


def _second_derivatives(inverse, curvatures):
    """Second derivatives (11, 12, 22) of force and location by the phases; shape (n, 2, 3)."""
    ff, fl, ll = (curvatures[..., i] for i in range(3))
    hessian = np.stack([ff, fl, fl, ll], axis=-1).reshape(*ff.shape, 2, 2)
    with np.errstate(invalid="ignore"):
        bent = np.einsum("nai,npab,nbj->npij", inverse, hessian, inverse, optimize=True)
        second = -np.einsum("nkp,npij->nkij", inverse, bent)
    return np.stack([second[..., 0, 0], second[..., 0, 1], second[..., 1, 1]], axis=-1)
