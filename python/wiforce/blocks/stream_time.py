# SPDX-License-Identifier: GPL-3.0-or-later
"""Times on a stream of samples, as gr-uhd tags them."""

import pmt

from ..wiforce_kernels import timeline
from ..wiforce_python import rx_time_value


def time_value(seconds, fraction):
    """Value of an ``rx_time`` tag: tuple of whole seconds and the rest."""
    return pmt.make_tuple(pmt.from_uint64(seconds), pmt.from_double(fraction))


class Timeline:
    """Where the items of a stream lie on the device's count of samples, by its ``rx_time`` tags.

    Parameters
    ----------
    sample_rate : float
        Samples per second.

    Attributes
    ----------
    lost : int
        Samples lost so far.
    """

    def __init__(self, sample_rate):
        self._timeline = timeline(sample_rate)
        self.lost = 0

    def note(self, offset, value):
        """Take the tag of an item.

        What is no time is ignored, and so is one that goes back or leaps ahead by more
        than any gap, unless the next goes on from it: the rule of ``preamble_fold``.

        Parameters
        ----------
        offset : int
            The item's place in the stream; they rise from call to call.
        value : pmt
            Of the tag: tuple of whole seconds (uint64) and the fraction of one (double).

        Returns
        -------
        int
            Samples lost just before the item.
        """
        time = rx_time_value(value)
        if time is None:
            return 0
        lost = self._timeline.note(offset, *time)
        self.lost += lost
        return lost

    def time_at(self, offset):
        """Time of an item at or after the last tag.

        Parameters
        ----------
        offset : int
            Item of the stream.

        Returns
        -------
        tuple of (int, float) or None
            Whole seconds and the fraction of one, by the device's clock; None before any tag.
        """
        return self._timeline.time_at(offset)
