# SPDX-License-Identifier: GPL-3.0-or-later
"""Times on a stream of samples, as gr-uhd tags them."""

from typing import Any

import pmt

from ..wiforce_kernels import timeline
from ..wiforce_python import rx_time_value


def time_value(seconds: int, fraction: float) -> Any:
    """Value of an ``rx_time`` tag.

    Parameters
    ----------
    seconds : int
        Whole seconds.
    fraction : float
        Remaining fraction of a second.

    Returns
    -------
    pmt
        Tuple of uint64 and double, as gr-uhd makes it.

    Examples
    --------
    >>> pmt.to_python(time_value(3, 0.25))
    (3, 0.25)
    """
    return pmt.make_tuple(pmt.from_uint64(seconds), pmt.from_double(fraction))


class Timeline:
    """Position of a stream's items on the device's count of samples, from its ``rx_time`` tags.

    Parameters
    ----------
    sample_rate : float
        Samples per second.

    Attributes
    ----------
    lost : int
        Samples lost so far.

    Examples
    --------
    >>> times = Timeline(sample_rate=1e6)
    >>> times.note(0, time_value(10, 0.0)), times.note(1000, time_value(10, 0.0015))
    (0, 500)
    """

    def __init__(self, sample_rate: float) -> None:
        self._timeline = timeline(sample_rate)
        self.lost = 0

    def note(self, offset: int, value: Any) -> int:
        """Take the tag of an item.

        A value that is not a time is ignored. So is an implausible time, one that goes back or
        jumps ahead by more than any gap, unless the next tag continues from it. This is the rule of
        ``preamble_fold``.

        Parameters
        ----------
        offset : int
            The item's index in the stream, rising from call to call.
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

    def time_at(self, offset: int) -> tuple[int, float] | None:
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
