# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of a tag that is known not to move, whose sensor is not known yet.

The reader tells a touch from a motion of the tag by the model of the sensor: a press in the middle
of the line changes both phases alike, as a motion does. Before a sensor is calibrated there is no
model to decide by. A tag that lies still, as during a calibration, needs none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..estimation.groups import Groups
from ..estimation.phases.off_state import corrected_phase_deg
from ..io.readings import Reading, flag_words
from .stage_flags import stages_of

# Change of a phase by which the line is touched. The shorted line differs from the open one by much
# more at one end at least (docs/sensors.md), drift between two tares by much less.
_TOUCHED_DEG = 6.0


def uncalibrated_readings(
    groups: Groups,
    sensor: int,
    name: str,
    untouched_deg: ArrayLike,
    off_reflection: ArrayLike,
    group_period_s: float,
) -> list[Reading]:
    """Touch, phases and flags of one sensor, without force and location; one reading per group.

    ``untouched_deg`` is psi_10 and psi_20, ``off_reflection`` G_off / rho, per switch where they
    differ. Phases refer to the untouched reference alone: no drift is subtracted.
    """
    ends = slice(2 * sensor, 2 * sensor + 2)
    ratios = groups.ratios[:, ends]
    _, known = stages_of(group_period_s).of(vars(groups), sensor, np.zeros((len(groups), 3)))
    with np.errstate(invalid="ignore"):
        phases, _ = corrected_phase_deg(ratios, untouched_deg, off_reflection)
    touched = np.abs(np.degrees(np.angle(ratios))).max(axis=1) > _TOUCHED_DEG
    readings = []
    for row, each in enumerate(known):
        found = (None, None, None)
        if each["readable"]:
            found = (int(touched[row]), *phases[row].tolist())
        readings.append(
            Reading(
                (int(each["group"]) + 0.5) * group_period_s,
                name,
                found[0],
                phase1_deg=found[1],
                phase2_deg=found[2],
                flags=flag_words(int(each["flags"])),
                group=int(each["group"]),
                interference=float(each["interference"]),
            )
        )
    return readings
