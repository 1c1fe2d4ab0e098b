# SPDX-License-Identifier: GPL-3.0-or-later
"""The plan of a scene: every setting of the receiver, and the weights, computed once."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from ..estimation.capture.compression import Compression
from ..estimation.clocks.likelihood import PhaseLikelihood
from ..estimation.clocks.tracked_tag import WIDEST_PPM, TagClock
from ..estimation.estimators import estimator_named
from ..scene import Scene, load_scene
from ..scene.schema import SceneSensor
from ..scene.surface import skin_of
from ..sensor import SensorModel
from ..signal.lines import RoomNoise
from ..signal.waveform import Waveform
from ..signal.weights import ToneTable, design_weights, timed_table
from ..surface.skin import Skin
from .loss import clutter_band_hz, losses_db, typical_times_s

# Numbers of harmonics to choose from, and how much worse than the best the choice may be. More
# lines cost processor time in proportion; 0.1 dB is 1 % of a standard deviation.
HARMONICS = (8, 12, 16, 24)
ACCEPTED_LOSS_DB = 0.1


class PlannedSensor(NamedTuple):
    """A sensor to read."""

    name: str
    model: SensorModel
    stated: SceneSensor


@dataclass(frozen=True)
class Plan:
    """Settings of a receiver.

    Attributes
    ----------
    waveform : Waveform
        The sounding frame.
    clocks : tuple of TagClock, length S
        Clock of each tag, nominal or as a survey has measured it, and its tolerance.
    group_length : int
        Snapshots per phase group, N.
    clutter_hz : float
        Clutter band that the weights reject, in Hz; 0 rejects the mean only.
    harmonics : int
        Lines +-1..+-harmonics of each tag are used.
    reference_groups : int
        Groups that the untouched reference is averaged over.
    smoothing_groups : int
        Groups that ratios are averaged over while nothing changes.
    estimator : str
        One of ``estimation.estimators.ESTIMATORS``.
    loss_db : tuple of float, length 2S or 0
        Expected loss of each end against the bound, from the lines that are left out; empty for
        estimators that are there for comparison.
    scene : Scene or None
        What was planned; None for a plan that reads no sensors.
    others : tuple of TagClock
        Tags that the scene does not list, found by a survey: solved for, but not read.
    compression : Compression or None
        What the receiver's compression adds to the ends; None where none was measured.
    room : RoomNoise or None
        What a survey has found between the tags' lines; None where nothing disturbs them.
    surveyed_snr_db : tuple of float
        SNR of line 1 of each tag in a survey; empty where there was none, or where other tags are
        solved for, whose residual is known to remain on the lines.
    in_lamps : tuple of bool
        Tags with strong lines that coincide with those of lamps; empty where there was no survey.
    tag_ratios : tuple of float
        Amplitude of each tag over that of the static path, which bends the ratio of two antennas;
        empty for one antenna, and where no survey has measured it.
    times_s : ndarray, shape (N,), or None
        Times of the snapshots of a typical group from its centre, in s; None on a grid.
    start_s : float
        Time at which group 0 begins, that of the first frame, from the first sample on.

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> settings = plan(load_scene("demo"))
    >>> settings.group_length, round(settings.group_period_s, 6), settings.reference_groups
    (625, 0.036, 13)
    >>> str(settings).splitlines()[1]
    'expected median errors at snr_db 10'
    """

    waveform: Waveform = field(repr=False)
    clocks: tuple[TagClock, ...]
    group_length: int
    clutter_hz: float
    harmonics: int
    reference_groups: int
    smoothing_groups: int
    estimator: str = "harmonic"
    loss_db: tuple[float, ...] = ()
    scene: Scene | None = field(default=None, repr=False, compare=False)
    others: tuple[TagClock, ...] = ()
    compression: Compression | None = field(default=None, repr=False)
    room: RoomNoise | None = field(default=None, repr=False)
    surveyed_snr_db: tuple[float, ...] = ()
    in_lamps: tuple[bool, ...] = ()
    tag_ratios: tuple[float, ...] = ()
    times_s: np.ndarray | None = field(default=None, repr=False, compare=False)
    start_s: float = 0.0

    def __str__(self) -> str:
        from .expected import expect  # which imports the simulation

        lines = [
            f"{1 / self.waveform.snapshot_period_s:.0f} snapshots/s, groups of {self.group_length} "
            f"({1e3 * self.group_period_s:.1f} ms), lines +-1..+-{self.harmonics} of each tag in "
            f"{len(self.table.tones)} tones, estimator {self.estimator}"
        ]
        if self.scene is not None:
            lines.append(f"expected median errors at snr_db {self.scene.simulation.snr_db:g}")
            lines += map(str, expect(self))
        return "\n".join(lines)

    @property
    def clocks_hz(self) -> tuple[float, ...]:
        """fs that the weights are designed for, in Hz, per tag; length S."""
        return tuple(clock.clock_hz for clock in self.clocks)

    @property
    def group_period_s(self) -> float:
        """Length of a phase group, in s."""
        return self.table.group_period_s

    @property
    def center_frequency_hz(self) -> float:
        """Carrier of the scene, in Hz."""
        return self.require_scene().radio.center_frequency_hz

    @cached_property
    def sensors(self) -> tuple[PlannedSensor, ...]:
        """The scene's sensors with their models."""
        scene = self.require_scene()
        return tuple(PlannedSensor(s.name, s.load_model(scene), s) for s in scene.sensors)

    @cached_property
    def skin(self) -> Skin | None:
        """The scene's surface; None where it has none."""
        return skin_of(self.require_scene())

    def require_scene(self) -> Scene:
        """The scene that was planned, or a ValueError."""
        if self.scene is None:
            raise ValueError("a plan without a scene has no sensors to read")
        return self.scene

    @cached_property
    def table(self) -> ToneTable:
        """Weights of the run."""
        if self.times_s is not None:
            period_s = self.group_length * self.waveform.snapshot_period_s
            settings = self.times_s, period_s, self.clutter_hz, self.harmonics
            return timed_table(self.clocks_hz, *settings)
        return design_weights(
            [clock.clock_hz for clock in (*self.clocks, *self.others)],
            self.group_length,
            self.waveform.snapshot_period_s,
            self.clutter_hz,
            self.harmonics,
            estimator_named(self.estimator).rectangular,
            self.room,
        )

    def stating(self, **fields: Any) -> "Plan":
        """The plan with other fields that neither its weights nor its sensors depend on."""
        plan = replace(self, **fields)
        kept = self.__dict__.keys() & {"table", "sensors", "skin"}
        plan.__dict__.update({name: self.__dict__[name] for name in kept})
        return plan

    def with_first_frame(self, frame_offset: int) -> "Plan":
        """The plan for samples of which ``frame_offset`` come before the first frame."""
        return self.stating(start_s=frame_offset / self.waveform.sample_rate_hz)

    def check_clocks(self) -> None:
        """Refuse clocks off by more than 1000 ppm that no survey has measured."""
        for tag, clock in enumerate(self.clocks):
            if clock.tolerance_ppm > WIDEST_PPM:
                key = f"sensors[{tag}].clock_tolerance_ppm"
                rule = (
                    f"must be at most {WIDEST_PPM:g} here: a wider one is searched for in the "
                    "survey of the room, which needs one antenna and 0.1 s of untouched reference "
                    "without gaps"
                )
                raise self.error(key, rule, clock.tolerance_ppm)

    def error(self, key: str, rule: str, value: object) -> InputError:
        """Error that names the scene's file, key, rule and value."""
        return InputError(_key_of(self.require_scene(), key), rule, value)

    def with_clocks(self, clocks: tuple[TagClock, ...]) -> "Plan":
        """The plan for other clocks of the tags, refused where their lines nearly coincide."""
        changed = replace(self, clocks=clocks)
        changed = replace(changed, clutter_hz=clutter_band_hz(changed))
        try:
            if self.estimator == "harmonic":
                return _with_fewest_harmonics(changed)
            changed.check_lines()
        except InputError as error:
            scene = self.require_scene()
            keys = {f"clocks_hz[{i}]": f"sensors[{i}].clock_hz" for i in range(len(clocks))}
            keys |= {
                "group_length": "phase_group.snapshots",
                "clutter_hz": "environment.moving_clutter_hz",
            }
            raise error.renamed({of: _key_of(scene, key) for of, key in keys.items()}) from error
        return changed

    def check_lines(self) -> None:
        """Refuse weights that cannot be designed, and tags whose lines do not determine them."""
        table = self.table
        if self.estimator == "harmonic":
            for tag, clock in enumerate((*self.clocks, *self.others)):
                PhaseLikelihood(table, tag, clock.clock_hz * self.waveform.averaging_s)

    @property
    def separable(self) -> bool:
        """Whether :meth:`check_lines` accepts the settings."""
        try:
            self.check_lines()
        except InputError:
            return False
        return True


