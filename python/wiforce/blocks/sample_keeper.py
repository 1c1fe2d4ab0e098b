# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: keeps the first samples of a stream, and lets the rest go by."""

import numpy as np
from gnuradio import gr


class sample_keeper(gr.sync_block):
    """Keeps the first complex 16-bit samples of its input, without ever ending the flowgraph.

    Parameters
    ----------
    count : int

    Attributes
    ----------
    samples : ndarray of int16, shape (n, 2)
        I and Q of what was kept so far.
    """

    def __init__(self, count):
        gr.sync_block.__init__(self, "sample_keeper", in_sig=[(np.int16, 2)], out_sig=None)
        self._kept, self._count = np.empty((count, 2), np.int16), 0

    @property
    def samples(self):
        return self._kept[: self._count]

    def work(self, input_items, _):
        items = input_items[0]
        part = items[: len(self._kept) - self._count]
        self._kept[self._count : self._count + len(part)] = part
        self._count += len(part)
        return len(items)
