# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene needs computed: reader, bench and command take their settings from here."""

from dataclasses import dataclass, field
from functools import cached_property

from ..errors import InputError
from ..estimation.estimators import estimator_named
from ..estimation.separation import TagClock
from ..estimation.weights import design_weights
from ..waveform import Waveform

# Groups shorter than this are averaged over it while nothing changes.
_SMOOTHING_S = 0.036


@dataclass(frozen=True)
class Plan:
    """Settings of a reader.

    Attributes
    ----------
    waveform : Waveform
    clocks : tuple of TagClock
    group_length : int
        Snapshots per phase group.
    clutter_hz : float
        Clutter band that the weights null; 0 removes the mean only.
    harmonics : int
        Lines +-1..+-harmonics of each tag are used.
    reference_groups : int
    smoothing_groups : int
    estimator : str
        One of ``estimation.estimators.ESTIMATORS``.
    """

    waveform: Waveform = field(repr=False)
    clocks: tuple
    group_length: int
    clutter_hz: float
    harmonics: int
    reference_groups: int
    smoothing_groups: int
    estimator: str = "harmonic"

    @property
    def group_period_s(self):
        return self.group_length * self.waveform.snapshot_period_s

    @cached_property
    def table(self):
        """Weights of the run (``estimation.weights.ToneTable``)."""
        return design_weights(
            [clock.clock_hz for clock in self.clocks],
            self.group_length,
            self.waveform.snapshot_period_s,
            self.clutter_hz,
            self.harmonics,
            estimator_named(self.estimator).rectangular,
        )


def plan(scene):
    """The plan of a scene.

    Raises
    ------
    InputError
        When the untouched reference holds no whole group, or the weights cannot be designed.
    """
    period = scene.group_period_s
    reference_groups = int(scene.reference_s / period + 1e-9)
    if reference_groups < 1:
        rule = f"must hold at least one phase group of {period:.4g} s"
        raise InputError("reference_s", rule, scene.reference_s)
    estimator = estimator_named(scene.phase_group.estimator)
    clocks = tuple(TagClock(s.clock_hz, s.clock_tolerance_ppm) for s in scene.sensors)
    return Plan(
        scene.waveform(),
        clocks,
        scene.phase_group.snapshots,
        scene.environment.moving_clutter_hz,
        8,
        reference_groups,
        # What is compared with the group before must not be averaged over groups.
        max(1, round(_SMOOTHING_S / period)) if estimator.against == "untouched" else 1,
        scene.phase_group.estimator,
    )
