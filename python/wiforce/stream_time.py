# SPDX-License-Identifier: GPL-3.0-or-later
"""Times on a stream of samples, as gr-uhd tags them."""

import pmt


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
        self._rate = sample_rate
        self._last = None
        self.lost = 0

    def note(self, offset, value):
        """Take the tag of an item; returns the samples lost just before it.

        A time that goes back or cannot be read is no loss.
        """
        time = _seconds(value)
        if time is None:
            return 0
        lost = 0
        if self._last is not None:
            item, whole, fraction = self._last
            passed = (time[0] - whole) + (time[1] - fraction)
            lost = max(0, round(passed * self._rate - (offset - item)))
        self._last = (offset, *time)
        self.lost += lost
        return lost

    def time_at(self, offset):
        """(whole seconds, fraction) of an item at or after the last tag; None before any."""
        if self._last is None:
            return None
        item, whole, fraction = self._last
        fraction += (offset - item) / self._rate
        carried = int(fraction)
        return whole + carried, fraction - carried


def _seconds(value):
    try:
        return pmt.to_uint64(pmt.tuple_ref(value, 0)), pmt.to_double(pmt.tuple_ref(value, 1))
    except (RuntimeError, TypeError, ValueError):
        return None
