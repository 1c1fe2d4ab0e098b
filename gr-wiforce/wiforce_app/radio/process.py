# SPDX-License-Identifier: GPL-3.0-or-later
"""The process that uses a radio, on behalf of a :class:`.link.RadioLink`.

A driver and its blocks may abort or hang when a device disappears. In a process of their own they
cannot end the reader. It is given two sockets: one for samples, and one on which it takes lines of
text and reports events as lines of JSON.
"""

import contextlib
import json
import os
import select
import signal
import socket
import sys
import time

from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network.device_lock import DeviceLock

from .request import (
    LOST_STATUS,
    DeviceAbsent,
    DeviceLost,
    DeviceUnusable,
    RadioRequest,
    shorten_pauses,
)

_LOOK_S = 0.1


class _Control:
    """Lines from the reader, events to it."""

    def __init__(self, control):
        self._control = control
        self._rest = b""

    def line(self, timeout_s):
        """The next line; None when there is none in time, EOFError when the reader has gone."""
        deadline = time.monotonic() + timeout_s
        while b"\n" not in self._rest:
            remaining_s = max(deadline - time.monotonic(), 0)
            if not select.select([self._control], [], [], remaining_s)[0]:
                return None
            data = self._control.recv(65536)
            if not data:
                raise EOFError
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        return line.decode()

    def report(self, event, **fields):
        """Report an event."""
        with contextlib.suppress(OSError):
            self._control.sendall(json.dumps({"event": event, **fields}).encode() + b"\n")


def run(control: socket.socket, samples: socket.socket) -> None:
    """Open the device that is asked for, and stream until the reader stops it."""
    reader = _Control(control)
    try:
        _serve(reader, samples)
    except InputError as error:
        rule = str(error).removeprefix(f"{error.where}: ")
        reader.report("refused", kind=type(error).__name__, where=error.where, rule=rule)
        if isinstance(error, DeviceUnusable):
            _exit(samples, LOST_STATUS)  # a thread waits for the driver, perhaps for ever
    except EOFError:
        pass  # the reader has gone
    except DeviceLost as error:
        _lose(reader, samples, str(error))
    except Exception as error:  # of any kind: what the bindings make of the driver's
        from .radio import last_line

        _lose(reader, samples, f"does not answer any more ({last_line(error)})")


def _serve(reader, samples):
    from .radio import open_radio
    from .streams import RadioStreams

    request = RadioRequest.from_json(_wait_for_line(reader))
    lock = DeviceLock(request.args)
    radio = _opened(open_radio, request)
    lock.take_serial(radio.serial)
    streams = RadioStreams(radio, request, samples)
    with radio.applying("--args", request.args, rule="must name a device that states what it does"):
        _report_clock(streams, reader)  # before there are readings, which are stamped with UTC
        opened = {
            "hardware": radio.hardware,
            "settings": radio.settings(),
            "unlocked": radio.unlocked(),
            "aligned": streams.aligned,
        }
    reader.report("opened", **opened)
    shorten_pauses()
    _wait_for_line(reader)  # start
    stopping = []

    def stopped(timeout_s=0.0):
        if not stopping:
            try:
                line = reader.line(timeout_s)
            except EOFError:
                line = "stop"
            stopping.extend([line] if line else [])
        return bool(stopping)

    streams.start(stopped)
    reader.report("started")
    # When the reader has been killed, both sockets are closed: the device must be stopped then.
    while not stopped(_LOOK_S):
        streams.check()
        _report_clock(streams, reader)
        if (underflow_s := streams.take_underflow_s()) > 0:
            reader.report("underflow", seconds=underflow_s)
    streams.stop()
    samples.close()
    reader.report("stopped")
    del streams, radio  # UHD closes the device here
    lock.release()


def _report_clock(streams, reader):
    if (found := streams.clock()) is not None:
        reader.report("clock", offset_s=found[0], uncertainty_s=found[1])


def _opened(open_radio, request):
    """The radio; UHD waits 0.1 s for answers, which a busy network may exceed once."""
    try:
        return open_radio(request)
    except DeviceAbsent:
        return open_radio(request)


def _wait_for_line(reader):
    while (line := reader.line(1.0)) is None:
        pass
    return line


def _lose(reader, samples, reason):
    reader.report("lost", reason=reason)
    _exit(samples, LOST_STATUS)  # UHD's blocks cannot be stopped without their device


def _exit(samples, status):
    samples.close()
    os._exit(status)


def main():
    """Run with the sockets whose descriptors are the arguments."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1):
        signal.signal(number, signal.SIG_IGN)  # meant for the reader, which ends this process
    control, samples = (socket.socket(fileno=int(text)) for text in sys.argv[1:3])
    run(control, samples)


if __name__ == "__main__":
    main()
