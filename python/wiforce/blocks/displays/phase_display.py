# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: a window on the phase changes of the ends."""

import numpy as np

from ...estimation.estimators import RatioUnfolder, estimator_named
from ...estimation.groups import Array, Groups
from ...gui import Trend
from ...gui.words import end_labels
from ...planning.plan import Plan
from ..argument_types import typed
from ..chain.group_block import GroupBlock, Tags, groups_of


class phase_display(GroupBlock):
    """Shows the phase change of every end against the untouched sensor over time.

    Input: vectors 2S from ``subcarrier_average``, tagged ``state``. The attribute ``widget`` is the
    Qt widget, to be put into a window; a QApplication must exist.

    Parameters
    ----------
    plan : Plan
        Of a scene: ``wiforce.plan(scene)``. The steps that its estimator ``paper`` gives are added
        up.
    title : str
        Above the plot.
    history_s : float
        Seconds of signal that are shown.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> display = phase_display(wiforce.plan("demo"))  # doctest: +SKIP
    >>> display.widget.show()  # doctest: +SKIP
    """

    @typed
    def __init__(
        self, plan: Plan, title: str = "Phase change of the ends", history_s: float = 10.0
    ) -> None:
        labels = end_labels(plan.require_scene().sensor_names)
        self.widget = Trend(
            labels, "phase (deg)", 1 / plan.group_period_s, history_s, title, (-180.0, 180.0)
        )
        self._unfolder = RatioUnfolder(estimator_named(plan.estimator).ratios)
        GroupBlock.__init__(self, "phase_display", len(labels), outputs=0)

    def take(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        groups = self._unfolder.process(groups_of(tags).having(ratios=items.astype(complex)))
        received = np.isfinite(groups.phase_std_deg) & (np.abs(groups.ratios) > 0)
        phases = np.where(received, np.degrees(np.angle(groups.ratios)), np.nan)
        for end, values in enumerate(phases.T):
            self.widget.add(end, values.tolist())
        return len(items), groups[:0]
