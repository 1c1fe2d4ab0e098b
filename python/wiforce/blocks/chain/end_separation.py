# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: tones of a group to the complex channels of the tags' ends."""

from typing import Any

import pmt

from ...estimation.estimators import estimator_named
from ...estimation.groups import Array, Groups
from ...planning.plan import Plan
from .. import names
from ..argument_types import typed
from .group_block import GroupBlock, Tags
from .subcarriers import whole_spectra
from .tone_input import ToneInput


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
        self.stage = estimator_named(plan.estimator).separation(
            plan.table, plan.clocks, plan.waveform, derotated, plan.others
        )
        outputs = 2 * len(plan.clocks) * self._width
        self._input = ToneInput(plan, derotated)
        GroupBlock.__init__(self, "end_separation", self._input.rows * self._width, outputs)
        self.message_port_register_in(pmt.intern(names.INCOMPLETE))
        self.set_msg_handler(pmt.intern(names.INCOMPLETE), self._on_incomplete)

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
