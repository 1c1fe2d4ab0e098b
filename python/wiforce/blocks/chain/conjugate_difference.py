# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: the ends' channels relative to the untouched sensor or to the previous group."""

from typing import Any

import pmt

from ...estimation.estimators import estimator_named
from ...estimation.groups import Array, Groups
from ...planning.plan import Plan
from .. import names
from ..argument_types import typed
from .group_block import GroupBlock, Tags, groups_of
from .subcarriers import occupied_subcarriers, whole_spectra


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
        self.message_port_register_in(pmt.intern(names.TARE))
        self.set_msg_handler(pmt.intern(names.TARE), self._on_tare)

    # GNU Radio finds a handler by its name: a lambda has none that it knows.
    def _on_tare(self, message: Any) -> None:
        self.stage.tare()

    def take(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        ends = occupied_subcarriers(items, self._ends, self._bins)
        return len(items), self.stage.process(groups_of(tags).having(ends=ends))

    def flush(self) -> Groups:
        return self.stage.flush()

    def vectors(self, groups: Groups) -> Array:
        return whole_spectra(groups.changes, self._bins, self._width)
