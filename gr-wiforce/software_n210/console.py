# SPDX-License-Identifier: GPL-3.0-or-later
"""Control of a running device: a line in, a line of JSON out, on standard input or over ZMQ."""

import json
import os
import stat

from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network.zmq_sockets import Replies, endpoint_of, is_loopback

from .faults import parse_fault

# So that a flood of requests does not stop the streams.
_REQUESTS_A_TURN = 10

USAGE = {
    "press": "press SENSOR FORCE_N LOCATION_MM",
    "release": "release SENSOR",
    "fault": "fault TIME KIND [ARGUMENTS]",
    "status": "status",
    "sent": "sent",
    "stop": "stop",
}


class Console:
    """Executes the lines of the control."""

    def __init__(self, device):
        self._device = device

    def answer(self, line):
        """Execute a line; JSON with ``ok``, and ``error`` or the requested values."""
        try:
            return json.dumps({"ok": True, **self._do(line)})
        except InputError as error:
            return json.dumps({"ok": False, "error": str(error)})

    def _do(self, line):
        name, *arguments = line.split() or [""]
        if name not in USAGE:
            raise InputError("control", f"must be one of: {'; '.join(USAGE.values())}", line)
        return getattr(self, f"_{name}")(arguments) or {}

    def _press(self, arguments):
        sensor, *numbers = self._take("press", arguments, 3, 3)
        self._device.air.press(sensor, *_numbers("press", numbers))

    def _release(self, arguments):
        self._device.air.release(*self._take("release", arguments, 1, 1))

    def _fault(self, arguments):
        self._device.add_fault(parse_fault(" ".join(arguments), "fault"))

    def _status(self, arguments):
        self._take("status", arguments, 0, 0)
        return self._device.status()

    def _sent(self, arguments):
        self._take("sent", arguments, 0, 0)
        return {"sent_s": self._device.take_sent()}

    def _stop(self, arguments):
        self._take("stop", arguments, 0, 0)
        self._device.stop()

    def _take(self, name, arguments, least, most):
        if not least <= len(arguments) <= most:
            raise InputError("control", f"must have the form: {USAGE[name]}", " ".join(arguments))
        return arguments


def _numbers(name, texts):
    try:
        return [float(text) for text in texts]
    except ValueError:
        raise InputError("control", f"must have the form: {USAGE[name]}", " ".join(texts)) from None


class LineControl:
    """Lines on a file descriptor, answers on a stream.

    The end of a pipe ends the device, because the process at its other end has gone.
    """

    def __init__(self, console, device, descriptor, out):
        self._console, self._device, self._descriptor, self._out = console, device, descriptor, out
        self._rest = b""
        device.watch(descriptor, self._read)

    def _read(self):
        data = os.read(self._descriptor, 65536)
        if not data:
            self._device.unwatch(self._descriptor)
            if stat.S_ISFIFO(os.fstat(self._descriptor).st_mode):
                self._device.stop()
            return
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            if line.strip():
                print(self._console.answer(line.decode("utf-8", "replace")), file=self._out)
        self._out.flush()


class ZmqControl:
    """The same lines as requests over ZMQ on loopback."""

    def __init__(self, console, device, endpoint):
        if not is_loopback(endpoint_of(endpoint, "--control")):
            rule = "must be a port or tcp://127.0.0.1:PORT; other machines have no access"
            raise InputError("--control", rule, endpoint)
        self._replies = Replies(endpoint, console.answer)
        self.close = self._replies.close
        device.watch(self._replies.fileno(), lambda: self._replies.serve(_REQUESTS_A_TURN))
