# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: one complex ratio per end from one per subcarrier."""

import numpy as np

from ..errors import InputError
from ..estimation.average import SubcarrierAverage
from ..signal.waveform import sounding_waveform
from .group_block import GroupBlock, state_of


class subcarrier_average(GroupBlock):
    """R of every end: the average over subcarriers, weighted by the noise of each.

    Input: vectors 2S x 64 from ``conjugate_difference``; output: vectors 2S, R with its magnitude;
    both tagged ``state``, to which the standard deviation of arg R is added.

    Parameters
    ----------
    sensors : int
        S, two ends each.
    smoothing_groups : int
        Groups averaged for as long as nothing changes; 1 for none.
    waveform : str
        ``repeated`` or ``wifi``.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.
    """

    def __init__(self, sensors=1, smoothing_groups=1, waveform="repeated"):
        if sensors < 1:
            raise InputError("sensors", "must be at least 1", sensors)
        self._ends = 2 * sensors
        self.average = SubcarrierAverage(sounding_waveform(waveform).bins, smoothing_groups)
        GroupBlock.__init__(self, "subcarrier_average", self._ends * 64, self._ends)

    def take(self, tags, item):
        vectors = np.asarray(item, complex).reshape(self._ends, 64)
        return [self.average.process(state_of(tags), vectors)]
