# SPDX-License-Identifier: GPL-3.0-or-later
"""The explanations that the press filter keeps, as arrays over the groups of a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..estimation.groups import Array
from ..wiforce_kernels import press_filter

if TYPE_CHECKING:
    from ..sensor.model import SensorModel

# States of a sensor, as in lib/kernel/press/press_filter.h.
UNTOUCHED, PRESSED, UNEXPLAINED, MIXED = range(4)
# Of a row of the kernel.
COLUMNS = 16
# The image of presses: forces from the onset to 1.3 times the calibrated one, since harder presses
# are presses as well, and the error of models that has been seen in calibrations (docs/press.md).
_FORCES, _BEYOND, _STEP_MM, _SPREAD_DEG = 80, 1.3, 0.25, 1.5
_LEAST_FORCE_N = 0.05


class Explanations(NamedTuple):
    """What may have happened in the groups of a batch; m explanations of G groups.

    Attributes
    ----------
    row : ndarray of int, shape (m,)
        Group of each explanation, rising; the likeliest of each group comes first.
    weight : ndarray, shape (m,)
        Probability.
    state : ndarray of int, shape (m,)
        What the sensor is.
    known : ndarray of bool, shape (m,)
        Whether the untouched line has been seen.
    turns : ndarray of bool, shape (m,)
        Whether the tag or an antenna turns in the group.
    baseline : ndarray, shape (m, 2)
        arg R of the untouched line, rad.
    common_variance, difference_variance : ndarray, shape (m,)
        Of the mean and the difference of both, rad^2.
    amplitude : ndarray, shape (m,)
        ln |R| of the untouched line.
    ratios : ndarray of complex, shape (m, 2)
        R, averaged over the groups for as long as nothing has changed.
    variance : ndarray, shape (m, 2)
        Of arg R by the noise of these groups, rad^2.
    """

    row: Array
    weight: Array
    state: Array
    known: Array
    turns: Array
    baseline: Array
    common_variance: Array
    difference_variance: Array
    amplitude: Array
    ratios: Array
    variance: Array

    @staticmethod
    def of(table: Array, first: int = 0) -> Explanations:
        """Explanations of rows as the kernel gives them, of groups from index ``first`` on."""
        whole = table[:, [0, 2]].astype(int)
        return Explanations(
            whole[:, 0] + first,
            table[:, 1],
            whole[:, 1],
            table[:, 3] > 0,
            table[:, 4] > 0,
            table[:, 5:7],
            table[:, 7],
            table[:, 8],
            table[:, 9],
            np.exp(table[:, 12:14] + 1j * table[:, 10:12]),
            table[:, 14:16],
        )

    @staticmethod
    def concatenate(parts: list[Explanations]) -> Explanations:
        """Join the explanations of batches that follow each other."""
        if len(parts) == 1:
            return parts[0]
        return Explanations(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))

    def later(self, groups: int) -> Explanations:
        """The same of groups that are so many rows later."""
        return self._replace(row=self.row + groups)

    def choose(self, rows: Array) -> Explanations:
        """Some explanations, by index or mask."""
        return Explanations(*(array[rows] for array in self))

    def probability(self, which: Array, groups: int) -> Array:
        """Sum of the weights of some explanations, by mask, in each group; shape (G,)."""
        return np.bincount(self.row, self.weight * which, minlength=groups)[:groups]

    def likeliest(self, groups: int) -> tuple[Array, Array]:
        """Index of the likeliest explanation of each group, and whether there is one; (G,)."""
        first = np.searchsorted(self.row, np.arange(groups))
        there = np.zeros(groups, bool)
        there[self.row] = True
        return np.where(there, first, 0), there


def filter_of(
    model: SensorModel, frequency_hz: float, off_reflection: ArrayLike, **parameters: Any
) -> press_filter:
    """Make the press filter of a sensor.

    Parameters
    ----------
    model : SensorModel
    frequency_hz : float
        Carrier, in Hz.
    off_reflection : complex or array_like of two
        G_off / rho, per switch where they differ.
    **parameters
        Of ``lib/kernel/press/press_parameters.h``, where they differ from the defaults.

    Returns
    -------
    press_filter
    """
    onset = max(model.onset_force_n, _LEAST_FORCE_N)
    forces = np.geomspace(onset, _BEYOND * model.force_span_n[1], _FORCES)
    locations = np.arange(_STEP_MM, model.length_mm, _STEP_MM)
    phases = np.reshape(
        model.phases_deg(forces[:, None], locations[None], frequency_hz),
        (len(forces), len(locations), 2),
    )
    untouched = np.exp(1j * np.radians(model.untouched_deg(frequency_hz)))
    off = np.asarray(off_reflection, complex)
    ratios = (np.exp(1j * np.radians(phases)) - off) / (untouched - off)
    # A reflective off state changes the amplitude by the press; contacts that lose some of it add.
    spread = float(np.log(np.abs(ratios)).mean(axis=2).std())
    if spread > 0:
        parameters["contact_np"] = float(np.hypot(parameters.get("contact_np", 0.05), spread))
    step = float(np.log(forces[1] / forces[0]))
    return press_filter(np.angle(ratios), step, np.radians(_SPREAD_DEG), parameters)
