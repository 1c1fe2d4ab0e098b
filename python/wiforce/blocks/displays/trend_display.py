# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: a rolling plot of slow streams."""

from collections.abc import Sequence

import numpy as np
from gnuradio import gr

from ...estimation.groups import Array
from ...gui import Trend
from ..argument_types import typed
from ..kept import Kept


class trend_display(Kept, gr.sync_block):
    """Shows slow streams, for example one value per phase group, over the last seconds.

    Input: one float stream per label. The attribute ``widget`` is the Qt widget, to be put into a
    window; a QApplication must exist. (GNU Radio's time sink waits until its buffer is full, which
    takes many seconds at such rates.)

    Parameters
    ----------
    labels : sequence of str
        One per stream.
    y_label : str
        With its unit.
    rate : float
        Items per second.
    history_s : float
        Seconds shown.
    title : str
        Above the plot.
    y_range : (float, float), optional
        Fixed; by default as the values ask for.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> trend = trend_display(("offset",), y_label="ppm", rate=28.0)  # doctest: +SKIP
    """

    @typed
    def __init__(
        self,
        labels: Sequence[str] = ("value",),
        y_label: str = "",
        rate: float = 28.0,
        history_s: float = 10.0,
        title: str = "",
        y_range: tuple[float, float] | None = None,
    ) -> None:
        self.widget = Trend(labels, y_label, rate, history_s, title, y_range)
        gr.sync_block.__init__(self, "trend_display", [np.float32] * len(labels), None)

    def work(self, input_items: list[Array], output_items: list[Array]) -> int:
        for line, items in enumerate(input_items):
            self.widget.add(line, items.tolist())
        return len(input_items[0])
