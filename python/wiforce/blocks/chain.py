# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps from tones to readings, a block each, and readings as streams of numbers."""

import time
from collections import deque
from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from ..errors import InputError
from ..estimation.capture.folded_groups import FoldedGroups, Slips
from ..estimation.estimators import RatioUnfolder, estimator_named
from ..estimation.groups import Array, Groups, is_clipped
from ..estimation.phases.reference import SubcarrierAverage
from ..io.readings import ESTIMATES, GroupCounts, Reading, as_reading
from ..planning.plan import Plan
from ..press.sensor_state import describe_doubt
from ..receiver.receiver import make_readout
from . import names
from .argument_types import Kept, typed
from .group_block import (
    GroupBlock,
    ReadingPort,
    ReadingTaker,
    Tags,
    count_of,
    groups_of,
    misplaced_in,
    occupied_subcarriers,
    state_from_pmt,
    whole_spectra,
)


class ToneInput:
    """Converts the output of ``ofdm_channel_estimator``, ``derotated`` or not, to Groups."""

    def __init__(self, plan: Plan, derotated: bool = True) -> None:
        self._plan = plan
        self.rows = len(plan.table.tones)
        self._folded = FoldedGroups(plan.table, plan.waveform, derotated)
        self._messages: dict[int, tuple[Array, Array]] = {}
        self._expected: int | None = None
        self._slips = Slips(plan.group_length)

    def on_incomplete(self, message: Any) -> None:
        """Take the snapshots of a group with gaps (message port ``incomplete``)."""
        meta = pmt.to_python(pmt.car(message))
        present = np.asarray(meta[names.MASK], bool)
        folded = np.array(pmt.c32vector_elements(pmt.cdr(message)), complex)
        self._messages[int(meta[names.GROUP])] = (present, folded.reshape(len(present), -1))

    def collect(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        """Collect items (G, N M) whose messages have arrived: items taken, and their groups."""
        length, taken, kept = self._plan.group_length, len(tags), []
        index = np.array([pmt.to_uint64(own[names.GROUP]) for own in tags], np.int64)
        missing, rejected, saturated = (
            np.array([count_of(own, name) for own in tags])
            for name in (names.MISSING, names.REJECTED, names.SATURATED)
        )
        retuned, slipped = np.zeros((2, len(tags)), bool)
        tones = occupied_subcarriers(items, self.rows, self._plan.waveform.bins)
        weights = np.ones((len(tags), length), bool)
        # The weights of the tones null the static path, which shows what the receiver does.
        static = np.zeros((len(tags), tones.shape[2]), complex)
        for row, own in enumerate(tags):
            group = int(index[row])
            if names.STATIC in own:
                static[row] = self._folded.static(pmt.c32vector_elements(own[names.STATIC]))
            if missing[row] + rejected[row] > 0:
                if group not in self._messages and self._expected != group:
                    # Its snapshots were sent before it: wait until the messages have been handled.
                    self._expected, taken = group, row
                    break
                tones[row], static[row], weights[row] = self._solved(group)
                if not weights[row].any():
                    missing[row] = length
            # What was given before a slip was found cannot be left out.
            self._slips.add(misplaced_in(own))
            marks = self._slips.mark(group, names.RETUNED in own)
            if marks is not None:
                slipped[row], retuned[row] = marks
                kept.append(row)
        groups = Groups(
            index,
            tones,
            missing,
            is_clipped(saturated, length),
            retuned,
            None if weights.all() else weights,
            rejected / length,
            static,
            slipped=slipped,
        )
        return taken, groups[np.array(kept, int)]

    def _solved(self, group: int) -> tuple[Array | float, ...]:
        """Tones of a group with gaps and the weights of its snapshots; zeros when not solvable."""
        if group not in self._messages:
            gr.log.warn(
                f"end_separation: no snapshots of group {group} arrived, it is flagged 'gap': "
                "connect the message port 'incomplete'"
            )
            return 0.0, 0.0, 0.0
        present, folded = self._messages.pop(group)
        return self._folded.solve(present, folded[present])


_STATE = pmt.intern(names.STATE)


class clock_offset(Kept, gr.sync_block):
    """Offset of every tag's clock against its nominal frequency.

    Input: vectors tagged ``state``, from ``end_separation`` or any block after it. Output: vectors
    of S floats, ppm, positive for a fast tag; NaN while a clock is not known.

    Parameters
    ----------
    sensors : int
        S.
    length : int
        Complex numbers per input vector: 2 S times the samples of a symbol after
        ``end_separation``, 128 S for the default waveform.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> offset = clock_offset(sensors=2, length=256)
    """

    @typed
    def __init__(self, sensors: int = 1, length: int = 128) -> None:
        for name, value in (("sensors", sensors), ("length", length)):
            if value < 1:
                raise InputError(name, "must be at least 1", value)
        item = np.float32 if sensors == 1 else (np.float32, sensors)
        gr.sync_block.__init__(self, "clock_offset", [(np.complex64, length)], [item])
        self.set_tag_propagation_policy(gr.TPP_DONT)
        self._sensors = sensors

    def work(self, input_items: list[Array], output_items: list[Array]) -> int:
        out = output_items[0]
        out[:] = np.nan
        for tag in self.get_tags_in_window(0, 0, len(out), _STATE):
            state = state_from_pmt(tag.value)
            row = out.reshape(len(out), -1)[tag.offset - self.nitems_read(0)]
            count = min(self._sensors, state.locked.shape[1])
            locked = state.locked[0, :count]
            row[:count][locked] = state.clock_offset_ppm[0, :count][locked]
        return len(out)


class end_separation(GroupBlock):
    """Separates the ends of every tag in a group's tones, at the tracked clock.

    Input: vectors M x N, the channel at each tone (``phase_group_doppler`` with the plan's
    weights, then ``ofdm_channel_estimator``), tagged ``group`` and ``missing``.
    Output: vectors 2S x N, V_i of each end with the clock taken out, tagged ``state``. N are the
    samples of a symbol.
    Message port ``incomplete``: snapshots of groups with gaps, from ``phase_group_doppler``.

    Parameters
    ----------
    plan : Plan
        Of a scene: ``wiforce.plan(scene)``.
    derotated : bool
        Whether the channel estimator was given the plan's derotation.

    Raises
    ------
    InputError
        (A ValueError) when an argument is of another type, or a clock is known too roughly.

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> separation = end_separation(wiforce.plan("demo"))
    """

    @typed
    def __init__(self, plan: Plan, derotated: bool = True) -> None:
        plan.check_clocks()
        self._bins, self._width = plan.waveform.bins, plan.waveform.symbol_length
        self._compression = plan.compression
        self.stage = estimator_named(plan.estimator).separator(
            plan.table, plan.clocks, plan.waveform, derotated, plan.others
        )
        outputs = 2 * len(plan.clocks) * self._width
        self._input = ToneInput(plan, derotated)
        GroupBlock.__init__(self, "end_separation", self._input.rows * self._width, outputs)
        self.take_messages(names.INCOMPLETE, self._on_incomplete)

    def _on_incomplete(self, message: Any) -> None:
        try:
            self._input.on_incomplete(message)
        except Exception as error:
            self.fail(error)

    def take(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        count, groups = self._input.collect(items, tags)
        return count, self._corrected(self.stage.process(groups))

    def flush(self) -> Groups:
        return self._corrected(self.stage.flush())

    def _corrected(self, groups: Groups) -> Groups:
        return groups if self._compression is None else self._compression.correct(groups)

    def vectors(self, groups: Groups) -> Array:
        return whole_spectra(groups.ends, self._bins, self._width)


class conjugate_difference(GroupBlock):
    """V conj(V_ref) of every end and subcarrier.

    Input and output: vectors 2S x N, tagged ``state``. Scaled so that the average over
    subcarriers with the noise weights is R with its magnitude. The groups of the reference are
    held back until it is complete, or the stream ends.
    Message port ``tare``: any message takes a new reference from the groups that follow.

    Parameters
    ----------
    plan : Plan
        Of a scene: ``wiforce.plan(scene)``. Its estimator ``paper`` compares every group with the
        one before (paper, section 3.3).

    Raises
    ------
    InputError
        (A ValueError) when an argument is of another type.

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> difference = conjugate_difference(wiforce.plan("demo"))
    """

    @typed
    def __init__(self, plan: Plan) -> None:
        self._ends = 2 * len(plan.clocks)
        self._bins, self._width = plan.waveform.bins, plan.waveform.symbol_length
        estimator = estimator_named(plan.estimator)
        self.stage = estimator.difference(len(plan.clocks), plan.reference_groups, plan.waveform)
        GroupBlock.__init__(
            self, "conjugate_difference", self._ends * self._width, self._ends * self._width
        )
        self.take_messages(names.TARE, self._on_tare)

    def _on_tare(self, message: Any) -> None:
        self.stage.tare()

    def take(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        ends = occupied_subcarriers(items, self._ends, self._bins)
        return len(items), self.stage.process(groups_of(tags).having(ends=ends))

    def flush(self) -> Groups:
        return self.stage.flush()

    def vectors(self, groups: Groups) -> Array:
        return whole_spectra(groups.changes, self._bins, self._width)


class subcarrier_average(GroupBlock):
    """R of every end: the average over subcarriers, weighted by the noise of each.

    Input: vectors 2S x N from ``conjugate_difference``; output: vectors 2S, R with its magnitude;
    both tagged ``state``, to which the standard deviation of arg R is added.

    Parameters
    ----------
    plan : Plan
        Of a scene: ``wiforce.plan(scene)``.

    Raises
    ------
    InputError
        (A ValueError) when an argument is of another type.

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> average = subcarrier_average(wiforce.plan("demo"))
    """

    @typed
    def __init__(self, plan: Plan) -> None:
        self._ends = 2 * len(plan.clocks)
        self._bins, self._width = plan.waveform.bins, plan.waveform.symbol_length
        self.stage = SubcarrierAverage()
        GroupBlock.__init__(self, "subcarrier_average", self._ends * self._width, self._ends)

    def take(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        changes = occupied_subcarriers(items, self._ends, self._bins)
        return len(items), self.stage.process(groups_of(tags).having(changes=changes))

    def vectors(self, groups: Groups) -> Array:
        return groups.ratios


class force_inversion(ReadingPort):
    """Readings from the ratios R of each group.

    Input: vectors 2S from ``subcarrier_average``, tagged ``state``.
    Message port ``readings`` (out): a dict per group and sensor, keys as the columns of a readings
    file, without unknown values.

    Parameters
    ----------
    plan : Plan
        Of a scene: ``wiforce.plan(scene)``.
    tracked : bool
        Follow each press over time instead of inverting each group by itself.
    on_reading : callable or Output, optional
        Called with every :class:`Reading` in the block's thread. For programs that need the last
        readings of a finite stream, which message ports may lose. An output, as
        :func:`open_writer` makes it, is begun with the first one and closed when the stream ends.

    Raises
    ------
    InputError
        (A ValueError) when an argument is of another type.

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> inversion = force_inversion(wiforce.plan("demo"), on_reading=print)
    >>> inversion.counts.dropped
    0
    """

    @typed
    def __init__(
        self,
        plan: Plan,
        tracked: bool = False,
        on_reading: ReadingTaker = None,
    ) -> None:
        self._unfolder = RatioUnfolder(estimator_named(plan.estimator).ratios)
        self.stage = make_readout(plan, tracked)
        self._doubted: set[str] = set()  # sensors of which it was said
        ReadingPort.__init__(self, "force_inversion", 2 * len(plan.clocks), 0)
        self.open_port(on_reading)

    @property
    def counts(self) -> GroupCounts:
        """Group counts by outcome: a :class:`io.readings.GroupCounts`."""
        return self.stage.counts

    def take(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        groups = groups_of(tags).having(ratios=items.astype(complex))
        if len(groups) and groups.phase_std_deg is None:
            rule = "must hold phase_std_deg, which Subcarrier Average adds: degrees, an f64vector"
            raise InputError("tag state", rule)
        self._publish(self.stage.process(self._unfolder.process(groups)))
        return len(items), groups[:0]

    def finish(self) -> None:
        """Give the readings of the last group, which has no later neighbour."""
        self._publish(self.stage.flush(), ended=True)

    def _publish(self, readings: list[Reading], ended: bool = False) -> None:
        """Give readings, and say once of a sensor that it was not untouched in its reference."""
        self.publish(readings)
        touched = self.counts.touched_reference()
        clear = {reading.sensor for reading in readings if not reading.flags}
        for name, sensor in self.stage.sensors.items():
            unread = ended and not self.counts.clear
            problem = sensor.state.final_problem if unread else sensor.state.lasting_problem
            text = describe_doubt(name, problem) if problem else touched.get(name, "")
            if text and (problem or name in clear) and name not in self._doubted:
                self._doubted.add(name)
                gr.log.warn(f"force_inversion: {text}")


# Readings that wait for a flowgraph that is blocked: several minutes of them.
_MOST_WAITING = 10_000
# Messages are handled between two calls of work(), so it may wait for a short time only. Far
# below the length of a group, and long enough to cost no processor time.
_PAUSE_S = 0.005


class readings_to_floats(Kept, gr.sync_block):
    """Puts the force and the location of a sensor, and their uncertainty, into float streams.

    Message port ``readings`` (in): dicts as ``reader`` and ``force_inversion`` give them. Outputs:
    four float streams, ``force_n``, ``force_std_n`` (N), ``location_mm`` and ``location_std_mm``
    (mm), with ``repeat`` items per reading. The force of an untouched sensor is 0 N; values
    that a reading does not have are ``unknown``.

    Parameters
    ----------
    sensor : str
        Name of the sensor; empty for the sensor of the first reading.
    repeat : int
        Items per reading, 1 or more.
    flagged : bool
        False gives ``unknown`` for readings with a flag other than ``reference``.
    unknown : float
        Value where the reading has none.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> floats = readings_to_floats(sensor="arm", repeat=4)
    """

    @typed
    def __init__(
        self,
        sensor: str = "",
        repeat: int = 1,
        flagged: bool = True,
        unknown: float = np.nan,
    ) -> None:
        if repeat < 1:
            raise InputError("repeat", "must be 1 or more", repeat)
        gr.sync_block.__init__(self, "readings_to_floats", None, [np.float32] * len(ESTIMATES))
        self._sensor = sensor
        self._flagged = flagged
        self._unknown = unknown
        self._waiting: deque[list[float]] = deque(maxlen=_MOST_WAITING)
        self.set_output_multiple(repeat)
        self._repeat = repeat
        self.take_messages(names.READINGS, self._on_reading)

    def work(self, input_items: list[Array], output_items: list[Array]) -> int:
        if not self._waiting:
            time.sleep(_PAUSE_S)
            return 0
        count = min(len(self._waiting), len(output_items[0]) // self._repeat)
        rows = np.array([self._waiting.popleft() for _ in range(count)], np.float32)
        for out, column in zip(output_items, rows.T, strict=True):
            out[: count * self._repeat] = np.repeat(column, self._repeat)
        return count * self._repeat

    def _on_reading(self, message: Any) -> None:
        reading = as_reading(pmt.to_python(message)) if pmt.is_dict(message) else None
        if reading is None:
            return
        self._sensor = self._sensor or reading.sensor
        if reading.sensor == self._sensor:
            self._waiting.append(self._values(reading))

    def _values(self, reading: Reading) -> list[float]:
        if set(reading.flags) - {"reference"} and not self._flagged:
            return [self._unknown] * len(ESTIMATES)
        if reading.touch == 0:
            return [0.0, *[self._unknown] * (len(ESTIMATES) - 1)]
        values = [getattr(reading, name) for name in ESTIMATES]
        return [self._unknown if value is None else value for value in values]
