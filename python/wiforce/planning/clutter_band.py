# SPDX-License-Identifier: GPL-3.0-or-later
"""The clutter band of a scene, also of one that does not state it."""

from collections.abc import Sequence

import numpy as np

from ..estimation.clocks.tracked_tag import TagClock
from ..estimation.estimators import estimator_named
from ..scene import Scene
from ..signal.clutter import clutter_basis
from ..signal.lines import CLUTTER_MARGIN, centered_times_s
from .loss import end_variances

# Doppler of a person is 12 Hz at 900 MHz and 33 Hz at 2.4 GHz (2 m/s), that of a fan's blades 60 to
# 250 Hz.
BANDS_HZ = (250.0, 200.0, 150.0, 100.0, 60.0, 30.0)
# What rejecting clutter that may not exist may cost: 1.2 % of a standard deviation.
ACCEPTED_COST_DB = 0.1
# Longer groups resolve more, so that the same band costs less.
_LONGEST = 1250


def automatic_band_hz(
    clocks: Sequence[TagClock], group_length: int, snapshot_period_s: float, averaging_s: float
) -> float:
    """Widest clutter band that costs every end at most 0.1 dB.

    Rejecting a wide band from the start makes a room in which something begins to move as good as
    one in which it moved all the time, and costs nothing per sample.

    Returns float: in Hz, at most 250; 0 for groups that are too short to reject anything but the
    mean.

    Parameters
    ----------
    group_length : int
        Snapshots per phase group, N.
    snapshot_period_s, averaging_s : float
        T and Ta, in s.
    """
    group_length = min(group_length, _LONGEST)
    resolution_hz = 1 / (group_length * snapshot_period_s)
    highest_hz = min(clock.clock_hz for clock in clocks) - CLUTTER_MARGIN * resolution_hz
    times_s = centered_times_s(group_length, snapshot_period_s)
    still = end_variances(clocks, times_s, averaging_s, clutter_basis(group_length, 1.0, 0.0))
    for band_hz in BANDS_HZ:
        if band_hz >= highest_hz:
            continue
        clutter = clutter_basis(group_length, snapshot_period_s, band_hz)
        cost = end_variances(clocks, times_s, averaging_s, clutter) / still
        if 10 * np.log10(cost.max()) <= ACCEPTED_COST_DB:
            return band_hz
    return 0.0


def clutter_band_hz(scene: Scene, clocks: Sequence[TagClock]) -> float:
    """The scene's clutter band, or one that costs hardly anything where it states none.

    Returns float: in Hz.
    """
    stated_hz = scene.environment.moving_clutter_hz
    if stated_hz is not None:
        return stated_hz
    # Every sequence that is rejected at irregular times costs a packet's worth of information, so
    # that nothing is rejected before a survey has found something.
    if scene.packets or estimator_named(scene.phase_group.estimator).rectangular:
        return 0.0
    waveform = scene.waveform()
    return automatic_band_hz(
        clocks, scene.phase_group.snapshots, waveform.snapshot_period_s, waveform.averaging_s
    )
