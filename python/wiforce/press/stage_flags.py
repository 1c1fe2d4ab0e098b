# SPDX-License-Identifier: GPL-3.0-or-later
"""What the stages before the readout say of a sensor's groups, whatever its model."""

from __future__ import annotations

import math

from ..io.readings import Flag
from ..wiforce_kernels import sensor_groups

# Probability that a sensor is untouched where the user says so, and where a tare was forced
# although it seemed to be touched.
CLAIMED, FORCED = 0.999, 0.5
# Flags of the stages before, in the order of the kernel.
_FLAGS = Flag.REFERENCE, Flag.GAP, Flag.SATURATED, Flag.MOVED, Flag.INCONSISTENT


def stages_of(
    group_period_s: float, least_snr_db: float = -math.inf, in_lamps: bool = False
) -> sensor_groups:
    """What takes the arrays of a batch for a sensor: observations of its phases, flags, SNR.

    Something is received on the tag's own lines that is no noise where the SNR is less than
    ``least_snr_db``, and ``in_lamps``.
    """
    bits = [flag.value for flag in _FLAGS]
    return sensor_groups(group_period_s, bits, CLAIMED, least_snr_db, in_lamps)
