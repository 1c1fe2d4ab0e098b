# SPDX-License-Identifier: GPL-3.0-or-later
"""A device that plays loops to the live reader, in the place of the process that uses UHD."""

import socket
import time
from functools import partial

import numpy as np
from gnuradio.wiforce.blocks.sample_streams import SampleTag, pack_head
from loops import RATE_HZ
from wiforce_app.radio.request import DeviceAbsent, DeviceLost
from wiforce_app.radio.streams import ClockComparison

PACKET = 125_000  # 0.1 s
_BUFFER_BYTES = 1 << 20


class PlayedLink:
    """What a ``RadioKeeper`` sees of the device; see ``RadioLink`` for its attributes."""

    def __init__(self, device):
        self._device = device
        self.hardware, self.settings, self.unlocked = None, {}, []
        self.aligned = False
        self.started, self.clock, self.underflows_s = False, None, []
        self._ours, self.samples = socket.socketpair()
        self.samples.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
        self._clocks = ClockComparison(
            lambda: device.time_s, device.clock.time, device.clock.monotonic
        )
        self.lost = ""
        self.streams = False  # whether samples are asked for

    @property
    def opened(self):
        return self.hardware is not None

    def take_samples(self):
        ours, self._ours = self._ours, None
        return ours

    def start(self):
        self.streams = True

    def poll(self, timeout_s=0.0):
        device = self._device
        if self.lost:
            raise DeviceLost(self.lost)
        if not self.opened:
            if device.absent:
                raise DeviceAbsent("--args", "must name a device that answers")
            self.hardware = "played"
            device.link = self
        if (compared := self._clocks.look()) is not None:
            self.clock = compared

    def stop(self, timeout_s=2.0):
        self.samples.close()

    def close(self, timeout_s=0.0):
        self.samples.close()
        if self._ours is not None:
            self._ours.close()
        if self._device.link is self:
            self._device.link = None

    discard = close


class Device:
    """Plays samples to whatever link is open, and keeps time.

    ``clock``: goes on as samples are played. ``absent``: it does not answer; ``link``: the one that
    is open; ``turns``: quarter turns of the oscillators' phase.
    """

    def __init__(self, clock, noise, rng):
        self.clock, self._noise, self._rng = clock, noise, rng
        self.absent, self.link, self.turns = False, None, 0
        self._offset_s = 0.0
        self._tags = True  # of the next packet
        self._packet = np.empty((PACKET, 2), np.int16)
        self._turned = np.empty((PACKET, 2), np.int16)

    @property
    def time_s(self):
        """Time by the device's clock."""
        return self.clock.now_s + self._offset_s

    def start_again(self):
        """Switched off and on: its clock begins anew, and its oscillators have other phases."""
        self._offset_s = self._rng.uniform(20, 100) - self.clock.now_s
        self.turns = int(self._rng.integers(4))
        self._tags = True

    def send(self, codes):
        """Send samples, a packet at most; time passes.

        Returns bool: whether there was a reader to send them to.
        """
        count = len(codes)
        first_s = self.time_s
        self.clock.now_s += count / RATE_HZ
        out = self._packet[:count]
        self._noise.add(self._turn(codes), out)
        return self._put(pack_head(count, self._due_tags(first_s))) and self._put(out)

    def send_part(self, codes):
        """Send the head of a packet, but only a part of its samples: the device is lost in it."""
        first_s = self.time_s
        head = pack_head(2 * len(codes), self._due_tags(first_s))
        self.clock.now_s += len(codes) / RATE_HZ
        return self._put(head) and self._put(np.ascontiguousarray(codes))

    def tag_next(self):
        """The next packet carries the time: samples were lost before it."""
        self._tags = True

    @property
    def tags_next(self):
        """Whether the next packet carries a time."""
        return self._tags is not False

    def tag_wrongly(self, ahead_s):
        """The next packet carries a time that cannot be."""
        self._tags = ahead_s

    def lose(self, reason):
        """End the link as the process of a device that is lost does."""
        link, self.link = self.link, None
        link.samples.close()
        link.lost = reason

    def _due_tags(self, first_s):
        due, self._tags = self._tags, False
        if due is False:
            return []
        shown_s = first_s + (0.0 if due is True else due)
        whole = int(shown_s // 1)
        return [SampleTag("rx_time", 0, whole, shown_s - whole)]

    def _turn(self, codes):
        if self.turns == 0:
            return codes
        turned = self._turned[: len(codes)]
        if self.turns == 2:
            return np.negative(codes, out=turned)
        sign = 1 if self.turns == 1 else -1
        np.multiply(codes[:, 1], -sign, out=turned[:, 0])
        np.multiply(codes[:, 0], sign, out=turned[:, 1])
        return turned

    def _put(self, data):
        link = self.link
        if link is None:
            return False
        try:
            link.samples.sendall(data.data if isinstance(data, np.ndarray) else data)
        except OSError:
            return False
        return True


def wait_for(condition, limit_s=60.0):
    """Wait in the time of the machine; whether it became true."""
    end = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(2e-4)
    return True


_PAUSE_S = 2e-4


class PlayedTime:
    """Stands in for the module ``time`` where the live reader asks for it.

    ``utc_offset_s``: what is added for UTC; changes when somebody sets the host's clock.
    """

    CLOCK_BOOTTIME = time.CLOCK_BOOTTIME

    def __init__(self):
        self.now_s, self.utc_offset_s = 1000.0, 1.8e9

    def monotonic(self):
        return self.now_s

    def time(self):
        return self.now_s + self.utc_offset_s

    def clock_gettime(self, _):
        return self.now_s

    def sleep(self, _):
        time.sleep(_PAUSE_S)

    def __getattr__(self, name):
        return getattr(time, name)

    def install(self, link, on_health):
        """Let the live reader use this time, and a device of ours.

        ``link``: makes what stands in for a RadioLink; ``on_health``: called with the RunHealth of
        each run.
        """
        from gnuradio.wiforce.blocks import sample_streams
        from gnuradio.wiforce.io.files import writers
        from wiforce_app.live import health, live, monitor, radio_keeper, service_manager, session

        for module in (sample_streams, session, health):
            module.time = self
        made_health = health.RunHealth

        def run_health(*arguments, **options):
            made = made_health(*arguments, **options, now=self.monotonic)
            on_health(made)
            return made

        health.RunHealth = run_health
        radio_keeper.RadioKeeper = partial(radio_keeper.RadioKeeper, link=link, now=self.monotonic)
        monitor.SessionMonitor = partial(monitor.SessionMonitor, now=self.monotonic)
        service_manager.ServiceReport = partial(service_manager.ServiceReport, now=self.monotonic)
        writers.RotatingWriter = partial(writers.RotatingWriter, now=self.time)
        # These pauses are in the time of the machine.
        live._LOOK_S = health._LOOK_S = 0.03
