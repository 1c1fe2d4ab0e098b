# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: keeps the first samples of a stream and discards the others."""

import numpy as np
from gnuradio import gr

from ...estimation.groups import Array
from ..argument_types import typed
from ..kept import Kept


class sample_keeper(Kept, gr.sync_block):
    """Keeps the first complex 16-bit samples of its input, without ever ending the flowgraph.

    Parameters
    ----------
    count : int
        Samples to keep.

    Attributes
    ----------
    samples : ndarray of int16, shape (n, 2)
        I and Q of the samples kept so far.

    Examples
    --------
    >>> sample_keeper(1000).samples.shape
    (0, 2)
    """

    @typed
    def __init__(self, count: int) -> None:
        gr.sync_block.__init__(self, "sample_keeper", in_sig=[(np.int16, 2)], out_sig=None)
        self._kept, self._count = np.empty((count, 2), np.int16), 0

    @property
    def samples(self) -> Array:
        return self._kept[: self._count]

    def work(self, input_items: list[Array], _: list[Array]) -> int:
        items = input_items[0]
        part = items[: len(self._kept) - self._count]
        self._kept[self._count : self._count + len(part)] = part
        self._count += len(part)
        return len(items)
