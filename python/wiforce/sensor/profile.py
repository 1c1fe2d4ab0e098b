# SPDX-License-Identifier: GPL-3.0-or-later
"""Two phases to force and location where the likelihood is wide: its profile over force.

At a given force the two phases leave one thing open, the location. What the best location leaves of
the phases' error is a single number z, in standard deviations; as a function of force it crosses
zero at every solution and hardly changes where force is hidden. The likelihood ``exp(-z^2 / 2)`` is
integrated by ``lib/kernel/inversion/likelihood_profile.h``.

For every cell of the plane of phases that the model's image comes near, a row holds what gives z
and the location at each node. Where a turn of phase brings another location near (62 mm away at
2.4 GHz), the cell has a row for each.
"""

import numpy as np

from ..signal.carrier import wrap_deg
from ..wiforce_kernels import likelihood_profile

_FORCES = 24
_CELL_DEG = 2.0
_CELLS = round(360 / _CELL_DEG)
# Cells this far from the model's image hold no reading that fits.
_REACH_CELLS = 4
# Locations further apart than this are different turns of phase, not one wide likelihood.
_TURN_MM = 25.0
# A phase error of more than this at a node is no error of that node but of another turn.
_FAR_DEG = 60.0
# Newtons per degree, beyond any that matters.
_MOST_FREE = 1e6
_AT_ONCE = 64


def tabulate(forward, in_span, free_n_per_deg):
    """The profiles of one carrier, for every pair of phases.

    Parameters
    ----------
    forward : ForwardMap
    in_span : callable
        ``in_span(force_n, location_mm)``: whether that was calibrated.
    free_n_per_deg : callable
        Newtons per degree of phase error at (force, location), 0 where force is not hidden.

    Returns
    -------
    likelihood_profile
        Its ``read(phases_deg, variance_deg2)``, both (n, 2), gives rows (n, 9): force, location,
        their variances and covariance; misfit of the best solution in squared standard deviations;
        parts of the likelihood where force is hidden, and outside the calibrated span; 1 where
        another solution fits about as well, with a barrier between. NaN where another turn of
        phase comes near, or none.
    """
    nodes = np.geomspace(forward.force_n[0], forward.force_n[-1], _FORCES)
    force, location = np.meshgrid(nodes, forward.location_mm, indexing="ij")
    flat, shape = (force.ravel(), location.ravel()), (*force.shape, 2)
    phase = forward.phases(*flat).reshape(shape)
    grid = (
        forward.location_mm,
        phase,
        forward.slopes(*flat)[..., 1].reshape(shape),
        forward.variances(*flat).reshape(shape),
        np.minimum(free_n_per_deg(force, location), _MOST_FREE),
        in_span(force, location),
    )
    near = _cells_near(forward.phase_deg)
    parts = [
        _rows_of(near[start : start + _AT_ONCE], grid) for start in range(0, len(near), _AT_ONCE)
    ]
    owner = np.concatenate([part[0] for part in parts])
    rows = np.moveaxis(np.concatenate([part[1] for part in parts], axis=1), 0, 1)
    holds = np.concatenate([part[2] for part in parts])
    cells = np.zeros((_CELLS**2, 2), np.int32)  # first row and number of rows of each
    present, *first_and_count = np.unique(owner, return_index=True, return_counts=True)
    cells[present] = np.stack(first_and_count, axis=-1)
    return likelihood_profile(nodes, rows, holds, cells)


def _rows_of(cells, grid):
    """Owners (R,), rows (columns, R, K) and which segments hold (R, K - 1) of some cells."""
    places, phase, slope, variance, free, inside = grid
    error = wrap_deg(_centres(cells)[:, None, None] - phase)
    away = np.sum(error**2, axis=-1)
    owner, taken = _turns(away.min(axis=1), places)
    away = np.where(taken[:, None], away[owner], np.inf)
    nearest = np.argmin(away, axis=2)
    node = np.arange(_FORCES)
    error = error[owner[:, None], node, nearest]
    slope, variance = slope[node, nearest], variance[node, nearest]
    move = np.sum(slope * error, axis=-1) / np.maximum(np.sum(slope**2, axis=-1), 1e-12)
    step = places[1] - places[0]
    held = np.abs(move) <= step
    move = np.clip(move, -step, step)
    error = error - slope * move[..., None]
    columns = [places[nearest] + move, *np.moveaxis(error, -1, 0)]
    columns += [*np.moveaxis(slope, -1, 0), *np.moveaxis(variance, -1, 0)]
    columns += [free[node, nearest], inside[node, nearest]]
    holds = held & np.all(np.abs(error) < _FAR_DEG, axis=-1)
    jumps = np.abs(np.diff(columns[0], axis=1)) > 0.5 * _TURN_MM
    return cells[owner], np.array(columns, float), holds[:, 1:] & holds[:, :-1] & ~jumps


def _cells_near(phase_deg):
    """Cells that the image of the model (forces, locations, 2) comes near."""
    reached = np.zeros((_CELLS, _CELLS), bool)
    # corners of the map's own grid are closer than the reach: nothing between is missed
    cell = np.floor(phase_deg / _CELL_DEG).astype(np.int64) % _CELLS
    reached[cell[..., 0], cell[..., 1]] = True
    for axis in (0, 1):
        reached = np.any(
            [np.roll(reached, r, axis) for r in range(-_REACH_CELLS, _REACH_CELLS + 1)], axis=0
        )
    return np.flatnonzero(reached)


def _centres(cells):
    return (np.stack([cells // _CELLS, cells % _CELLS], axis=-1) + 0.5) * _CELL_DEG


def _turns(away, location):
    """Owner (R,) and locations (R, L) of every row: one per cell, two where a turn of phase brings

    another location as near. ``away`` (C, L) is the least squared distance at each location.
    """
    best = location[np.argmin(away, axis=1)]
    other = np.where(np.abs(location - best[:, None]) > _TURN_MM, away, np.inf)
    second = location[np.argmin(other, axis=1)]
    both = other.min(axis=1) < (_REACH_CELLS * _CELL_DEG) ** 2
    middle = 0.5 * (best + second)
    below = np.where(both[:, None], location < middle[:, None], True)
    owner = np.concatenate([np.arange(len(away)), np.flatnonzero(both)])
    taken = np.concatenate([below, ~below[both]])
    order = np.argsort(owner, kind="stable")
    return owner[order], taken[order]
