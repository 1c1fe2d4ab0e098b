# SPDX-License-Identifier: GPL-3.0-or-later
"""The least-squares fit of the tags' ends to the tones of groups, as a value."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..clocks.joint_clock import PhaseExpansion
from ..group_tones import power_of
from ..groups import Array


@dataclass(slots=True)
class GroupFit:
    """Whitened tones = white @ ends + residual, for the E ends of the locked tags in G groups.

    Attributes
    ----------
    rows : ndarray of int, shape (E,)
        The ends that were fitted, among those of all tags.
    ends : ndarray of complex, shape (G, E, K)
        V.
    gain : ndarray, shape (G, E)
        Variance of V over that of H.
    residual : ndarray of complex, shape (G, M, K)
        Whitened; without what the wander of a clock explains where ``solve`` made the fit.
    white : ndarray of complex, shape (G, M, E)
        The mixing matrix W [s1, s2, ...], whitened.
    solver : ndarray of complex, shape (G, E, M)
        Its pseudo-inverse.
    slopes : ndarray of complex, shape (G, M, E)
        Derivatives of ``white`` by each tag's clock phase.
    """

    rows: Array
    ends: Array
    gain: Array
    residual: Array
    white: Array
    solver: Array
    slopes: Array

    def noise(self) -> Array:
        """Mean square of the residual per degree of freedom; shape (G, K)."""
        return power_of(self.residual).sum(axis=1) / self.freedom

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residual of a group on one subcarrier."""
        return max(self.residual.shape[1] - len(self.rows), 1)

    def of_tones(self, tones: Array) -> GroupFit:
        """The fit of other whitened tones of the same groups at the same clocks.

        Parameters
        ----------
        tones : ndarray of complex, shape (G, M, K)
        """
        ends, residual = ends_and_residual(self.white, self.solver, tones)
        return replace(self, ends=ends, residual=residual)

    def expansion(self) -> PhaseExpansion:
        """The fit as a function of the clocks' phases."""
        return PhaseExpansion.of(self.white, self.solver, self.slopes, self.ends, self.residual)


def ends_and_residual(white: Array, solver: Array, tones: Array) -> tuple[Array, Array]:
    """Ends of whitened tones, and what the ends do not explain.

    Parameters
    ----------
    white : ndarray of complex, shape (G, M, E)
    solver : ndarray of complex, shape (G, E, M)
    tones : ndarray of complex, shape (G, M, K)

    Returns
    -------
    ends : ndarray of complex, shape (G, E, K)
    residual : ndarray of complex, shape (G, M, K)
    """
    ends = solver @ tones
    residual = white @ ends
    return ends, np.subtract(tones, residual, out=residual)
