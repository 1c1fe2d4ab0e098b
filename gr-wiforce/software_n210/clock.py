# SPDX-License-Identifier: GPL-3.0-or-later
"""The device's clock: ticks since power-on, and the device time that the host sets."""

from .wire import TICK_RATE

# Device time is a counter of 64 bits: a host may set it right before its end.
_TIME_SPAN = 1 << 64


class DeviceClock:
    """Ticks at 100 MHz and the settable device time, with a pulse per second.

    Everything inside the device is scheduled in `ticks`, which never decrease. Times that the host
    reads or sets are device time, ``ticks + offset``.

    ``ticks``: ticks since power-on; ``offset``: device time minus ticks; ``last_pulse``: device
    time at the last pulse per second (every whole second since power-on).
    """

    def __init__(self):
        self.ticks = 0
        self.offset = 0
        self.last_pulse = 0
        self._low = 0
        self._immediate = False
        self._at_pulse = None

    @property
    def time(self):
        """Device time in ticks."""
        return (self.ticks + self.offset) % _TIME_SPAN

    def to_ticks(self, time):
        """Ticks since power-on of a device time."""
        since = (time - self.offset) % _TIME_SPAN
        return since - _TIME_SPAN if since >= _TIME_SPAN // 2 else since

    def to_time(self, ticks):
        """Device time of a tick since power-on."""
        return (ticks + self.offset) % _TIME_SPAN

    def advance(self, ticks):
        """Advance to `ticks`, and set a time that waits for a pulse per second in between."""
        pulse = ticks // TICK_RATE * TICK_RATE
        if pulse > self.ticks:
            if self._at_pulse is not None:
                self.offset = self._at_pulse - pulse
                self._at_pulse = None
            self.last_pulse = (pulse + self.offset) % _TIME_SPAN
        self.ticks = ticks

    def poke(self, register, value):
        """Write register 0..5 of the time block: 0 high word (latches), 1 low, 3 immediate."""
        if register == 1:
            self._low = value
        elif register == 3:
            self._immediate = bool(value & 1)
        elif register == 0:
            time = value << 32 | self._low
            if self._immediate:
                self.offset = time - self.ticks
                self._at_pulse = None
            else:
                self._at_pulse = time
