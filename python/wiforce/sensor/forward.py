# SPDX-License-Identifier: GPL-3.0-or-later
"""A model tabulated for inversion: phases, their derivatives and their model error."""

from functools import cached_property

import numpy as np

from ..errors import InputError
from .splines import node_slopes

_FORCE_NODES = 160
_LOCATION_STEP_MM = 0.5
# How far beyond the calibration a solution is looked for. It is flagged as extrapolated.
_MARGIN_MM = 6.0
_MARGIN_FORCE = 0.25
# A short nearer to an end than this is not looked for.
_CLEAR_OF_END_MM = 1.0
# Degrees turned over all forces times those over all locations: 2.4 GHz on 80 mm have 30 000.
_MOST_TURNS_DEG2 = 500_000.0


class ForwardMap:
    """Phases at every carrier asked for, over the domain in which solutions are looked for.

    Phases are not wrapped: they are smooth over the domain.

    Parameters
    ----------
    model : SensorModel
    carriers : sequence of int

    Attributes
    ----------
    force_n, location_mm : ndarray
        Nodes; the domain is between the first and the last.
    size : int
        Phases per point, P = 2 per carrier.

    Raises
    ------
    InputError
        When the model's phases are not finite, or turn on and on.
    """

    def __init__(self, model, carriers):
        low, high = model.force_span_n
        first, last = model.location_span_mm
        top = high + _MARGIN_FORCE * (high - low)
        self.force_n = np.geomspace(model.onset_force_n, top, _FORCE_NODES)
        start = max(first - _MARGIN_MM, _CLEAR_OF_END_MM)
        stop = min(last + _MARGIN_MM, model.length_mm - _CLEAR_OF_END_MM)
        count = int(np.ceil((stop - start) / _LOCATION_STEP_MM)) + 1
        self.location_mm = np.linspace(start, stop, count)
        # Broadcast, so that the curves over force are evaluated once for all locations.
        grid = self.force_n[:, None], self.location_mm[None]
        shape = len(self.force_n), count, 2
        self.phase_deg = np.concatenate(
            [np.broadcast_to(model.short_deg(*grid, c), shape) for c in carriers], axis=-1
        )
        self._variance_deg2 = np.concatenate(
            [np.broadcast_to(model.carrier_std_deg(*grid, c), shape) ** 2 for c in carriers],
            axis=-1,
        )
        _check_turns(self.phase_deg, f"sensor {model.name}: phases")
        self.size = self.phase_deg.shape[-1]
        self._log_force = np.log(self.force_n)

    @cached_property
    def _phase(self):
        return self._splines(self.phase_deg, 3)

    @cached_property
    def _variance(self):
        return self._splines(self._variance_deg2, 1)

    def _splines(self, values, degree):
        from scipy.interpolate import RectBivariateSpline  # readings need the nodes alone

        axes = self._log_force, self.location_mm
        planes = np.moveaxis(values, -1, 0)
        return [RectBivariateSpline(*axes, plane, kx=degree, ky=degree, s=0) for plane in planes]

    def phases(self, force_n, location_mm):
        """Shape (n, P), degrees, not wrapped."""
        return self._evaluate(self._phase, force_n, location_mm)

    def variances(self, force_n, location_mm):
        """Variance of the phases from what the calibration left open; shape (n, P)."""
        return np.maximum(self._evaluate(self._variance, force_n, location_mm), 0.0)

    def slopes(self, force_n, location_mm):
        """Derivatives by force and by location; shape (n, P, 2)."""
        by_force = self._evaluate(self._phase, force_n, location_mm, 1, 0)
        by_location = self._evaluate(self._phase, force_n, location_mm, 0, 1)
        return np.stack([by_force / np.asarray(force_n)[:, None], by_location], axis=-1)

    def table(self):
        """At every node, what ``lib/kernel/inversion/tabulated_model.h`` interpolates.

        Returns
        -------
        ndarray, shape (forces, locations, P, 5)
            Phases, their derivatives by the logarithm of force, by location and by both, and
            their variances.
        """
        phase = self.phase_deg
        by_force = np.tensordot(node_slopes(self._log_force), phase, 1)
        across = node_slopes(self.location_mm)
        by_location, by_both = (across @ values for values in (phase, by_force))
        return np.stack([phase, by_force, by_location, by_both, self._variance_deg2], axis=-1)

    def _evaluate(self, splines, force_n, location_mm, dx=0, dy=0):
        log_force = np.log(force_n)
        return np.stack([s.ev(log_force, location_mm, dx=dx, dy=dy) for s in splines], axis=-1)

    def clip(self, force_n, location_mm):
        """Force and location brought into the domain."""
        return (
            np.clip(force_n, self.force_n[0], self.force_n[-1]),
            np.clip(location_mm, self.location_mm[0], self.location_mm[-1]),
        )


def _check_turns(phase_deg, where):
    """Refuses curves drawn through an error: the table of their inverse would have no end."""
    turns = [np.abs(np.diff(phase_deg, axis=a)).max(axis=(1 - a, 2)).sum() for a in (0, 1)]
    if not turns[0] * turns[1] <= _MOST_TURNS_DEG2:
        rule = "must turn less over forces and locations"
        raise InputError(where, rule, " and ".join(f"{turn:.3g} deg" for turn in turns))
