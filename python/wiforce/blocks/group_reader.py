# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: the whole receiver behind the channel estimator, tones to readings."""

import pmt

from .. import names
from ..receiver import Receiver
from .group_block import GroupBlock
from .reading_port import ReadingPort
from .tone_input import ToneInput


class group_reader(ReadingPort, GroupBlock):
    """Reads all groups that have arrived in one call of the :class:`Receiver`.

    Input: vectors M x 64, the channel at each tone, tagged ``group`` and ``missing``.
    Message ports: ``incomplete`` and ``tare`` (in), ``readings`` (out).

    Parameters
    ----------
    plan : Plan
    tracked : bool
        Follow each press over time instead of inverting each group by itself.
    on_reading : callable, optional
        Called with every :class:`Reading` in the block's thread.

    Attributes
    ----------
    receiver : Receiver
    """

    def __init__(self, plan, tracked=False, on_reading=None):
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

    def _on_incomplete(self, message):
        try:
            self._input.on_incomplete(message)
        except Exception as error:
            self.fail(error)

    def _on_tare(self, message):
        self.receiver.tare()

    def take(self, items, tags):
        count, groups = self._input.collect(items, tags)
        if count:
            self.publish(self.receiver.process(groups))
        return count, groups[:0]

    def finish(self):
        """Give the readings of the groups that are still held back."""
        self.publish(self.receiver.finish())
