# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples of a stream to tones, in the two blocks that the Reader uses: the second is in Python.

The Reader's own second block surveys and reads the groups as well, which ``bench read`` measures.
"""

import time

import numpy as np
from gnuradio import wiforce
from gnuradio.wiforce.blocks.chain.group_block import GroupBlock
from gnuradio.wiforce.blocks.reading.group_reader import snapshot_group
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.wiforce_kernels import tone_transform

from .recording import GROUP_LENGTH, WAVEFORM


def collected_groups(item_type):
    """The block that folds samples, collects the snapshots of each group and screens them."""
    return wiforce.preamble_fold.collected(GROUP_LENGTH, WAVEFORM.frame_length, item_type=item_type)


class ToneSink(GroupBlock):
    """Computes the tones of complete groups as the Reader does.

    Parameters
    ----------
    weights : ndarray, shape (M, 625)

    Attributes
    ----------
    tones : list of ndarray, shape (M, 64)
        Channel at the tones, group by group.
    times : list of float
        Of ``time.monotonic()`` when each group's tones were ready, in s.
    """

    def __init__(self, weights):
        GroupBlock.__init__(self, "tone_sink", GROUP_LENGTH * WAVEFORM.symbol_length, outputs=0)
        bins = range(WAVEFORM.symbol_length)
        self._kernel = tone_transform(weights, WAVEFORM.equalizer(), np.zeros(0), bins)
        self.tones, self.times = [], []

    def take(self, items, tags):
        for item, own in zip(items, tags, strict=True):
            group = snapshot_group(item, own)
            if not group.kept.all():
                raise ValueError("a group of this stream is complete and without interference")
            self.tones.append(self._kernel.transform(group.folded))
            self.times.append(time.monotonic())
        return len(items), Groups(np.zeros(0, np.int64))
