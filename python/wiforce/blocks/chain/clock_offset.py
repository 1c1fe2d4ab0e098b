# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: offset of each tag's clock, as found by the separation."""

import numpy as np
import pmt
from gnuradio import gr

from ...errors import InputError
from ...estimation.groups import Array
from .. import names
from ..argument_types import typed
from ..kept import Kept
from . import state_tag

_STATE = pmt.intern(names.STATE)


class clock_offset(Kept, gr.sync_block):
    """Offset of every tag's clock against its nominal frequency.

    Input: vectors tagged ``state``, from ``end_separation`` or any block after it. Output: vectors
    of S floats, ppm, positive for a fast tag; NaN while a clock is not known.

    Parameters
    ----------
    sensors : int
        S.
    length : int
        Complex numbers per input vector: 2 S times the samples of a symbol after
        ``end_separation``, 128 S for the default waveform.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.

    Examples
    --------
    >>> offset = clock_offset(sensors=2, length=256)
    """

    @typed
    def __init__(self, sensors: int = 1, length: int = 128) -> None:
        for name, value in (("sensors", sensors), ("length", length)):
            if value < 1:
                raise InputError(name, "must be at least 1", value)
        item = np.float32 if sensors == 1 else (np.float32, sensors)
        gr.sync_block.__init__(self, "clock_offset", [(np.complex64, length)], [item])
        self.set_tag_propagation_policy(gr.TPP_DONT)
        self._sensors = sensors

    def work(self, input_items: list[Array], output_items: list[Array]) -> int:
        out = output_items[0]
        out[:] = np.nan
        for tag in self.get_tags_in_window(0, 0, len(out), _STATE):
            state = state_tag.from_pmt(tag.value)
            row = out.reshape(len(out), -1)[tag.offset - self.nitems_read(0)]
            count = min(self._sensors, state.locked.shape[1])
            locked = state.locked[0, :count]
            row[:count][locked] = state.clock_offset_ppm[0, :count][locked]
        return len(out)
