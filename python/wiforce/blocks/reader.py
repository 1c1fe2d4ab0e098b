# SPDX-License-Identifier: GPL-3.0-or-later
"""The whole receiver as blocks, with its port for tares."""

import itertools
import math
from collections.abc import Callable
from functools import partial
from threading import Event
from typing import Any

import pmt
from gnuradio import gr

from ..errors import InputError
from ..estimation.capture.folded_groups import SnapshotGroup
from ..io.capture.samples import ITEM_TYPES
from ..io.readings import GroupCounts, Reading
from ..planning.findings import Finding
from ..planning.plan import Plan, PlanOrScene, as_plan
from ..press.tares import TareState
from ..receiver.stream import StreamReader
from ..wiforce_python import phase_group_doppler, preamble_fold
from . import names
from .argument_types import Kept, enlarge_output_buffer, typed
from .group_block import ReadingPort, ReadingTaker, SnapshotSink
from .stream_watch import Folded, StreamWatch

_REQUEST, _CANCEL = "request", "cancel"


class group_reader(ReadingPort, SnapshotSink):
    """Reads all groups that have arrived in one call of the :class:`StreamReader`.

    Input: vectors N x symbol length, collected. Message ports: ``tare`` (in), ``readings``,
    ``tare_state``, ``warnings`` (out); ``on_warning`` is GNU Radio's log unless set.
    """

    @typed
    def __init__(
        self,
        plan: Plan,
        tracked: bool = False,
        on_reading: ReadingTaker = None,
        frame_offset: int = 0,
    ) -> None:
        self.stream = StreamReader(plan, tracked)
        self.on_warning: Callable[[str], None] = gr.log.warn
        environment = plan.require_scene().environment
        sampled = environment.receive_antennas == 1 and environment.reader_clock == "shared"
        self.watch = StreamWatch(plan, self.stream, self._warn, frame_offset, sampled)
        SnapshotSink.__init__(self, "group_reader", plan.group_length, plan.waveform.symbol_length)
        self.open_port(on_reading)
        self._numbers = itertools.count()
        self._asked: dict[int, Callable[[TareState], None]] = {}
        self._waiting: list[Callable[[TareState], None]] = []
        self.stream.tares.on_state = self._on_tare_state
        self.take_messages(names.TARE, self._on_tare)
        self.message_port_register_out(pmt.intern(names.TARE_STATE))
        self.message_port_register_out(pmt.intern(names.WARNINGS))

    def read(self, groups: list[SnapshotGroup]) -> None:
        self.watch.take(groups)
        self._publish(self.stream.process(groups))

    def finish(self) -> None:
        """Give the readings of the groups that are still held back."""
        self._publish(self.stream.finish())
        self.watch.end()
        self._end_tare("the run has ended")

    def start(self) -> bool:
        self.watch.start()
        return super().start()

    def stop(self) -> bool:
        self.watch.stop()
        return super().stop()

    def _publish(self, readings: list[Reading]) -> None:
        self.publish(readings)
        self.watch.read(readings)

    def _warn(self, sentence: str) -> None:
        self.on_warning(sentence)
        self.message_port_pub(pmt.intern(names.WARNINGS), pmt.to_pmt({names.TEXT: sentence}))

    def tare(self, force: bool = False, done: Callable[[TareState], None] | None = None) -> None:
        """Request a tare, from any thread; ``done`` is called, in the block's, with its end."""
        number = next(self._numbers)
        if done is not None:
            self._asked[number] = done
        self._send({names.FORCE: force, _REQUEST: number})

    def cancel_tare(self, reason: str) -> None:
        """Give up a tare that is being measured, from any thread."""
        self._send({_CANCEL: reason})

    def _end_tare(self, reason: str) -> None:
        """Give up what is being measured or waits, at the end of the stream."""
        ended = self.stream.tares.cancel(reason)
        if ended.state != "failed":
            ended = TareState("failed", reason)
        for done in [*self._asked.values(), *self._waiting]:
            done(ended)
        self._asked.clear()
        self._waiting.clear()

    def _send(self, message: dict[str, Any]) -> None:
        self.to_basic_block()._post(pmt.intern(names.TARE), pmt.to_pmt(message))

    def _on_tare(self, message: Any) -> None:
        try:
            # Anything else than a dict requests a tare as well.
            values = pmt.to_python(message) if pmt.is_dict(message) else None
            self._take(values if isinstance(values, dict) else {})
        except Exception as error:
            self.fail(error)

    def _take(self, request: dict[str, Any]) -> None:
        if _CANCEL in request:
            self.stream.tares.cancel(str(request[_CANCEL]))
            return
        number = request.get(_REQUEST)
        done = self._asked.pop(number, None) if isinstance(number, int) else None
        # Only true forces: what else somebody sends may be a mistake.
        state = self.stream.tares.request(request.get(names.FORCE) is True)
        if done is None:
            return
        if state.state == "measuring":
            self._waiting.append(done)
        else:
            done(state)

    def _on_tare_state(self, state: TareState) -> None:
        self.message_port_pub(pmt.intern(names.TARE_STATE), pmt.to_pmt(state.row()))
        if state.state in ("complete", "failed"):
            waiting, self._waiting = self._waiting, []
            for done in waiting:
                done(state)


