# SPDX-License-Identifier: GPL-3.0-or-later
"""What the stages before the readout say of a sensor's groups, whatever its model."""

from __future__ import annotations

import numpy as np

from ..estimation.groups import Array, Groups
from ..io.readings import Flag

# The flags below, in their order.
_FLAGS = Flag.REFERENCE, Flag.GAP, Flag.SATURATED, Flag.MOVED, Flag.INCONSISTENT
_BITS = np.array([flag.value for flag in _FLAGS])


def stage_flags(groups: Groups, sensor: int) -> Array:
    """Flags of a sensor's groups by the collection of snapshots, separation and reference.

    Bits of ``io.readings.Flag``, shape (G,).
    """
    ends = slice(2 * sensor, 2 * sensor + 2)
    flagged = [
        _either(groups.in_reference[:, ends]) | groups.in_tare,
        groups.missing > 0,
        groups.saturated,
        _either(groups.reshaped[:, ends]),
        groups.overlapping[:, sensor] | _either(groups.late_reference[:, ends]),
    ]
    return np.asarray(_BITS @ np.array(flagged, np.int64))


def has_phases(groups: Groups, sensor: int) -> Array:
    """Whether the groups determine the phases of a sensor; bool, shape (G,)."""
    ends = slice(2 * sensor, 2 * sensor + 2)
    lost = groups.overlapping[:, sensor] | ~groups.locked[:, sensor]
    lost |= _either(~np.isfinite(groups.phase_std_deg[:, ends]))
    return np.asarray(~(lost | _either(groups.ratios[:, ends] == 0)))


def _either(ends: Array) -> Array:
    """Whether it is so at one of both ends; (G,) of (G, 2)."""
    return np.asarray(ends[:, 0] | ends[:, 1])
