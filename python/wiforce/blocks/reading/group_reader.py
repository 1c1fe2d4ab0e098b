# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: the complete receiver behind the collected snapshots of phase groups."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from ...estimation.capture.folded_groups import SnapshotGroup
from ...estimation.groups import Array, Groups
from ...io.readings import Reading
from ...planning.plan import Plan
from ...receiver.stream import StreamReader
from .. import names
from ..argument_types import typed
from ..chain.group_block import GroupBlock, Tags, count_of
from ..reading_port import ReadingPort
from ..stream_watch import StreamWatch
from .tare_port import TarePort


class group_reader(ReadingPort, TarePort, GroupBlock):
    """Reads all groups that have arrived in one call of the :class:`StreamReader`.

    Input: vectors N x symbol length, the snapshots of a group, from ``preamble_fold.collected`` or
    ``phase_group_doppler.collected``. Message ports: ``tare`` (in), ``readings``, ``tare_state``
    and ``warnings`` (out).

    Parameters
    ----------
    plan : Plan
        Of a scene: ``wiforce.plan(scene)``.
    tracked : bool
        Follow each press over time instead of inverting each group by itself.
    on_reading : callable, optional
        Called with every :class:`Reading` in the block's thread.
    frame_offset : int
        Samples before the first frame, for warnings.

    Attributes
    ----------
    stream : StreamReader
    watch : StreamWatch
    on_warning : callable
        Called with every sentence on what keeps the stream from being read; GNU Radio's log unless
        it is set.

    Raises
    ------
    InputError
        (A ValueError) when an argument is of another type.

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> groups = group_reader(wiforce.plan("demo"), on_reading=print)
    """

    @typed
    def __init__(
        self,
        plan: Plan,
        tracked: bool = False,
        on_reading: Callable[[Reading], None] | None = None,
        frame_offset: int = 0,
    ) -> None:
        self.stream = StreamReader(plan, tracked)
        self.on_warning: Callable[[str], None] = gr.log.warn
        environment = plan.require_scene().environment
        sampled = environment.receive_antennas == 1 and environment.reader_clock == "shared"
        self.watch = StreamWatch(plan, "reader", self._warn, frame_offset, sampled)
        self._width = plan.waveform.symbol_length
        GroupBlock.__init__(self, "group_reader", plan.group_length * self._width, outputs=0)
        self.open_port(on_reading)
        self.open_tare_port(self.stream.tares)
        self.message_port_register_out(pmt.intern(names.WARNINGS))

    def take(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        received = [
            snapshot_group(item, own, self._width) for item, own in zip(items, tags, strict=True)
        ]
        self.watch.take(received)
        self._publish(self.stream.process(received))
        return len(items), Groups(np.zeros(0, np.int64))

    def finish(self) -> None:
        """Give the readings of the groups that are still held back."""
        self._publish(self.stream.finish())
        self.watch.end(self._problems())
        self.end_tare("the run has ended")

    def start(self) -> bool:
        self.watch.start()
        return super().start()

    def stop(self) -> bool:
        self.watch.stop()
        return super().stop()

    def _publish(self, readings: list[Reading]) -> None:
        self.publish(readings)
        self.watch.read(readings, self._problems())

    def _problems(self) -> dict[str, str]:
        """Why it is not known which phases of a sensor are those untouched, by its name."""
        return {s.name: self.stream.reference_problem(s.name) for s in self.stream.plan.sensors}

    def _warn(self, sentence: str) -> None:
        self.on_warning(sentence)
        self.message_port_pub(pmt.intern(names.WARNINGS), pmt.to_pmt({names.TEXT: sentence}))


def snapshot_group(item: Array, tags: dict[str, Any], symbol_length: int = 64) -> SnapshotGroup:
    """The group that an item of collected snapshots holds.

    Parameters
    ----------
    item : ndarray of complex64, shape (symbol_length N,)
    tags : dict
        Of the item, by name.
    symbol_length : int
        Samples of a snapshot.

    Returns
    -------
    SnapshotGroup
        Its snapshots are those of the item, not a copy.

    Examples
    --------
    >>> tags = {"group": pmt.from_uint64(7), "disturbed": pmt.init_u8vector(4, [0, 1, 0, 0])}
    >>> snapshot_group(np.zeros(4 * 64, np.complex64), tags).kept.tolist()
    [True, False, True, True]
    """
    folded = item.reshape(-1, symbol_length)
    present = np.ones(len(folded), bool)
    if names.MASK in tags:
        present = np.array(pmt.u8vector_elements(tags[names.MASK]), bool)
    kept = present
    if names.DISTURBED in tags:
        kept = present & (np.array(pmt.u8vector_elements(tags[names.DISTURBED])) == 0)
    return SnapshotGroup(
        int(pmt.to_uint64(tags[names.GROUP])),
        folded,
        None,
        present,
        count_of(tags, names.SATURATED),
        names.RETUNED in tags,
        kept,
    )
