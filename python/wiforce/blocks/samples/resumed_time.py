# SPDX-License-Identifier: GPL-3.0-or-later
"""Device times of streams that follow one another, on the clock of the first one."""

import math
import time
from collections.abc import Callable

from ..stream_time import Timeline, time_value

# Blocks take a jump of more than an hour for a wrong time (lib/kernel/timing/timeline.h); a longer
# break is reported in several steps.
_LONGEST_STEP_S = 3000.0

Time = tuple[int, float]


def _boot_time_s() -> float:
    """Seconds since the machine was started, those in standby included."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class ResumedTime:
    """Continues the time of a stream when a device is lost and found.

    The time between two streams is measured by the host's clock, since the device may have been
    started again. A stream resumes a whole number of frames after the beginning of the first one,
    because transmission and reception start together and the device's delay is constant.

    Parameters
    ----------
    sample_rate : float
        Samples per second.
    frame_length : int
        Samples per frame.
    now : callable
        Host time in seconds.

    Examples
    --------
    >>> host = iter([0.0, 2.0])
    >>> times = ResumedTime(1e6, 1000, now=lambda: next(host))
    >>> times.begin((10, 0.5))
    [(10, 0.5)]
    >>> times.received(500_000)  # the device is lost at 11.0 s, by its own clock
    >>> times.begin((0, 0.25))  # it was started again, and found after 2 s
    [(13, 0.0)]
    >>> times.of(750_000, (0, 0.5))
    (13, 0.25)
    >>> times.stream_clock
    (2, 12.75)
    """

    def __init__(
        self, sample_rate: float, frame_length: int, now: Callable[[], float] = _boot_time_s
    ) -> None:
        self._rate, self._frame, self._now = sample_rate, frame_length, now
        self._timeline = Timeline(sample_rate)
        self._items = 0  # received in all streams
        self._last_s = 0.0  # host time of the last of them
        self._origin: Time | None = None
        self._offset: Time = (0, 0.0)  # from the present stream's clock to the first one's
        self._streams = 0
        self._stream_clock = 0, 0.0

    @property
    def started(self) -> bool:
        """Whether a stream has begun."""
        return self._origin is not None

    @property
    def stream_clock(self) -> tuple[int, float]:
        """Number of streams that have begun, and what is added to the clock of the last, in s."""
        return self._stream_clock

    def begin(self, device_time: Time | None, frame_offset: int = 0) -> list[Time]:
        """A stream begins.

        Parameters
        ----------
        device_time : tuple of (int, float), optional
            Whole seconds and fraction of its first sample; without it, its clock is the number of
            its samples.
        frame_offset : int
            Where the stream resumes in a frame, by the beginning of the first stream.

        Returns
        -------
        list of tuple of (int, float)
            Times of its first samples, one for each, after which time continues: more than one
            after a long break.
        """
        device_time = device_time or (0, 0.0)
        self._streams += 1
        if self._origin is None:
            self._stream_clock = self._streams, 0.0
            self._origin = device_time
            self._timeline.note(0, time_value(*self._origin))
            return [self._origin]
        position = self._items + self._timeline.lost
        gone = position + max(self._now() - self._last_s, 0.0) * self._rate
        resumed = math.ceil((gone - frame_offset) / self._frame) * self._frame + frame_offset
        steps = math.ceil((resumed - position) / (_LONGEST_STEP_S * self._rate)) or 1
        times = []
        for step in range(1, steps + 1):
            reached = position + (resumed - position) * step // steps
            # The samples of the steps before have times as well.
            item = step - 1
            value = self._after_origin(resumed + item if step == steps else reached)
            self._timeline.note(self._items + item, time_value(*value))
            times.append(value)
        first = _added(times[-1], (0, -(steps - 1) / self._rate))
        self._offset = _added(first, (-device_time[0], -device_time[1]))
        self._stream_clock = self._streams, sum(self._offset)
        return times

    def of(self, item: int, device_time: Time) -> Time:
        """Time of a sample whose device time is known.

        Parameters
        ----------
        item : int
            Index among the samples of all streams.
        device_time : tuple of (int, float)
            By the clock of the present stream.

        Returns
        -------
        tuple of (int, float)
        """
        seconds, fraction = _added(device_time, self._offset)
        value = max(seconds, 0), fraction  # a device may report a time that cannot be
        self._timeline.note(item, time_value(*value))
        return value

    def received(self, count: int) -> None:
        """Samples have been received."""
        self._items += count
        self._last_s = self._now()

    def _after_origin(self, samples: int) -> Time:
        whole, rest = divmod(samples, self._rate)
        return _added(self._origin or (0, 0.0), (int(whole), rest / self._rate))


def _added(time: Time, other: Time) -> Time:
    fraction = time[1] + other[1]
    carried = math.floor(fraction)
    return time[0] + other[0] + carried, fraction - carried
