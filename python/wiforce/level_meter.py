# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: passes samples on and watches how far they fill the converter's range."""

import numpy as np
import pmt
from gnuradio import gr

from . import names
from .stream_time import Timeline

FULL_SCALE = 32768
# The codes next to full scale: a 14-bit converter's last code, after rounding on the way.
CLIPPED = 32752
_RX_TIME = pmt.intern(names.RX_TIME)


class level_meter(gr.sync_block):
    """Passes complex 16-bit samples through, noting their peak and where they clip.

    Parameters
    ----------
    sample_rate : float
        Samples per second.
    group_samples : int
        Samples in a phase group; the stream begins with the first group.

    Attributes
    ----------
    peak : int
        Largest magnitude of a component since it was last set to 0.
    clipped_groups : set of int
        Groups with samples at full scale.
    timeline : Timeline
    """

    def __init__(self, sample_rate, group_samples):
        item = (np.int16, 2)
        gr.sync_block.__init__(self, "level_meter", in_sig=[item], out_sig=[item])
        self.peak, self.clipped_groups = 0, set()
        self.timeline = Timeline(sample_rate)
        self._group_samples = group_samples

    def work(self, input_items, output_items):
        items = input_items[0]
        output_items[0][:] = items
        for tag in self.get_tags_in_window(0, 0, len(items), _RX_TIME):
            self.timeline.note(tag.offset, tag.value)
        largest = max(int(items.max()), -int(items.min()))
        self.peak = max(self.peak, largest)
        if largest >= CLIPPED:
            self._note_clipped(items)
        return len(items)

    def _note_clipped(self, items):
        clipped = np.flatnonzero((items >= CLIPPED).any(axis=1) | (items <= -CLIPPED).any(axis=1))
        first = self.nitems_read(0) + self.timeline.lost
        self.clipped_groups.update(np.unique((first + clipped) // self._group_samples).tolist())
