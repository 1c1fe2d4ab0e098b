# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: watches how far samples fill the converter's range, and ends their stream."""

import numpy as np
from gnuradio import gr

_DONE = -1


class level_meter(gr.sync_block):
    """Passes complex 16-bit samples through until told to end, noting their peak.

    Attributes
    ----------
    peak : int
        Largest magnitude of a component since it was last set to 0.
    """

    def __init__(self):
        item = (np.int16, 2)
        gr.sync_block.__init__(self, "level_meter", in_sig=[item], out_sig=[item])
        self.peak = 0
        self._ended = False

    def end(self):
        """Let no more samples pass; the blocks behind read what they have, and end."""
        self._ended = True

    def work(self, input_items, output_items):
        if self._ended:
            return _DONE
        items = input_items[0]
        output_items[0][:] = items
        self.peak = max(self.peak, int(items.max()), -int(items.min()))
        return len(items)
