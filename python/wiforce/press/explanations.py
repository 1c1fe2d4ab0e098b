# SPDX-License-Identifier: GPL-3.0-or-later
"""The explanations that the press filter keeps, as arrays over the groups of a batch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..estimation.groups import Array
from ..estimation.phases.off_state import off_states_differ
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


class Explanations:
    """What may have happened in the groups of a batch; m explanations of G groups.

    Parameters
    ----------
    row : ndarray of int, shape (m,)
        Group of each explanation, rising; the likeliest of each group comes first.
    table : ndarray, shape (m, 16)
        Rows as the kernel gives them.
    """

    def __init__(self, row: Array, table: Array) -> None:
        self.row, self._table = row, table

    @staticmethod
    def of(table: Array, first: int = 0) -> Explanations:
        """Explanations of rows as the kernel gives them, of groups from index ``first`` on."""
        return Explanations(table[:, 0].astype(int) + first, table)

    @property
    def weight(self) -> Array:
        """Probability; shape (m,)."""
        return self._table[:, 1]

    @property
    def state(self) -> Array:
        """What the sensor is; shape (m,)."""
        return self._table[:, 2]

    @property
    def known(self) -> Array:
        """Whether the untouched line has been seen; bool, shape (m,)."""
        return self._table[:, 3] > 0

    @property
    def turns(self) -> Array:
        """Whether the tag or an antenna turns in the group; bool, shape (m,)."""
        return self._table[:, 4] > 0

    @property
    def baseline(self) -> Array:
        """arg R of the untouched line, rad; shape (m, 2)."""
        return self._table[:, 5:7]

    @property
    def common_variance(self) -> Array:
        """Variance of the mean of both baselines, rad^2; shape (m,)."""
        return self._table[:, 7]

    @property
    def difference_variance(self) -> Array:
        """Variance of their difference, rad^2; shape (m,)."""
        return self._table[:, 8]

    @property
    def amplitude(self) -> Array:
        """ln |R| of the untouched line; shape (m,)."""
        return self._table[:, 9]

    @property
    def ratios(self) -> Array:
        """R, averaged over the groups for as long as nothing has changed; complex, shape (m, 2)."""
        found: Array = np.exp(self._table[:, 12:14] + 1j * self._table[:, 10:12])
        return found

    @property
    def variance(self) -> Array:
        """Variance of arg R by the noise of these groups, rad^2; shape (m, 2)."""
        return self._table[:, 14:16]

    @staticmethod
    def concatenate(parts: list[Explanations]) -> Explanations:
        """Join the explanations of batches that follow each other."""
        if len(parts) == 1:
            return parts[0]
        tables = [part._table for part in parts]
        return Explanations(np.concatenate([part.row for part in parts]), np.concatenate(tables))

    def later(self, groups: int) -> Explanations:
        """The same of groups that are so many rows later."""
        return Explanations(self.row + groups, self._table)

    def choose(self, rows: Array) -> Explanations:
        """Some explanations, by index or mask."""
        return Explanations(self.row[rows], self._table[rows])

    def turned(self, variance: Array) -> Explanations:
        """The same where both ends turned in the groups by phases of a variance (G,), rad^2."""
        table = self._table.copy()
        table[:, 7] += variance[self.row]
        return Explanations(self.row, table)

    def by_state(self, groups: int) -> Array:
        """Probability of each state in each group; shape (4, G)."""
        place = self.row + groups * self.state.astype(int)
        return np.bincount(place, self.weight, minlength=4 * groups).reshape(4, groups)

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
    model: SensorModel,
    frequency_hz: float,
    off_reflection: ArrayLike,
    off_std: float = 0.0,
    **parameters: Any,
) -> press_filter:
    """Make the press filter of a sensor.

    Parameters
    ----------
    model : SensorModel
    frequency_hz : float
        Carrier, in Hz.
    off_reflection : complex or array_like of two
        G_off / rho, per switch where they differ.
    off_std : float
        Standard deviation of its real and its imaginary part.
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
    untouched_rad = np.radians(model.untouched_deg(frequency_hz))
    untouched = np.exp(1j * untouched_rad)
    off = np.broadcast_to(np.asarray(off_reflection, complex), 2)
    ratios = (np.exp(1j * np.radians(phases)) - off) / (untouched - off)
    step = float(np.log(forces[1] / forces[0]))
    image = np.angle(ratios), step, np.radians(_SPREAD_DEG), parameters
    if off_states_differ(off, off_std):
        return press_filter(*image, untouched_rad.tolist(), off.tolist(), off_std)
    # A reflective off state changes the amplitude by the press; contacts that lose some of it add.
    spread = float(np.sqrt(np.mean(np.log(np.abs(ratios)).mean(axis=2) ** 2)))
    if spread > 0:
        parameters["contact_np"] = float(np.hypot(parameters.get("contact_np", 0.05), spread))
    return press_filter(*image)
