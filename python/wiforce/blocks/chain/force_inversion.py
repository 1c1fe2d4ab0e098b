# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: phase changes of the ends to readings of force and location."""

from collections.abc import Callable

from ...estimation.groups import Array, Groups
from ...io.readings import GroupCounts, Reading
from ...planning.plan import Plan
from ...receiver.receiver import make_readout
from ..argument_types import typed
from ..reading_port import ReadingPort
from .group_block import GroupBlock, Tags, groups_of


class force_inversion(ReadingPort, GroupBlock):
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
    on_reading : callable, optional
        Called with every :class:`Reading` in the block's thread. For programs that need the last
        readings of a finite stream, which message ports may lose.

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
        on_reading: Callable[[Reading], None] | None = None,
    ) -> None:
        self.stage = make_readout(plan, tracked)
        GroupBlock.__init__(self, "force_inversion", 2 * len(plan.clocks), 0)
        self.open_port(on_reading)

    @property
    def counts(self) -> GroupCounts:
        """Group counts by outcome: a :class:`io.readings.GroupCounts`."""
        return self.stage.counts

    def take(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        groups = groups_of(tags).having(ratios=items.astype(complex))
        self.publish(self.stage.process(groups))
        return len(items), groups[:0]

    def finish(self) -> None:
        """Give the readings of the last group, which has no later neighbour."""
        self.publish(self.stage.flush())
