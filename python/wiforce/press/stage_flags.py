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
    flagged = [
        _either(groups.in_reference, sensor) | groups.in_tare,
        groups.missing > 0,
        groups.saturated,
        _either(groups.reshaped, sensor),
        groups.overlapping[:, sensor] | _either(groups.late_reference, sensor),
    ]
    return np.asarray(_BITS @ np.array(flagged, np.int64))


def has_phases(groups: Groups, sensor: int) -> Array:
    """Whether the groups determine the phases of a sensor; bool, shape (G,)."""
    lost = groups.overlapping[:, sensor] | ~groups.locked[:, sensor]
    lost |= _either(~np.isfinite(groups.phase_std_deg), sensor)
    return np.asarray(~(lost | _either(groups.ratios == 0, sensor)))


def _either(ends: Array, sensor: int) -> Array:
    """Whether it is so at one of both ends of a sensor; (G,) of (G, 2S)."""
    return np.asarray(ends[:, 2 * sensor] | ends[:, 2 * sensor + 1])