PlanOrScene = Plan | str | Path | dict[str, Any] | Scene


def as_plan(plan_or_scene: PlanOrScene) -> Plan:
    """A plan as it is, or that of a scene with its own settings."""
    return plan_or_scene if isinstance(plan_or_scene, Plan) else plan(plan_or_scene)


def plan(scene: Any, snapshots: int | None = None, estimator: str | None = None) -> Plan:
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
        With its weights designed.

    Raises
    ------
    InputError
        When the untouched reference holds no whole group, the weights cannot be designed, or two
        clocks are too much alike; the message names the scene's file and key.

    Examples
    --------
    >>> from gnuradio.wiforce.scene import load_scene
    >>> len(plan(load_scene("demo")).table.tones)
    24
    """
    scene = load_scene(scene)
    changes = {"snapshots": snapshots, "estimator": estimator}
    changes = {key: value for key, value in changes.items() if value is not None}
    scene = replace(scene, phase_group=replace(scene.phase_group, **changes))
    period = scene.group_period_s
    reference_groups = int(scene.reference_s / period + 1e-9)
    if reference_groups < 1:
        rule = f"must hold at least one phase group of {period:.4g} s"
        raise InputError(_key_of(scene, "reference_s"), rule, scene.reference_s)
    by_steps = estimator_named(scene.phase_group.estimator).ratios == "step"
    clocks = tuple(TagClock(s.clock_hz, s.clock_tolerance_ppm) for s in scene.sensors)
    settings = Plan(
        scene.waveform(),
        clocks,
        scene.phase_group.snapshots,
        0.0,
        HARMONICS[0],
        reference_groups,
        # What is compared with the group before must not be averaged over groups.
        1 if by_steps else max(1, round(scene.phase_group.smoothing_s / period)),
        scene.phase_group.estimator,
        scene=scene,
        times_s=typical_times_s(scene),
    )
    return settings.with_clocks(clocks)


def _key_of(scene: Scene, key: str) -> str:
    """Name of a key for messages, with the scene's file where there is one."""
    return key if scene.path is None else f"{scene.path}: {key}"


def _with_fewest_harmonics(settings: Plan) -> Plan:
    """The plan with the fewest harmonics that lose hardly more than the best choice."""
    losses = losses_db(HARMONICS, settings)
    best = min(loss.max() for loss in losses.values())
    chosen = next(h for h, loss in losses.items() if loss.max() <= best + ACCEPTED_LOSS_DB)

    def using(harmonics: int) -> Plan:
        return replace(settings, harmonics=harmonics, loss_db=tuple(losses[harmonics].tolist()))

    found = using(chosen)
    if chosen > HARMONICS[0] and found.separable:
        return found
    # A group may be too short to separate more lines.
    found = using(HARMONICS[0])
    found.check_lines()
    return found
