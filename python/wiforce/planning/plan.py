# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene needs computed, and why: reader, bench and command take their settings from here."""

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np

from ..errors import InputError
from ..estimation.estimators import estimator_named
from ..estimation.likelihood import PhaseLikelihood
from ..estimation.tracked_tag import TagClock
from ..scene import Scene, load_scene
from ..sensor import SensorModel
from ..signal.waveform import Waveform
from ..signal.weights import design_weights, tag_lines
from .loss import line_loss_db

# Groups shorter than this are averaged over it while nothing changes.
_SMOOTHING_S = 0.036
# Numbers of harmonics to choose from, and how much worse than the best the choice may be.
HARMONICS = (8, 12, 16, 24)
ACCEPTED_LOSS_DB = 0.1


@dataclass(frozen=True)
class PlannedSensor:
    """A sensor to read: name, loaded model, and G_off / rho per switch."""

    name: str
    model: SensorModel = field(repr=False)
    off_reflection: np.ndarray


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
    loss_db : tuple of float
        Expected loss of each end against the bound, from the lines that are left out; empty for
        estimators that are there for comparison.
    scene : Scene or None
        What was planned; None for a plan that reads no sensors.
    """

    waveform: Waveform = field(repr=False)
    clocks: tuple
    group_length: int
    clutter_hz: float
    harmonics: int
    reference_groups: int
    smoothing_groups: int
    estimator: str = "harmonic"
    loss_db: tuple = ()
    scene: Scene | None = field(default=None, repr=False, compare=False)

    @property
    def group_period_s(self):
        return self.group_length * self.waveform.snapshot_period_s

    @property
    def center_frequency_hz(self):
        """Carrier of the scene."""
        return self.scene.radio.center_frequency_hz

    @cached_property
    def sensors(self):
        """The scene's sensors with their models: a tuple of PlannedSensor."""
        return tuple(
            PlannedSensor(s.name, s.load_model(self.scene), np.asarray(s.off_reflection))
            for s in self.scene.sensors
        )

    @cached_property
    def table(self):
        """Weights of the run (``signal.weights.ToneTable``)."""
        return _design(
            tuple(clock.clock_hz for clock in self.clocks),
            self.group_length,
            self.waveform.snapshot_period_s,
            self.clutter_hz,
            self.harmonics,
            estimator_named(self.estimator).rectangular,
        )


# Kept, because choosing the harmonics and using the table both need it.
_design = lru_cache(maxsize=4)(design_weights)


def plan(scene, snapshots=None, estimator=None):
    """The plan of a scene.

    Parameters
    ----------
    scene : str, Path, dict or Scene
    snapshots : int, optional
        Length of a phase group, instead of the scene's.
    estimator : str, optional
        One of ``estimation.estimators.ESTIMATORS``, instead of the scene's.

    Returns
    -------
    Plan

    Raises
    ------
    InputError
        When the untouched reference holds no whole group, the weights cannot be designed, or two
        clocks are too much alike.
    """
    scene = load_scene(scene)
    changes = {"snapshots": snapshots, "estimator": estimator}
    changes = {key: value for key, value in changes.items() if value is not None}
    scene = replace(scene, phase_group=replace(scene.phase_group, **changes))
    period = scene.group_period_s
    reference_groups = int(scene.reference_s / period + 1e-9)
    if reference_groups < 1:
        rule = f"must hold at least one phase group of {period:.4g} s"
        raise InputError("reference_s", rule, scene.reference_s)
    estimator = estimator_named(scene.phase_group.estimator)
    clocks = tuple(TagClock(s.clock_hz, s.clock_tolerance_ppm) for s in scene.sensors)
    waveform, length = scene.waveform(), scene.phase_group.snapshots
    clutter_hz = scene.environment.moving_clutter_hz
    harmonics, loss_db = HARMONICS[0], ()
    if scene.phase_group.estimator == "harmonic":
        harmonics, loss_db = _fewest_harmonics(clocks, waveform, length, clutter_hz)
    return Plan(
        waveform,
        clocks,
        length,
        clutter_hz,
        harmonics,
        reference_groups,
        # What is compared with the group before must not be averaged over groups.
        max(1, round(_SMOOTHING_S / period)) if estimator.against == "untouched" else 1,
        scene.phase_group.estimator,
        loss_db,
        scene,
    )


def _fewest_harmonics(clocks, waveform, group_length, clutter_hz):
    """The fewest harmonics that lose hardly more than the best choice, and what they lose."""
    period_s, averaging_s = waveform.snapshot_period_s, waveform.averaging_s
    clocks_hz = tuple(clock.clock_hz for clock in clocks)
    losses = {}
    for harmonics in HARMONICS:
        lines = tag_lines(clocks_hz, period_s, group_length, harmonics, clutter_hz)
        if 2 * len(lines) < group_length or not losses:
            losses[harmonics] = line_loss_db(
                clocks, group_length, period_s, averaging_s, clutter_hz, harmonics
            )
    best = min(loss.max() for loss in losses.values())
    chosen = next(h for h, loss in losses.items() if loss.max() <= best + ACCEPTED_LOSS_DB)
    if chosen > HARMONICS[0]:
        try:
            check_lines(clocks, waveform, group_length, clutter_hz, chosen)
        except InputError:
            chosen = HARMONICS[0]
    check_lines(clocks, waveform, group_length, clutter_hz, chosen)
    return chosen, tuple(losses[chosen].tolist())


def check_lines(clocks, waveform, group_length, clutter_hz, harmonics):
    """Raises InputError where lines nearly coincide: a group too short, or clocks too alike."""
    clocks_hz, period_s = tuple(clock.clock_hz for clock in clocks), waveform.snapshot_period_s
    table = _design(clocks_hz, group_length, period_s, clutter_hz, harmonics, False)
    for tag, clock_hz in enumerate(clocks_hz):
        PhaseLikelihood(table, tag, clock_hz * waveform.averaging_s)
