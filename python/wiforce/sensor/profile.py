# SPDX-License-Identifier: GPL-3.0-or-later
"""Two phases to force and location where the likelihood is wide: its profile over force.

At a given force the two phases leave one thing open, the location. What the best location leaves of
the phases' error is a single number z, in standard deviations; as a function of force it crosses
zero at every solution and hardly changes where force is hidden. The likelihood ``exp(-z^2 / 2)`` is
integrated by ``lib/kernel/likelihood_profile.h``.

For every cell of the plane of phases that the model's image comes near, a row holds what gives z
and the location at each node. Where a turn of phase brings another location near (62 mm away at
2.4 GHz), the cell has a row for each.
"""

import numpy as np

from ..angles import wrap_deg
from ..wiforce_numerics import likelihood_profile

_FORCES = 24
_CELL_DEG = 2.0
_CELLS = round(360 / _CELL_DEG)
# Cells this far from the model's image hold no reading that fits.
_REACH_CELLS = 4
# Locations further apart than this are different turns of phase, not one wide likelihood.
_TURN_MM = 25.0
# A phase error of more than this at a node is no error of that node but of another turn.
_FAR_DEG = 60.0
_AT_ONCE = 64


class ProfileTable:
    """Profiles of one carrier.

    Parameters
    ----------
    forward : ForwardMap
    in_span : callable
        ``in_span(force_n, location_mm)``: whether that was calibrated.
    free_n_per_deg : callable
        Newtons per degree of phase error at (force, location), 0 where force is not hidden.

    Attributes
    ----------
    first, count : ndarray of int32
        First row and number of rows of each cell; 0 rows where no reading fits.
    """

    def __init__(self, forward, in_span, free_n_per_deg):
        self._force = np.geomspace(forward.force_n[0], forward.force_n[-1], _FORCES)
        self._location = forward.location_mm
        force, location = np.meshgrid(self._force, self._location, indexing="ij")
        flat, shape = (force.ravel(), location.ravel()), (*force.shape, 2)
        phase = forward.phases(*flat).reshape(shape)
        grid = (
            phase,
            forward.slopes(*flat)[..., 1].reshape(shape),
            forward.variances(*flat).reshape(shape),
            free_n_per_deg(force, location),
            in_span(force, location),
        )
        cells = _cells_near(forward.phase_deg)
        parts = [
            self._rows_of(cells[start : start + _AT_ONCE], grid)
            for start in range(0, len(cells), _AT_ONCE)
        ]
        owner = np.concatenate([part[0] for part in parts])
        rows = np.moveaxis(np.concatenate([part[1] for part in parts], axis=1), 0, 1)
        holds = np.concatenate([part[2] for part in parts])
        self._profile = likelihood_profile(self._force, rows, holds)
        present, first, count = np.unique(owner, return_index=True, return_counts=True)
        self.first, self.count = np.zeros((2, _CELLS**2), np.int32)
        self.first[present], self.count[present] = first, count

    def _rows_of(self, cells, grid):
        """Owners (R,), rows (columns, R, K) and which segments hold (R, K - 1) of some cells."""
        phase, slope, variance, free, inside = grid
        error = wrap_deg(_centres(cells)[:, None, None] - phase)
        away = np.sum(error**2, axis=-1)
        owner, taken = _turns(away.min(axis=1), self._location)
        away = np.where(taken[:, None], away[owner], np.inf)
        nearest = np.argmin(away, axis=2)
        node = np.arange(_FORCES)
        error = error[owner[:, None], node, nearest]
        slope, variance = slope[node, nearest], variance[node, nearest]
        move = np.sum(slope * error, axis=-1) / np.maximum(np.sum(slope**2, axis=-1), 1e-12)
        step = self._location[1] - self._location[0]
        held = np.abs(move) <= step
        move = np.clip(move, -step, step)
        error = error - slope * move[..., None]
        columns = [self._location[nearest] + move, *np.moveaxis(error, -1, 0)]
        columns += [*np.moveaxis(slope, -1, 0), *np.moveaxis(variance, -1, 0)]
        columns += [free[node, nearest], inside[node, nearest]]
        holds = held & np.all(np.abs(error) < _FAR_DEG, axis=-1)
        jumps = np.abs(np.diff(columns[0], axis=1)) > 0.5 * _TURN_MM
        return cells[owner], np.array(columns, float), holds[:, 1:] & holds[:, :-1] & ~jumps

    def cells(self, phases_deg):
        """Cell of each pair (n, 2), and where in it they lie, degrees from its centre."""
        scaled = phases_deg / _CELL_DEG
        cell = np.floor(scaled)
        offset = (scaled - cell - 0.5) * _CELL_DEG
        cell = np.mod(cell, _CELLS).astype(np.int64)
        return cell[:, 0] * _CELLS + cell[:, 1], offset

    def read(self, rows, offset_deg, variance_deg2):
        """Readings by one row each.

        Parameters
        ----------
        rows : ndarray of int, shape (n,)
        offset_deg, variance_deg2 : ndarray, shape (n, 2)

        Returns
        -------
        ndarray, shape (n, 9)
            Force, location, their variances and covariance; misfit of the best solution in squared
            standard deviations; parts of the likelihood where force is hidden, and outside the
            calibrated span; 1 where another solution fits about as well, with a barrier between.
        """
        return self._profile.read(rows, offset_deg, variance_deg2)

    def read_cells(self, phases_deg, variance_deg2):
        """As :meth:`read`, of phases (n, 2) by their cell's row; NaN unless there is one."""
        cell, offset = self.cells(phases_deg)
        found = self.read(self.first[cell], offset, variance_deg2)
        found[self.count[cell] != 1] = np.nan
        return found

    def read_one(self, psi_1, psi_2, variance_1, variance_2):
        """One reading of numbers, without arrays: a tuple as the rows of :meth:`read`.

        None where its cell has not exactly one row.
        """
        psi_1, psi_2 = psi_1 / _CELL_DEG, psi_2 / _CELL_DEG
        cell_1, cell_2 = int(psi_1 // 1), int(psi_2 // 1)
        cell = cell_1 % _CELLS * _CELLS + cell_2 % _CELLS
        if self.count[cell] != 1:
            return None
        offset_1 = (psi_1 - cell_1 - 0.5) * _CELL_DEG
        offset_2 = (psi_2 - cell_2 - 0.5) * _CELL_DEG
        return self._profile.read_one(self.first[cell], offset_1, offset_2, variance_1, variance_2)


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
