# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: one complex ratio per end from one per subcarrier."""

from ...estimation.groups import Array, Groups
from ...estimation.phases.average import SubcarrierAverage
from ...planning.plan import Plan
from ..argument_types import typed
from .group_block import GroupBlock, Tags, groups_of
from .subcarriers import occupied_subcarriers


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
