# SPDX-License-Identifier: GPL-3.0-or-later
"""Times on a stream of samples, as gr-uhd tags them."""

import pmt

_LONGEST_GAP_S = 3600.0
_LARGEST_FRACTION_S = 1e9


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
        self._last = self._doubtful = None
        self.lost = 0

    def note(self, offset, value):
        """Take the tag of an item; returns the samples lost just before it.

        A time that cannot be read is ignored, and so is one that goes back or leaps ahead by more
        than any gap, unless the next agrees with it: the rule of ``preamble_fold``.
        """
        time = _seconds(value)
        if time is None:
            return 0
        here = (offset, *time)
        lost = 0 if self._last is None else self._lead(here, self._last)
        if not 0 <= lost <= _LONGEST_GAP_S * self._rate:
            if self._doubtful is None or self._lead(here, self._doubtful) != 0:
                self._doubtful = here
                return 0
            lost = 0
        self._last, self._doubtful = here, None
        self.lost += lost
        return lost

    def _lead(self, time, since):
        """Samples by which a time is later than the items since another time account for."""
        passed = (time[1] - since[1]) + (time[2] - since[2])
        return round(passed * self._rate - (time[0] - since[0]))

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
        time = pmt.to_uint64(pmt.tuple_ref(value, 0)), pmt.to_double(pmt.tuple_ref(value, 1))
    except (RuntimeError, TypeError, ValueError):
        return None
    return time if 0 <= time[1] < _LARGEST_FRACTION_S else None
