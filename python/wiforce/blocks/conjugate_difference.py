# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: each end's channel against its reference."""

import numpy as np
import pmt

from .. import names
from ..errors import InputError
from ..estimation.reference import ConjugateDifference
from ..signal.waveform import sounding_waveform
from .group_block import GroupBlock, state_of


class conjugate_difference(GroupBlock):
    """V conj(V_ref) of every end and subcarrier.

    Input and output: vectors 2S x 64, tagged ``state``. Scaled so that the average over
    subcarriers with the noise weights is R with its magnitude. The groups of the reference are
    held back until it is complete.
    Message port ``tare``: any message takes the reference anew from the groups that follow.

    Parameters
    ----------
    sensors : int
        S, two ends each.
    reference_groups : int
        Groups at the start that make the untouched reference; absent ones are not made good.
    against : str
        ``untouched``, or ``previous`` for the group before (paper, section 3.3).
    waveform : str
        ``repeated`` or ``wifi``.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.
    """

    def __init__(self, sensors=1, reference_groups=13, against="untouched", waveform="repeated"):
        if sensors < 1:
            raise InputError("sensors", "must be at least 1", sensors)
        self._ends = 2 * sensors
        bins = sounding_waveform(waveform).bins
        self.difference = ConjugateDifference(self._ends, bins, reference_groups, against)
        GroupBlock.__init__(self, "conjugate_difference", self._ends * 64, self._ends * 64)
        self.message_port_register_in(pmt.intern(names.TARE))
        self.set_msg_handler(pmt.intern(names.TARE), self._on_tare)

    # GNU Radio finds a handler by its name: a lambda has none that it knows.
    def _on_tare(self, message):
        self.difference.tare()

    def take(self, tags, item):
        vectors = np.asarray(item, complex).reshape(self._ends, 64)
        results = self.difference.process(state_of(tags), vectors)
        return [(state, values.ravel()) for state, values in results]
