# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: the complete receiver after the channel estimator, tones to readings."""

from collections.abc import Callable
from typing import Any

import pmt

from .. import names
from ..estimation.groups import Array, Groups
from ..io.readings import Reading
from ..planning.plan import Plan
from ..receiver import Receiver
from .group_block import GroupBlock, Tags
from .reading_port import ReadingPort
from .tone_input import ToneInput


class group_reader(ReadingPort, GroupBlock):
    """Reads all groups that have arrived in one call of the :class:`Receiver`.

    Input: vectors M x 64, the channel at each tone, tagged ``group`` and ``missing``.
    Message ports: ``incomplete`` and ``tare`` (in), ``readings`` (out).

    Parameters
    ----------
    plan : Plan
        Of a scene: ``wiforce.plan(scene)``.
    tracked : bool
        Follow each press over time instead of inverting each group by itself.
    on_reading : callable, optional
        Called with every :class:`Reading` in the block's thread.

    Attributes
    ----------
    receiver : Receiver

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> groups = group_reader(wiforce.plan("demo"), on_reading=print)
    """

    def __init__(
        self,
        plan: Plan,
        tracked: bool = False,
        on_reading: Callable[[Reading], None] | None = None,
    ) -> None:
        self._input = ToneInput(plan)
        self.receiver = Receiver(plan, tracked)
        GroupBlock.__init__(self, "group_reader", self._input.rows * 64, 0)
        self.open_port(on_reading)
        for name, handler in (
            (names.INCOMPLETE, self._on_incomplete),
            (names.TARE, self._on_tare),
        ):
            self.message_port_register_in(pmt.intern(name))
            self.set_msg_handler(pmt.intern(name), handler)

    def _on_incomplete(self, message: Any) -> None:
        try:
            self._input.on_incomplete(message)
        except Exception as error:
            self.fail(error)

    def _on_tare(self, message: Any) -> None:
        self.receiver.tare()

    def take(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        count, groups = self._input.collect(items, tags)
        if count:
            self.publish(self.receiver.process(groups))
        return count, groups[:0]

    def finish(self) -> None:
        """Give the readings of the groups that are still held back."""
        self.publish(self.receiver.finish())
