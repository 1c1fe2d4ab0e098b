# SPDX-License-Identifier: GPL-3.0-or-later
"""The process that uses a radio, on behalf of a :class:`.link.RadioLink`.

A driver and its blocks may abort or hang when a device disappears. In a process of their own they
cannot end the reader. It is given two sockets: one for samples, and one on which it takes the
request and reports events.
"""

import contextlib
import os
import signal
import socket
import sys
from multiprocessing.connection import Connection

from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network.device_lock import DeviceLock

from .request import LOST_STATUS, DeviceAbsent, DeviceLost, DeviceUnusable, shorten_pauses

_LOOK_S = 0.1


def run(control: Connection, samples: socket.socket) -> None:
    """Open the device that is asked for, and stream until the reader stops it."""
    try:
        _serve(control, samples)
    except InputError as error:
        _report(control, "failed", error)
        if isinstance(error, DeviceUnusable):
            _exit(samples)  # a thread waits for the driver, perhaps for ever
    except EOFError:
        pass  # the reader has gone
    except Exception as error:  # of any kind: what the bindings make of the driver's
        if not isinstance(error, DeviceLost):
            from .radio import last_line

            error = DeviceLost(f"does not answer any more ({last_line(error)})")
        _report(control, "failed", error)
        _exit(samples)  # UHD's blocks cannot be stopped without their device


def _serve(control, samples):
    from .radio import open_radio
    from .streams import RadioStreams

    request = control.recv()
    lock = DeviceLock(request.args)
    radio = _opened(open_radio, request)
    lock.take_serial(radio.serial)
    streams = RadioStreams(radio, request, samples)
    with radio.applying("--args", request.args, rule="must name a device that states what it does"):
        _report_clock(streams, control)  # before there are readings, which are stamped with UTC
        opened = radio.hardware, radio.settings(), radio.unlocked(), streams.aligned
    _report(control, "opened", opened)
    shorten_pauses()
    control.recv()  # to start
    # From here on, the reader asks to stop, or has gone: its end must stop the device as well.
    streams.start(control.poll)
    _report(control, "started")
    while not control.poll(_LOOK_S):
        streams.check()
        _report_clock(streams, control)
        if (underflow_s := streams.take_underflow_s()) > 0:
            _report(control, "underflow", underflow_s)
    streams.stop()
    samples.close()
    _report(control, "stopped")
    del streams, radio  # UHD closes the device here
    lock.release()


def _report(control, event, value=None):
    with contextlib.suppress(OSError):
        control.send((event, value))


def _report_clock(streams, control):
    if (found := streams.clock()) is not None:
        _report(control, "clock", found)


def _opened(open_radio, request):
    """The radio; UHD waits 0.1 s for answers, which a busy network may exceed once."""
    try:
        return open_radio(request)
    except DeviceAbsent:
        return open_radio(request)


def _exit(samples):
    samples.close()
    os._exit(LOST_STATUS)


def main():
    """Run with the sockets whose descriptors are the arguments."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1):
        signal.signal(number, signal.SIG_IGN)  # meant for the reader, which ends this process
    control, samples = map(int, sys.argv[1:3])
    run(Connection(control), socket.socket(fileno=samples))


if __name__ == "__main__":
    main()
