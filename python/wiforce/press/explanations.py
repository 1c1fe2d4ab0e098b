# SPDX-License-Identifier: GPL-3.0-or-later
"""What the press filter says of the groups of a batch, as structured arrays of its outcomes.

``row`` is the group of each of m outcomes, rising; the likeliest of a group comes first. The other
fields are those of ``press_outcome`` in lib/kernel/press/explanation.h.
"""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..estimation.groups import Array
from ..wiforce_kernels import press_filter, press_outcome, press_parameters

if TYPE_CHECKING:
    from ..sensor.model import SensorModel

# Of ``press_state`` in lib/kernel/press/explanation.h.
UNTOUCHED, PRESSED, UNEXPLAINED, MIXED = range(4)
# The image of presses: forces from the onset to 1.3 times the calibrated one, since harder presses
# are presses as well, and the error of models that has been seen in calibrations (docs/press.md).
_FORCES, _BEYOND, _STEP_MM, _SPREAD_DEG = 80, 1.3, 0.25, 1.5
_LEAST_FORCE_N = 0.05

NOTHING: Array = np.zeros(0, press_outcome)


def later(found: Array, groups: int) -> Array:
    """The same outcomes (m,) of groups that are so many rows later."""
    found = found.copy()
    found["row"] += groups
    return found


def filter_of(
    model: SensorModel,
    frequency_hz: float,
    off_reflection: ArrayLike,
    off_std: float = 0.0,
    **parameters: float,
) -> press_filter:
    """Make the press filter of a sensor at a carrier in Hz.

    ``off_reflection`` is G_off / rho, per switch where they differ, and ``off_std`` the standard
    deviation of both its parts; ``parameters`` are those of lib/kernel/press/press_parameters.h
    that differ.
    """
    off = np.broadcast_to(np.asarray(off_reflection, complex), 2)
    both = complex(off[0]), complex(off[1])
    key = frequency_hz, both, off_std, *parameters.items()
    if model.newest.get("press filter", [None])[0] != key:
        made = _new_filter(model, frequency_hz, both, off_std, **parameters)
        model.newest["press filter"] = key, made
    return copy(model.newest["press filter"][1])


def _new_filter(
    model: SensorModel,
    frequency_hz: float,
    off: tuple[complex, complex],
    off_std: float,
    **parameters: float,
) -> press_filter:
    """The filter that is copied for sensors of the same model, since its image takes 20 ms."""
    values = press_parameters.copy()
    for name, value in parameters.items():
        values[name] = value
    onset = max(model.onset_force_n, _LEAST_FORCE_N)
    forces = np.geomspace(onset, _BEYOND * model.force_span_n[1], _FORCES)
    locations = np.arange(_STEP_MM, model.length_mm, _STEP_MM)
    phases = np.reshape(
        model.phases_deg(forces[:, None], locations[None], frequency_hz),
        (len(forces), len(locations), 2),
    )
    untouched_rad = np.radians(model.untouched_deg(frequency_hz))
    untouched = np.exp(1j * untouched_rad)
    ratios = (np.exp(1j * np.radians(phases)) - off) / (untouched - np.array(off))
    presses = np.angle(ratios), np.radians(_SPREAD_DEG), values
    return press_filter(*presses, untouched_rad.tolist(), off, off_std)
