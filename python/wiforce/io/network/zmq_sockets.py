# SPDX-License-Identifier: GPL-3.0-or-later
"""ZMQ sockets: readings out, requests in, on loopback by default."""

import errno
import ipaddress
import json
import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from typing import Any

from ...errors import InputError
from ..optional import optional_module
from ..outputs import Output
from . import is_port
from .zmq_keys import ClientKeys, ServerKeys


def endpoint_of(text: str, option: str) -> str:
    """A ZMQ endpoint of ``PORT`` (on loopback), ``[tcp://]ADDRESS:PORT`` or ``ipc:///PATH``."""
    if text.startswith("ipc:///"):
        return text
    address, _, port = text.rpartition(":")
    if "://" not in address:
        address = f"tcp://{address or 'localhost'}"
    if address == "tcp://localhost":
        address = "tcp://127.0.0.1"
    if not address.startswith("tcp://") or address == "tcp://" or not is_port(port):
        raise InputError(option, "must be a port from 1 to 65535, or tcp://ADDRESS:PORT", text)
    return f"{address}:{port}"


def is_loopback(endpoint: str) -> bool:
    """Whether only programs of this machine can connect to an endpoint (:func:`endpoint_of`)."""
    if endpoint.startswith("ipc://"):
        return True
    host = endpoint.removeprefix("tcp://").rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:  # a name: of a host, or of a network interface
        return host == "localhost"


# The longest message that is received; a peer that sends more is cut off before it takes memory.
_LONGEST = 4096
# What ZMQ reports of an address that no network interface of this machine has.
_FOREIGN_ADDRESS = (errno.ENODEV, errno.EADDRNOTAVAIL)


class _Endpoint:
    """A bound ZMQ socket of its own context."""

    kind = ""

    def __init__(self, endpoint: str, option: str, keys: ServerKeys | None) -> None:
        address = endpoint_of(endpoint, option)
        zmq = optional_module("zmq", option)
        self._context = zmq.Context()
        self._authenticator = keys.authenticate(self._context) if keys is not None else None
        self._socket = self._context.socket(getattr(zmq, self.kind))
        self._socket.maxmsgsize = _LONGEST
        if keys is not None:
            keys.apply(self._socket)
        try:
            self._socket.bind(address)
        except zmq.ZMQError as error:
            self.close()
            reason = str(error)
            if error.errno in _FOREIGN_ADDRESS:
                reason = "ADDRESS must be an IPv4 address of this machine, or * for all it has"
            raise InputError(option, f"cannot be bound ({reason})", endpoint) from error

    def close(self) -> None:
        """Give the endpoint back; what was just sent still has a moment to leave."""
        self._socket.close(linger=200)
        if self._authenticator is not None:
            self._authenticator.stop()
        self._context.term()


class ReadingsPublisher(_Endpoint, Output):
    """Readings and other messages as JSON for any number of subscribers, by several threads."""

    kind = "PUB"

    def __init__(
        self, endpoint: str, option: str = "--zmq", keys: ServerKeys | None = None
    ) -> None:
        self._lock = threading.Lock()
        super().__init__(endpoint, option, keys)

    def write_rows(self, rows: Iterable[Mapping[str, Any]]) -> None:
        for row in rows:
            self.send("reading", row)

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        """Send a JSON object whose first key, ``message``, is its kind."""
        text = json.dumps({"message": kind, **report}, allow_nan=False)
        with self._lock:
            self._socket.send_string(text)


# An answer, perhaps one that another thread gives later.
Answer = str | Future[str]


class Replies(_Endpoint):
    """Requests of REQ sockets, answered with a string, or later, by a ROUTER."""

    kind = "ROUTER"

    def __init__(
        self, endpoint: str, answer: Callable[[str], Answer], keys: ServerKeys | None = None
    ) -> None:
        self._answer = answer
        self._later: list[tuple[list[bytes], Future[str]]] = []
        super().__init__(endpoint, "--control", keys)

    def fileno(self) -> int:
        """Descriptor that becomes readable when requests may have come in."""
        return self._socket.fileno()

    def serve(self, most: int) -> bool:
        """Answer so many requests at most, and what was due, without waiting; whether more wait."""
        waiting, self._later = self._later, []
        for address, later in waiting:
            self._give(address, later)
        for _ in range(most):
            if not self._socket.poll(0):
                return False
            parts = self._socket.recv_multipart()
            if b"" not in parts[1:]:
                continue  # nothing says where the peer's address ends
            begin = parts.index(b"", 1) + 1
            text = b" ".join(parts[begin:]).decode("utf-8", "replace").strip()
            self._give(parts[:begin], self._answer(text))
        return True

    def _give(self, address: list[bytes], answer: Answer) -> None:
        """Send an answer, or keep one that is not given yet."""
        if isinstance(answer, Future) and not answer.done():
            self._later.append((address, answer))
            return
        text = answer if isinstance(answer, str) else answer.result()
        self._socket.send_multipart([*address, text.encode()])

    def close(self) -> None:
        """Send the answers that are due, and give the endpoint back."""
        if self._later:
            self.serve(0)
        super().close()


def answer_words(
    handlers: Mapping[str, Callable[[], dict[str, Any] | Future[str]]],
) -> Callable[[str], Answer]:
    """An answer for :class:`Replies`: JSON of the dict that the handler of a word returns."""

    def answer(word: str) -> Answer:
        if word not in handlers:
            rule = f"must be one of {', '.join(handlers)}, got {word[:80]!r}"
            return json.dumps({"ok": False, "error": rule})
        result = handlers[word]()
        return result if isinstance(result, Future) else json.dumps({"ok": True, **result})

    return answer


def request(
    endpoint: str, word: str, timeout_s: float, keys: ClientKeys | None = None
) -> str | None:
    """The answer of :class:`Replies` to a word; None when there is none in time."""
    address = endpoint_of(endpoint, "ENDPOINT")
    zmq = optional_module("zmq", "ENDPOINT")
    with zmq.Context() as context, context.socket(zmq.REQ) as client:
        client.linger = 0
        if keys is not None:
            keys.apply(client)
        refusals = client.get_monitor_socket(
            zmq.EVENT_HANDSHAKE_FAILED_AUTH
            | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
            | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
        )
        try:
            client.connect(address)
            client.send_string(word)
            poller = zmq.Poller()
            poller.register(client, zmq.POLLIN)
            poller.register(refusals, zmq.POLLIN)
            ready = dict(poller.poll(max(1, round(1000 * timeout_s))))
            if client in ready:
                return str(client.recv_string())
            if refusals in ready:
                rule = "must be those of a client in the folder 'clients' of the server's keys, or "
                rule += "none where the server has none"
                raise InputError("--zmq-keys", f"{rule}; or ENDPOINT is no reader's", endpoint)
            return None
        except zmq.ZMQError as error:
            reason = str(error)
            if error.errno == errno.EINVAL:
                reason = "ADDRESS must be that of one machine"
            raise InputError("ENDPOINT", f"cannot be connected to ({reason})", endpoint) from error
        finally:
            client.disable_monitor()
