# SPDX-License-Identifier: GPL-3.0-or-later
"""ZMQ sockets: readings out, requests in, on loopback by default."""

import errno
import ipaddress
import json
import threading
import time
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


# A request is a line; a peer that sends more is cut off before it takes memory.
_LONGEST_REQUEST = 4096
# A subscription is the first bytes of a message. ZMQ keeps all of them, so both their length and
# their number are limited.
_LONGEST_SUBSCRIPTION = 48
_MOST_SUBSCRIPTIONS = 1000
# Subscriptions of a peer that may wait while nothing is sent.
_WAITING_SUBSCRIPTIONS = 100
# The limit holds for the messages of a CURVE handshake too, which have some 300 bytes.
_LONGEST_HANDSHAKE = 1024
_REBIND_S = 5.0
# Requests that wait for an answer; more are refused.
_MOST_WAITING = 100
# What ZMQ reports of an address that no network interface of this machine has.
_FOREIGN_ADDRESS = (errno.ENODEV, errno.EADDRNOTAVAIL)


class _Endpoint:
    """A bound ZMQ socket of its own context."""

    kind = ""
    longest = _LONGEST_REQUEST

    def __init__(self, endpoint: str, option: str, keys: ServerKeys | None) -> None:
        self._address = endpoint_of(endpoint, option)
        zmq = optional_module("zmq", option)
        self._context, self._keys = zmq.Context(), keys
        self._authenticator = keys.authenticate(self._context) if keys is not None else None
        self._socket = self._open()
        try:
            self._socket.bind(self._address)
        except zmq.ZMQError as error:
            self.close()
            reason = str(error)
            if error.errno in _FOREIGN_ADDRESS:
                reason = "ADDRESS must be an IPv4 address of this machine, or * for all it has"
            raise InputError(option, f"cannot be bound ({reason})", endpoint) from error

    def _open(self) -> Any:
        """A new socket with its options."""
        import zmq

        opened = self._context.socket(getattr(zmq, self.kind))
        longest = self.longest
        if self._keys is not None:
            self._keys.apply(opened)
            longest = max(longest, _LONGEST_HANDSHAKE)
        opened.maxmsgsize = longest
        return opened

    def close(self) -> None:
        """Give the endpoint back; what was just sent still has a moment to leave."""
        self._socket.close(linger=200)
        if self._authenticator is not None:
            self._authenticator.stop()
        self._context.term()


class ReadingsPublisher(_Endpoint, Output):
    """Readings and other messages as JSON for up to 1000 subscriptions, by several threads."""

    kind = "XPUB"
    longest = _LONGEST_SUBSCRIPTION

    def __init__(
        self, endpoint: str, option: str = "--zmq", keys: ServerKeys | None = None
    ) -> None:
        self._subscriptions, self._lock = 0, threading.Lock()
        super().__init__(endpoint, option, keys)

    def write_rows(self, rows: Iterable[Mapping[str, Any]]) -> None:
        for row in rows:
            self.send("reading", row)

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        """Send a JSON object whose first key, ``message``, is its kind."""
        text = json.dumps({"message": kind, **report}, allow_nan=False)
        with self._lock:
            if self._count_subscriptions() > _MOST_SUBSCRIPTIONS:
                self._disconnect_all()
            self._socket.send_string(text)

    def _open(self) -> Any:
        opened = super()._open()
        opened.rcvhwm = _WAITING_SUBSCRIPTIONS
        opened.xpub_verboser = True  # every subscription is counted, also equal ones
        return opened

    def _count_subscriptions(self) -> int:
        from zmq import EVENTS, POLLIN

        # Without what `poll` makes of a list of sockets, and Python of flags that are combined.
        while self._subscriptions <= _MOST_SUBSCRIPTIONS and (
            self._socket.getsockopt(EVENTS) & int(POLLIN)
        ):
            change = self._socket.recv()[:1]
            self._subscriptions += {b"\1": 1, b"\0": -1}.get(change, 0)
        return self._subscriptions

    def _disconnect_all(self) -> None:
        """Free all subscriptions; peers that ZMQ connects again subscribe again."""
        import zmq

        self._socket.close(linger=0)
        self._socket, self._subscriptions = self._open(), 0
        deadline = time.monotonic() + _REBIND_S
        while True:
            try:
                self._socket.bind(self._address)
                return
            except zmq.ZMQError:  # the old socket is closed by another thread
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.005)


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
            answer = self._answer(text)
            if isinstance(answer, Future) and len(self._later) >= _MOST_WAITING:
                error = f"{_MOST_WAITING} requests wait already"
                answer = json.dumps({"ok": False, "error": error})
            self._give(parts[:begin], answer)
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
            return _receive_answer(client, refusals, timeout_s, keys is not None)
        except zmq.ZMQError as error:
            reason = str(error)
            if error.errno == errno.EINVAL:
                reason = "ADDRESS must be that of one machine"
            raise InputError("ENDPOINT", f"cannot be connected to ({reason})", endpoint) from error
        finally:
            client.disable_monitor()


# What it means that a handshake failed, by another protocol or without a word, of a client that has
# keys or none.
_REFUSALS = {
    (True, True): "the server has no keys; connect without them",
    (True, False): "is missing: the server accepts clients with keys only",
    (False, True): "the server cannot read this client; its server.key is another server's",
    (False, False): "is missing, or ENDPOINT is not that of a reader: it ended the connection",
}


def _receive_answer(client: Any, refusals: Any, timeout_s: float, has_keys: bool) -> str | None:
    """The answer; InputError for a refusal, or a silence behind a handshake that was cut off."""
    import zmq
    from zmq.utils.monitor import recv_monitor_message

    poller = zmq.Poller()
    poller.register(client, zmq.POLLIN)
    poller.register(refusals, zmq.POLLIN)
    rule, deadline = "", time.monotonic() + timeout_s
    while (remaining_s := deadline - time.monotonic()) > 0:
        ready = dict(poller.poll(max(1, round(1000 * remaining_s))))
        if client in ready:
            return str(client.recv_string())
        if refusals in ready:
            event = recv_monitor_message(refusals)["event"]
            rule = _REFUSALS[event == zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL, has_keys]
            if event == zmq.EVENT_HANDSHAKE_FAILED_AUTH:
                rule = "the server does not accept this client; its public key must be in the "
                rule += "folder 'clients' of the server's keys"
            if event != zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL:
                break
    if rule:
        raise InputError("--zmq-keys", rule)
    return None
