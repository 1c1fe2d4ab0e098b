# SPDX-License-Identifier: GPL-3.0-or-later
"""A device in a process of its own: the reader's end, and what the process does.

A driver and its blocks may abort or hang when a device disappears. In a process of their own they
cannot end the reader. It is given two sockets: one for samples, and one on which it takes the
request and reports events.
"""

import contextlib
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
from multiprocessing.connection import Connection

from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network.device_lock import DeviceLock

from ..shell.workers import end_within, spawned
from .request import (
    LOST_STATUS,
    DeviceAbsent,
    DeviceLost,
    DeviceUnusable,
    RadioRequest,
    shorten_pauses,
)

_STOP_S = 2.0
_CLOSE_S = 5.0  # UHD takes 1.5 s to close a device


class RadioLink:
    """A device, opened in a process of its own."""

    def __init__(self, request: RadioRequest):
        self.hardware: str | None = None  # kind and serial number, once the device is open
        self.settings: dict = {}  # gains and antennas
        self.aligned = False  # whether the samples begin with a frame
        self.unlocked: list[str] = []  # directions (tx, rx) whose oscillator has not locked
        self.started = False  # samples have been received
        # Offset of UTC from the device's clock by the latest comparison, and its uncertainty, in s.
        self.clock: tuple[float, float] | None = None
        self.underflow_s = 0.0  # how long nothing was transmitted
        self._stopped = False
        self._samples: socket.socket | None
        self._samples, samples = socket.socketpair()
        self._control, control = multiprocessing.Pipe()
        with samples, control:
            self._process = spawned(f"{__package__}.link", control.fileno(), samples.fileno())
        self._send(request)

    @property
    def opened(self) -> bool:
        return self.hardware is not None

    def take_samples(self) -> socket.socket:
        """Where the samples arrive; given once, to a ``sample_receiver``, which closes it."""
        assert self._samples is not None
        samples, self._samples = self._samples, None
        return samples

    def start(self) -> None:
        """Start both streams, once the device is open."""
        self._send("start")

    def poll(self) -> None:
        """Take what the process reports, or raise DeviceAbsent, -Busy, -Unusable or -Lost."""
        while self._control.poll():
            try:
                report = self._control.recv()
            except (EOFError, OSError):
                raise DeviceLost(self._end()) from None
            if isinstance(report, Exception):
                raise report
            assert report.keys() <= vars(self).keys()  # the process names attributes of this link
            vars(self).update(report)

    def stop(self) -> None:
        """Stop both streams; the samples received so far arrive before the stream ends."""
        self._send("stop")
        with contextlib.suppress(DeviceLost, InputError):
            while not self._stopped and self._control.poll(_STOP_S):
                self.poll()

    def close(self) -> None:
        """Close the device and end the process."""
        self._control.close()
        if self._samples is not None:
            self._samples.close()
        end_within(self._process, _CLOSE_S)

    def discard(self) -> None:
        """End the process without waiting for its device, which is lost."""
        self._process.kill()
        self.close()

    def _send(self, message):
        with contextlib.suppress(OSError):  # it has ended, which `poll` reports
            self._control.send(message)

    def _end(self):
        """How the process has ended, in words."""
        try:
            status = self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            return "is lost: its process does not respond"
        if status == LOST_STATUS:
            return "cannot be reached any more"
        if status < 0:
            return f"is lost: its process was ended by {signal.Signals(-status).name}"
        return f"is lost: its process ended with status {status}"


# The process, whose module this is as well.

_LOOK_S = 0.1


def _run(control: Connection, samples: socket.socket) -> None:
    """Open the device that is asked for, and stream until the reader stops it."""
    try:
        _serve(control, samples)
    except InputError as error:
        _report(control, error)
        if isinstance(error, DeviceUnusable):
            _exit(samples)  # a thread waits for the driver, perhaps for ever
    except EOFError:
        pass  # the reader has gone
    except Exception as error:  # of any kind: what the bindings make of the driver's
        if not isinstance(error, DeviceLost):
            from .radio import last_line

            error = DeviceLost(f"does not answer any more ({last_line(error)})")
        _report(control, error)
        _exit(samples)  # UHD's blocks cannot be stopped without their device


def _serve(control, samples):
    from gnuradio.wiforce.blocks.usrp import opened

    from .radio import open_radio
    from .streams import RadioStreams

    request = control.recv()
    locks = [DeviceLock(request.args)]
    if request.tx_args is not None:
        locks.append(DeviceLock(request.tx_args, where="--tx-args"))
    radio = opened(lambda: open_radio(request), DeviceAbsent)
    for lock, serial in zip(locks, radio.serials, strict=False):
        lock.take_serial(serial)
    streams = RadioStreams(radio, request, samples)
    with radio.applying("--args", request.args, rule="must name a device that states what it does"):
        _report_clock(streams, control)  # before there are readings, which are stamped with UTC
        stated = {"settings": radio.settings(), "unlocked": radio.unlocked()}
    _report(control, stated | {"hardware": radio.hardware, "aligned": streams.aligned})
    shorten_pauses()
    control.recv()  # to start
    # From here on, the reader asks to stop, or has gone: its end must stop the device as well.
    streams.start(control.poll)
    _report(control, {"started": True})
    reported_s = 0.0
    while not control.poll(_LOOK_S):
        streams.check()
        _report_clock(streams, control)
        if streams.underflow_s > reported_s:
            reported_s = streams.underflow_s
            _report(control, {"underflow_s": reported_s})
    streams.stop()
    samples.close()
    _report(control, {"_stopped": True})
    del streams, radio  # UHD closes the device here
    for lock in locks:
        lock.release()


def _report(control, report):
    """Send what ended the process, or attributes of the reader's end."""
    with contextlib.suppress(OSError):
        control.send(report)


def _report_clock(streams, control):
    if (found := streams.clock()) is not None:
        _report(control, {"clock": found})


def _exit(samples):
    samples.close()
    os._exit(LOST_STATUS)


def main():
    """Run with the sockets whose descriptors are the arguments."""
    control, samples = map(int, sys.argv[1:3])
    _run(Connection(control), socket.socket(fileno=samples))


if __name__ == "__main__":
    main()
