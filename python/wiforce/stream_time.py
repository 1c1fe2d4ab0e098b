# SPDX-License-Identifier: GPL-3.0-or-later
"""Times on a stream of samples, as gr-uhd tags them."""

import pmt

from .wiforce_numerics import timeline


def time_value(seconds, fraction):
    """Value of an ``rx_time`` tag: tuple of whole seconds and the rest."""
    return pmt.make_tuple(pmt.from_uint64(seconds), pmt.from_double(fraction))


class Timeline:
    """Where the items of a stream lie on the device's count of samples, by its ``rx_time`` tags.

    Parameters
    ----------
    sample_rate : float

    Attributes
    ----------
    lost : int
        Samples lost so far.
    """

    def __init__(self, sample_rate):
        self._timeline = timeline(sample_rate)
        self.lost = 0

    def note(self, offset, value):
        """Take the tag of an item; returns the samples lost just before it.

        A time that cannot be read is ignored, and so is one that goes back or leaps ahead by more
        than any gap, unless the next goes on from it: the rule of ``preamble_fold``.
        """
        try:
            time = pmt.to_uint64(pmt.tuple_ref(value, 0)), pmt.to_double(pmt.tuple_ref(value, 1))
        except (RuntimeError, TypeError, ValueError):
            return 0
        lost = self._timeline.note(offset, *time)
        self.lost += lost
        return lost

    def time_at(self, offset):
        """(whole seconds, fraction) of an item at or after the last tag; None before any."""
        return self._timeline.time_at(offset)
