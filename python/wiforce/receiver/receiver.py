# SPDX-License-Identifier: GPL-3.0-or-later
"""The receiver: from the tones of phase groups to readings of force and location."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from functools import partial

import numpy as np

from ..errors import InputError
from ..estimation.estimators import RatioUnfolder, estimator_named
from ..estimation.groups import Groups
from ..estimation.phases.reference import SubcarrierAverage
from ..io.readings import GroupCounts, Reading
from ..planning.plan import Plan, PlannedSensor, PlanOrScene, as_plan
from ..press.evidence import PressEvidence, Suspicion
from ..press.explanations import filter_of
from ..press.readout import Readout
from ..press.sensor_readout import SensorReadout
from ..press.sensor_state import SensorState
from ..press.surface_readout import SurfaceReadout
from ..press.tares import TareRequests, TareState

# Tag over static path, with two antennas, where no survey has measured it: a strong tag.
_TAG_RATIO = 0.1


def one_thread() -> Callable[[], AbstractContextManager[object]]:
    """What limits BLAS: threads are slower than one core for matrices as small as these."""
    # The command states it, where a limit would cost time in every group, and to search the
    # libraries for one 10 ms.
    if os.environ.get("OPENBLAS_NUM_THREADS") == "1":
        return nullcontext
    from threadpoolctl import ThreadpoolController

    blas = ThreadpoolController().select(user_api="blas")
    if all(library.num_threads == 1 for library in blas.lib_controllers):
        return nullcontext
    return partial(blas.limit, limits=1)


class Receiver:
    """Reads force and location from the tones of phase groups.

    Parameters
    ----------
    plan : Plan, or str, Path, dict or Scene
        Of a scene: ``wiforce.plan(scene)``. A scene is planned with its own settings.
    tracked : bool
        Follow each press over time (location constant, force a random walk) instead of inverting
        each group by itself.
    derotated : bool
        Whether the tones are derotated (``ToneTable.derotation``), as by all front ends of the
        project; False for tones from channel snapshots.
    on_groups : callable, optional
        Called with every batch of :class:`Groups` that has been read.
    first_group : int
        The first group whose readings are given. Earlier ones only serve to acquire clocks and
        reference.
    counts : GroupCounts, optional
        Of the readings given before, which are counted on.
    states : mapping of str to SensorState, optional
        What is known of the sensors, by name, from a receiver that has read until now.

    Attributes
    ----------
    plan : Plan
        As given, or that of the scene given.
    counts : GroupCounts
        Outcomes of the readings given so far.
    tares : TareRequests
        State of the last request for a tare.

    Raises
    ------
    InputError
        For a scene that cannot be planned, or when a clock's tolerance exceeds 1000 ppm and no
        survey has measured it.

    Notes
    -----
    A batch passes five stages (docs/theory.md; step by step in docs/tutorial.md): separation of
    the tags' ends at the tracked clock, difference against the untouched reference, average over
    the subcarriers, press (what may have happened to the sensor), and readout (what it says of
    force and location). The first three add arrays to the batch. Groups are held back until clocks
    and reference are known, and each group until the next one has been received. The readings do
    not depend on how groups are divided into batches.

    Examples
    --------
    >>> import numpy as np
    >>> from gnuradio import wiforce
    >>> receiver = wiforce.Receiver(wiforce.plan(wiforce.load_scene("demo")))
    >>> receiver.process(wiforce.Groups(np.arange(2), np.zeros((2, 24, 62))))
    []
    >>> len(receiver.finish())
    2
    """

    def __init__(
        self,
        plan: PlanOrScene,
        tracked: bool = False,
        derotated: bool = True,
        on_groups: Callable[[Groups], None] | None = None,
        first_group: int = 0,
        counts: GroupCounts | None = None,
        states: Mapping[str, SensorState] | None = None,
    ) -> None:
        plan = as_plan(plan)
        plan.check_clocks()
        self.plan = plan
        estimator = estimator_named(plan.estimator)
        self.separation = estimator.separator(
            plan.table, plan.clocks, plan.waveform, derotated, plan.others
        )
        self.difference = estimator.difference(
            len(plan.clocks), plan.reference_groups, plan.waveform
        )
        self.average = SubcarrierAverage()
        self.unfolder = RatioUnfolder(estimator.ratios)
        self.readout = make_readout(plan, tracked, on_groups, first_group, counts, states)
        self.tares = TareRequests(
            self.difference, self.readout.sensors, plan.group_period_s, plan.start_s
        )
        self._separated, self._newest = False, -1
        self._one_thread = one_thread()
        self._shape = len(plan.table.tones), len(plan.waveform.bins)

    @property
    def counts(self) -> GroupCounts:
        """Outcomes of the readings given so far."""
        return self.readout.counts

    @property
    def states(self) -> dict[str, SensorState]:
        """What is known of the sensors, by name, for a receiver that reads on."""
        return {name: sensor.state for name, sensor in self.readout.sensors.items()}

    def suspicions(self) -> dict[str, list[Suspicion]]:
        """Mistakes that presses since the last tare suggest, by sensor, such as a wrong file."""
        return {name: sensor.suspicions for name, sensor in self.readout.sensors.items()}

    def process(self, groups: Groups) -> list[Reading]:
        """Take the next batch; give the readings that are ready, in order.

        Parameters
        ----------
        groups : Groups
            With ``tones`` (G, M, K), M as in ``plan.table``, K as in ``plan.waveform.bins``.

        Returns
        -------
        list of Reading
            A reading per group and sensor; groups that were not received are flagged ``gap``.

        Raises
        ------
        InputError
            For arrays of another shape than the plan asks for, and indices that do not rise.
        """
        return self.read(self.separate(groups))

    def separate(self, groups: Groups) -> Groups:
        """The first step of ``process``, which depends on no later one: it may be ahead of them."""
        self._check(groups)
        with self._one_thread():
            return self.separation.process(groups)

    def finish(self, groups: int = 0) -> list[Reading]:
        """Give the readings of all groups that are still held back.

        Parameters
        ----------
        groups : int, optional
            Number of groups that the run spans; those after the last one that was received are
            counted as dropped.

        Returns
        -------
        list of Reading
        """
        with self._one_thread():
            separated = self.separation.flush()
        readings = self.read(separated) + self._read(self.difference.flush())
        return readings + self.readout.flush(groups)

    def tare(self, force: bool = False) -> TareState:
        """Measure a new untouched reference in the groups that follow.

        Refused while a sensor is touched. A touch meanwhile ends the measurement, and the former
        reference is kept. ``tares.state`` and ``tares.on_state`` report the outcome.

        Parameters
        ----------
        force : bool
            Measure it in any case; the readings of a sensor that seems to be touched are flagged
            ``ambiguous`` until a release is seen.

        Returns
        -------
        TareState
            ``measuring`` or ``refused``; ``complete`` where the estimator has no reference.
        """
        return self.tares.request(force)

    @property
    def acquisition_groups(self) -> int:
        """Number of groups in which the clocks are acquired, before the first reading."""
        return self.separation.acquisition_groups

    @property
    def state(self) -> str:
        """What the receiver is doing: ``acquiring``, ``reference`` or ``reading``."""
        if not self._separated:
            return "acquiring"
        if self.tares.measuring or not self.difference.started:
            return "reference"
        seen = any(sensor.state.seen for sensor in self.readout.sensors.values())
        return "reading" if seen else "acquiring"

    def _check(self, groups: Groups) -> None:
        # Arrays of another plan often broadcast, and would give readings that mean nothing.
        if not len(groups):
            return
        index = groups.index.tolist()
        if index[0] <= self._newest or index != sorted(set(index)):
            rule = f"must rise from group to group, here from {self._newest} on"
            raise InputError("groups.index", rule, groups.index)
        shape = len(groups), *self._shape
        if np.shape(groups.tones) != shape:
            rule = f"must have shape {shape}: groups, tones and subcarriers of the plan"
            raise InputError("groups.tones", rule, np.shape(groups.tones))
        weights, snapshots = groups.snapshot_weights, (len(groups), self.plan.group_length)
        if weights is not None and np.shape(weights) != snapshots:
            rule = f"must have shape {snapshots}: groups and snapshots of the plan"
            raise InputError("groups.snapshot_weights", rule, np.shape(weights))
        self._newest = index[-1]

    def read(self, groups: Groups) -> list[Reading]:
        """The second step of ``process``: what the separated groups say."""
        if self.plan.compression is not None:
            groups = self.plan.compression.correct(groups)
        self._separated |= len(groups) > 0
        readings: list[Reading] = []
        while len(groups) and self.tares.measuring:
            # One by one, since what a group shows decides on the reference of the next one.
            index = int(groups.index[0])
            self.tares.before(index)
            readings += self._read(self.difference.process(groups[:1]))
            self.tares.after(index)
            groups = groups[1:]
        readings += self._read(self.difference.process(groups))
        if len(groups):
            self.tares.after(int(groups.index[-1]))
        return readings

    def _read(self, groups: Groups) -> list[Reading]:
        return self.readout.process(self.unfolder.process(self.average.process(groups)))


def make_readout(
    plan: Plan,
    tracked: bool = False,
    on_groups: Callable[[Groups], None] | None = None,
    first_group: int = 0,
    counts: GroupCounts | None = None,
    states: Mapping[str, SensorState] | None = None,
) -> Readout:
    """Make the readout of a plan's sensors; parameters as for :class:`Receiver`."""
    period_s, carrier_hz = plan.group_period_s, plan.center_frequency_hz
    surveyed = plan.surveyed_snr_db or [None] * len(plan.sensors)
    in_lamps = plan.in_lamps or [False] * len(plan.sensors)
    two_antennas = plan.require_scene().environment.receive_antennas > 1
    tag_ratios = plan.tag_ratios or [_TAG_RATIO if two_antennas else 0.0] * len(plan.sensors)
    if states is None:
        states = {s.name: _unseen(s, plan) for s in plan.sensors}
    sensors = {
        s.name: SensorReadout(
            s.model,
            carrier_hz,
            s.stated.off_reflection,
            period_s,
            states[s.name],
            tracked,
            snr_db,
            tag_ratio,
            lamps,
            s.stated.off_reflection_std,
        )
        for s, snr_db, tag_ratio, lamps in zip(
            plan.sensors, surveyed, tag_ratios, in_lamps, strict=True
        )
    }
    surface = None
    if plan.skin is not None:
        names = plan.require_scene().reading_names[len(sensors) :]
        from ..surface.estimator import SurfaceEstimator  # for scenes with a surface only

        surface = SurfaceReadout(SurfaceEstimator(plan.skin, len(names)), names)
    more = on_groups, first_group, counts, surface, plan.start_s
    return Readout(sensors, period_s, *more)


def _unseen(sensor: PlannedSensor, plan: Plan) -> SensorState:
    """The state of a sensor that has shown nothing yet."""
    period_s, carrier_hz = plan.group_period_s, plan.center_frequency_hz
    parameters = {"period_s": period_s, "smoothing_s": plan.smoothing_groups * period_s}
    stated, off = sensor.stated, np.asarray(sensor.stated.off_reflection)
    if stated.drift_deg_per_sqrt_s is not None:
        parameters["drift_deg"] = stated.drift_deg_per_sqrt_s
    if stated.turns_per_s is not None:
        parameters["turns_per_s"] = stated.turns_per_s
    return SensorState(
        lambda: filter_of(sensor.model, carrier_hz, off, stated.off_reflection_std, **parameters),
        PressEvidence(sensor.model, carrier_hz, off, period_s),
    )
