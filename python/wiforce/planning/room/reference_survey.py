# SPDX-License-Identifier: GPL-3.0-or-later
"""The survey of the room in the untouched reference of a run."""

from __future__ import annotations

import numpy as np

from ...estimation.capture.frame_slip import without_slip
from ...estimation.room.survey import LONGEST_S, SHORTEST_S, Survey, survey_folded
from ..plan import Plan


def surveyed_snapshots(plan: Plan) -> int:
    """Number of snapshots that the room is surveyed in, from the start of the reference on.

    Returns int: 0 where there is no survey: the reference is shorter than 0.1 s.

    Parameters
    ----------
    plan : Plan
        Of a scene.
    """
    period_s = plan.waveform.snapshot_period_s
    longest = int(min(plan.require_scene().reference_s, LONGEST_S) / period_s)
    if longest < 1:
        return 0
    # A power of two is quicker to transform.
    count = 1 << (longest.bit_length() - 1)
    return count if count * period_s >= SHORTEST_S else 0


def survey_reference(plan: Plan, snapshots: np.ndarray, folded: np.ndarray) -> Survey | None:
    """Survey the room in the longest run of the reference's snapshots without a gap or slip.

    Returns Survey or None: None where fewer than 0.1 s are free of gaps.

    Parameters
    ----------
    plan : Plan
        Of a scene.
    snapshots : ndarray of int, shape (n,)
        Indices of snapshots, rising, 0 for the first one of the reference. Those that do not
        belong to the surveyed part are left out, and so are snapshots that are not finite.
    folded : ndarray of complex, shape (n, 64)
        Their folded frames; of two antennas, those of their ratio.
    """
    count = surveyed_snapshots(plan)
    whole = (snapshots < count) & np.isfinite(folded).all(axis=1)
    snapshots, folded = snapshots[whole], folded[whole]
    if not len(snapshots):
        return None
    runs = np.split(folded, np.flatnonzero(np.diff(snapshots) > 1) + 1)
    folded = without_slip(max(runs, key=len))
    mains_hz = plan.require_scene().environment.possible_mains_hz
    return survey_folded(folded, plan.waveform, plan.clocks, mains_hz)
