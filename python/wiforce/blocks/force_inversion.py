# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: phase changes of the ends to readings of force and location."""

from ..receiver import make_readout
from .group_block import GroupBlock, groups_of
from .reading_port import ReadingPort


class force_inversion(ReadingPort, GroupBlock):
    """Readings from the ratios R of each group.

    Input: vectors 2S from ``subcarrier_average``, tagged ``state``.
    Message port ``readings`` (out): a dict per group and sensor, keys as the columns of a readings
    file, what is unknown left out.

    Parameters
    ----------
    plan : Plan
        Of a scene: ``wiforce.plan(scene)``.
    tracked : bool
        Follow each press over time instead of inverting each group by itself.
    on_reading : callable, optional
        Called with every :class:`Reading` in the block's thread. For programs that must not lose
        the last readings of a finite stream, as message ports do.
    """

    def __init__(self, plan, tracked=False, on_reading=None):
        self.stage = make_readout(plan, tracked)
        GroupBlock.__init__(self, "force_inversion", 2 * len(plan.clocks), 0)
        self.open_port(on_reading)

    @property
    def counts(self):
        """Group counts by outcome: a :class:`io.readings.GroupCounts`."""
        return self.stage.counts

    def take(self, items, tags):
        groups = groups_of(tags).having(ratios=items.astype(complex))
        self.publish(self.stage.process(groups))
        return len(items), groups[:0]

    def finish(self):
        """Give the last group's readings, which waited for their neighbour."""
        self.publish(self.stage.flush())
