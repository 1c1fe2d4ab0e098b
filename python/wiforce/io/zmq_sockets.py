# SPDX-License-Identifier: GPL-3.0-or-later
"""ZMQ sockets: readings out, requests in, on loopback unless told otherwise."""

import json
import re

from gnuradio.wiforce.errors import InputError


def endpoint_of(text, option):
    """A ZMQ endpoint from ``PORT`` (on loopback) or ``tcp://ADDRESS:PORT``.

    Raises
    ------
    InputError
    """
    address, _, port = text.rpartition(":")
    if not address:
        address = "tcp://127.0.0.1"
    if not address.startswith("tcp://") or not _is_port(port):
        raise InputError(option, "must be a port or tcp://ADDRESS:PORT", text)
    return f"{address}:{port}"


def _is_port(text):
    return re.fullmatch("[0-9]{1,5}", text) is not None and 0 < int(text) < 65536


# A request is a line; a peer that sends more is cut off before it takes memory.
_LONGEST_REQUEST = 4096


class _Endpoint:
    """A bound ZMQ socket of its own context."""

    def __init__(self, endpoint, kind, option):
        try:
            import zmq
        except ImportError as error:
            raise InputError(option, "needs pyzmq (python3-zmq)", endpoint) from error
        self._context = zmq.Context()
        self._socket = self._context.socket(getattr(zmq, kind))
        self._socket.setsockopt(zmq.MAXMSGSIZE, _LONGEST_REQUEST)
        try:
            self._socket.bind(endpoint_of(endpoint, option))
        except (zmq.ZMQError, InputError) as error:
            self.close()
            if isinstance(error, InputError):
                raise
            raise InputError(option, f"cannot be bound ({error})", endpoint) from error

    def close(self):
        """Give the endpoint back; what was just sent still has a moment to leave."""
        self._socket.close(linger=200)
        self._context.term()


class ReadingsPublisher(_Endpoint):
    """Readings as JSON on a PUB socket.

    Raises
    ------
    InputError
        When pyzmq is missing or the endpoint cannot be bound.
    """

    def __init__(self, endpoint, option="--zmq"):
        super().__init__(endpoint, "PUB", option)

    def publish(self, reading, device_time_s):
        """Send one reading: the keys of a JSON line, and ``device_time_s``."""
        message = {**reading.row(), "device_time_s": device_time_s}
        self._socket.send_string(json.dumps(message, allow_nan=False))


class Replies(_Endpoint):
    """Requests of REQ sockets, each answered with a string.

    A ROUTER socket: a REP socket waits where a message is none that a REQ socket sends, and then
    loses an answer to another.

    Parameters
    ----------
    endpoint : str
    answer : callable
        Takes the text of a request.

    Raises
    ------
    InputError
        When pyzmq is missing or the endpoint cannot be bound.
    """

    def __init__(self, endpoint, answer, option="--control"):
        super().__init__(endpoint, "ROUTER", option)
        self._answer = answer

    def fileno(self):
        """Descriptor that becomes readable when requests may have come in."""
        return self._socket.fileno()

    def serve(self, most):
        """Answer what has come in, so many requests at most; never waits.

        Returns
        -------
        bool
            Whether more may be there. The descriptor does not tell of these.
        """
        for _ in range(most):
            if not self._socket.poll(0):
                return False
            parts = self._socket.recv_multipart()
            if b"" not in parts[1:]:
                continue  # nothing says where the peer's address ends
            begin = parts.index(b"", 1) + 1
            text = b" ".join(parts[begin:]).decode("utf-8", "replace").strip()
            self._socket.send_multipart([*parts[:begin], self._answer(text).encode()])
        return True


def answer_words(handlers):
    """An answer for `Replies`: JSON of what the handler of a word returns, a dict."""

    def answer(word):
        if word not in handlers:
            rule = f"must be one of {', '.join(handlers)}, got {word[:80]!r}"
            return json.dumps({"ok": False, "error": rule})
        return json.dumps({"ok": True, **handlers[word]()})

    return answer
