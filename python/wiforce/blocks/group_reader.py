# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: the complete receiver after the channel estimator, tones to readings."""

from collections.abc import Callable

from ..estimation.groups import Groups
from ..io.readings import Reading
from ..planning.plan import Plan
from ..receiver import Receiver
from .reading_port import ReadingPort
from .tare_port import TarePort
from .tone_input import ToneBlock


class group_reader(ReadingPort, TarePort, ToneBlock):
    """Reads all groups that have arrived in one call of the :class:`Receiver`.

    Input: vectors M x 64, the channel at each tone, tagged ``group`` and ``missing``.
    Message ports: ``incomplete`` and ``tare`` (in), ``readings`` and ``tare_state`` (out).

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
        self.receiver = Receiver(plan, tracked)
        ToneBlock.__init__(self, "group_reader", plan, derotated=True, outputs=0)
        self.open_port(on_reading)
        self.open_tare_port(self.receiver.tares)

    def process(self, groups: Groups) -> Groups:
        if len(groups):
            self.publish(self.receiver.process(groups))
        return groups[:0]

    def finish(self) -> None:
        """Give the readings of the groups that are still held back."""
        self.publish(self.receiver.finish())
        self.end_tare("the run has ended")
