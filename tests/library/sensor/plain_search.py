# SPDX-License-Identifier: GPL-3.0-or-later
"""A reference for the inversion: every solution, by a search over the whole model in NumPy."""

from dataclasses import dataclass

import numpy as np
from gnuradio.wiforce.signal.carrier import wrap_deg

_GRID_LOCATION_STEP = 2
_STARTS = 12
_STEPS = 12
# Two solutions are different when they are this far apart.
_APART_N, _APART_MM = 0.2, 1.0
# Solutions this much worse than the best are not solutions: 3 standard deviations.
_WORSE = 9.0
_HOPELESS = 100.0


@dataclass(frozen=True)
class Solutions:
    """All (force, location) that explain one reading, the best first.

    ``force_n``, ``location_mm``, ``chi_squared`` (s,): ``chi_squared`` is the sum of squared phase
    errors in standard deviations; ``covariance`` (s, 2, 2).
    """

    force_n: np.ndarray
    location_mm: np.ndarray
    chi_squared: np.ndarray
    covariance: np.ndarray


class Search:
    """Searches the whole domain of a forward map."""

    def __init__(self, forward):
        self._forward = forward
        self._force = forward.force_n
        self._location = forward.location_mm[::_GRID_LOCATION_STEP]
        self._phase = forward.phase_deg[:, ::_GRID_LOCATION_STEP]
        grid = np.meshgrid(self._force, self._location, indexing="ij")
        shape = (*self._phase.shape[:2], forward.size)
        flat = (grid[0].ravel(), grid[1].ravel())
        self._variance = forward.variances(*flat).reshape(shape)
        # neighbouring nodes differ by this much: no minimum between them is to be missed
        steps = [np.abs(np.gradient(self._phase, axis=axis)) for axis in (0, 1)]
        self._quantum = (0.5 * np.maximum(*steps)) ** 2

    def solutions(self, phases_deg, variance_deg2):
        """All solutions for one reading.

        Returns Solutions. ``phases_deg``, ``variance_deg2`` (P,).
        """
        force, location = self._starts(phases_deg, variance_deg2)
        force, location, chi_squared = self._refine(force, location, phases_deg, variance_deg2)
        order = np.argsort(chi_squared, kind="stable")
        kept = []
        for i in order:
            if chi_squared[i] > chi_squared[order[0]] + _WORSE:
                break
            apart = [
                abs(force[i] - force[k]) > _APART_N or abs(location[i] - location[k]) > _APART_MM
                for k in kept
            ]
            if all(apart):
                kept.append(i)
        force, location, chi_squared = force[kept], location[kept], chi_squared[kept]
        return Solutions(
            force, location, chi_squared, self._covariance(force, location, variance_deg2)
        )

    def _starts(self, phases_deg, variance_deg2):
        """Nodes of the grid that no neighbour beats, with some slack for its coarseness."""
        residual = wrap_deg(phases_deg - self._phase) ** 2
        chi_squared = np.sum(residual / (variance_deg2 + self._variance + self._quantum), axis=-1)
        padded = np.pad(chi_squared, 1, constant_values=np.inf)
        rows, columns = chi_squared.shape
        lowest = np.ones(chi_squared.shape, bool)
        for i in range(3):
            for j in range(3):
                lowest &= chi_squared <= padded[i : i + rows, j : j + columns]
        where = np.argwhere(lowest)
        where = where[np.argsort(chi_squared[lowest], kind="stable")[:_STARTS]]
        return self._force[where[:, 0]], self._location[where[:, 1]]

    def _refine(self, force, location, phases_deg, variance_deg2):
        """Gauss-Newton with step halving, within the domain; all starts at once."""
        forward = self._forward
        chi_squared = self._chi_squared(force, location, phases_deg, variance_deg2)
        for round_ in range(_STEPS):
            if round_ in (2, 5):
                # what is far off by now ends in a solution that others reach too, or in none
                hopeful = chi_squared <= chi_squared.min() + _HOPELESS
                force, location, chi_squared = (
                    force[hopeful],
                    location[hopeful],
                    chi_squared[hopeful],
                )
            weight = 1.0 / (variance_deg2 + forward.variances(force, location))
            slopes = forward.slopes(force, location)
            residual = wrap_deg(phases_deg - forward.phases(force, location))
            normal = np.einsum("npa,np,npb->nab", slopes, weight, slopes)
            right = np.einsum("npa,np,np->na", slopes, weight, residual)
            step = _bounded_step(normal, right, force, location, forward)
            moved = np.zeros(len(force), bool)
            for scale in (1.0, 0.5, 0.1):
                new = forward.clip(force + scale * step[:, 0], location + scale * step[:, 1])
                new_chi_squared = self._chi_squared(*new, phases_deg, variance_deg2)
                better = ~moved & (new_chi_squared < chi_squared)
                force = np.where(better, new[0], force)
                location = np.where(better, new[1], location)
                chi_squared = np.where(better, new_chi_squared, chi_squared)
                moved |= better
                if np.all(moved):
                    break
            if not np.any(moved) or np.max(np.abs(step[moved])) < 1e-4:
                break
        return force, location, chi_squared

    def _chi_squared(self, force, location, phases_deg, variance_deg2):
        residual = wrap_deg(phases_deg - self._forward.phases(force, location))
        variance = variance_deg2 + self._forward.variances(force, location)
        return np.sum(residual**2 / variance, axis=1)

    def _covariance(self, force, location, variance_deg2):
        weight = 1.0 / (variance_deg2 + self._forward.variances(force, location))
        slopes = self._forward.slopes(force, location)
        normal = np.einsum("npa,np,npb->nab", slopes, weight, slopes)
        # the domain itself bounds what can be unknown
        normal[:, 0, 0] += 1.0 / np.ptp(self._force) ** 2
        normal[:, 1, 1] += 1.0 / np.ptp(self._location) ** 2
        return np.linalg.inv(normal)


def _bounded_step(normal, right, force, location, forward):
    """Gauss-Newton steps (n, 2); along an edge of the domain where they would leave it."""
    damped = normal + 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(2)
    step = np.linalg.solve(damped, right[..., None])[..., 0]
    edges = (
        (force, forward.force_n, 0, 1),
        (location, forward.location_mm, 1, 0),
    )
    for value, nodes, held, free in edges:
        out = ((value <= nodes[0]) & (step[:, held] < 0)) | (
            (value >= nodes[-1]) & (step[:, held] > 0)
        )
        step[out, held] = 0.0
        step[out, free] = right[out, free] / damped[out, free, free]
    return step
