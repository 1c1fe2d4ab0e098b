# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: peak level of samples relative to full scale."""

import numpy as np
from gnuradio import gr

from ..estimation.groups import Array


class level_meter(gr.sync_block):
    """Passes complex 16-bit samples and measures their peak.

    Attributes
    ----------
    peak : int
        Largest magnitude of a component since it was last set to 0.

    Examples
    --------
    >>> level_meter().peak
    0
    """

    def __init__(self) -> None:
        item = (np.int16, 2)
        gr.sync_block.__init__(self, "level_meter", in_sig=[item], out_sig=[item])
        self.peak = 0

    def work(self, input_items: list[Array], output_items: list[Array]) -> int:
        items = input_items[0]
        output_items[0][:] = items
        self.peak = max(self.peak, int(items.max()), -int(items.min()))
        return len(items)