# Groups that the receiver may leave waiting, in seconds of signal.
_BUFFERED_S = 2.0
_ITEM_BYTES = {name: kind.sample_bytes for name, kind in ITEM_TYPES.items()}


def _folded(fold: preamble_fold) -> Folded:
    refused = fold.refused_rate(), fold.refused_carrier()
    return Folded(fold.snapshots(), fold.nitems_written(0), *refused)


class reader(Kept, gr.hier_block2):
    """Reads force and location from received samples.

    Message port ``readings`` (out): a dict per group and sensor (see ``force_inversion``).
    Message port ``tare`` (in): measure a new untouched reference; a dict with ``force`` true also
    while a sensor is touched. Message port ``tare_state`` (out): what became of it, a dict with
    ``state`` (``measuring``, ``complete``, ``refused``, ``failed``), ``reason`` and ``forced``.
    Message port ``warnings`` (out): a dict with ``text``, a sentence that names what keeps the
    samples from being read, once this has lasted for a second or the stream has ended.

    Parameters
    ----------
    scene : str, Path, dict, Scene or Plan
        Scene file, the scene itself, or its plan.
    input_type : str
        ``fc32`` or ``sc16`` samples, or ``folded`` vectors from a ``recording_source``.
    frame_offset : int
        Samples before the first frame of the stream; for folded vectors, those before the first
        vector. Times of readings count from the first sample.
    tracked : bool
        Follow each press over time instead of inverting each group by itself.
    on_reading : callable or Output, optional
        Called with every :class:`io.readings.Reading`. An output, as :func:`open_writer` makes it,
        is begun with the first one and closed when the stream has ended.

    Attributes
    ----------
    fold : block or None
        The block that folds samples; None for folded vectors.
    groups : block
        The inner block, with the :class:`StreamReader`. Its attribute ``on_warning`` is called with
        every text on the port ``warnings``, and is GNU Radio's log unless it is set.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, file and key, rule and value.

    Examples
    --------
    >>> from gnuradio import blocks, gr
    >>> flowgraph = gr.top_block()
    >>> source = blocks.null_source(4)  # 16-bit samples
    >>> flowgraph.connect(source, reader("demo", input_type="sc16", on_reading=print))
    """

    @typed
    def __init__(
        self,
        scene: PlanOrScene,
        input_type: str = "fc32",
        frame_offset: int = 0,
        tracked: bool = False,
        on_reading: ReadingTaker = None,
    ) -> None:
        if input_type not in (*_ITEM_BYTES, "folded"):
            rule = f"must be one of {', '.join((*_ITEM_BYTES, 'folded'))}"
            raise InputError("input_type", rule, input_type)
        if frame_offset < 0:
            raise InputError("frame_offset", "must be 0 or more", frame_offset)
        settings = as_plan(scene)
        if frame_offset:
            settings = settings.with_first_frame(frame_offset)
        if input_type != "folded":
            folding = settings.waveform.folding
            if settings.require_scene().environment.receive_antennas > 1:
                raise InputError(
                    "environment.receive_antennas",
                    "must be 1 where samples come in; two antennas are folded, then antenna_ratio",
                    2,
                )
        folded_bytes = settings.waveform.symbol_length * gr.sizeof_gr_complex
        gr.hier_block2.__init__(
            self,
            "reader",
            gr.io_signature(1, 1, _ITEM_BYTES.get(input_type, folded_bytes)),
            gr.io_signature(0, 0, 0),
        )
        self.message_port_register_hier_out(names.READINGS)
        self.message_port_register_hier_out(names.TARE_STATE)
        self.message_port_register_hier_out(names.WARNINGS)
        self.message_port_register_hier_in(names.TARE)
        self.fold = None
        length = settings.group_length
        if input_type == "folded":
            first = phase_group_doppler.collected(length, settings.waveform.symbol_length)
        else:
            first = self.fold = preamble_fold.collected(
                length,
                **folding,
                sample_rate=settings.waveform.sample_rate_hz,
                frame_offset=frame_offset,
                item_type=input_type,
            )
        # Python pauses now and then: the samples must not wait for it.
        enlarge_output_buffer(first, math.ceil(_BUFFERED_S / settings.group_period_s))
        self.groups = group_reader(settings, tracked, on_reading, frame_offset)
        if self.fold is not None:
            self.groups.stream.mean_frame = self.fold.mean_frame
            self.groups.watch.folded = partial(_folded, self.fold)
            self.fold.expect_carrier(settings.center_frequency_hz)
        # The inner connections hold C++ parts only: GNU Radio never destroys those of messages to
        # the block itself, and a flowgraph keeps this object, which has the others.
        own, groups = self._impl, self.groups.gateway
        self.connect(own, first, groups)
        for port in (names.READINGS, names.TARE_STATE, names.WARNINGS):
            self.msg_connect(groups, port, own, port)
        self.msg_connect(own, names.TARE, groups, names.TARE)

    @property
    def stream(self) -> StreamReader:
        """What reads the groups."""
        return self.groups.stream

    @property
    def plan(self) -> Plan:
        """Plan that is used: of the scene, or adapted to the room once that is surveyed."""
        return self.stream.plan

    @property
    def findings(self) -> list[Finding] | None:
        """What the latest survey of the room has found; None without one."""
        return self.stream.findings

    @property
    def failure(self) -> Exception | None:
        """The exception that ended the flowgraph; None without one."""
        return self.groups.failure

    @property
    def counts(self) -> GroupCounts:
        """Group counts by outcome: a :class:`io.readings.GroupCounts`."""
        return self.stream.counts

    @property
    def ended(self) -> Event:
        """A threading.Event: the stream has ended and its last group is read."""
        return self.groups.ended

    def tare(self, force: bool = False, done: Callable[[TareState], None] | None = None) -> None:
        """Measure a new untouched reference in the groups that follow.

        Refused while a sensor is touched, unless forced. May be called from any thread.

        Parameters
        ----------
        force : bool
            Also while a sensor is touched; its readings are then flagged until a release is seen.
        done : callable, optional
            Called once, in another thread, with the TareState in which the request ends.
        """
        self.groups.tare(force, done)

    def cancel_tare(self, reason: str) -> None:
        """Give up a tare that is being measured; may be called from any thread.

        Parameters
        ----------
        reason : str
            Part of the TareState in which the request ends.
        """
        self.groups.cancel_tare(reason)
