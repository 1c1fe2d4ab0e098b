# SPDX-License-Identifier: GPL-3.0-or-later
"""ZMQ sockets: readings out, requests in, on loopback by default, and their CURVE keys."""

from __future__ import annotations

import errno
import ipaddress
import json
import os
import re
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import InputError, unwritable
from ..optional import optional_module, optional_modules
from ..outputs import Output
from ..text.textfile import check_output
from . import is_port

SERVER = "server"
_CLIENTS = "clients"
_PUBLIC, _SECRET = ".key", ".key_secret"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
_KEY_LENGTH = 40  # in Z85, of 32 bytes
_DOMAIN = "gr-wiforce"


@dataclass(frozen=True)
class ServerKeys:
    """Keys of a socket that others connect to; those of clients are read as these connect."""

    public: bytes
    secret: bytes
    clients: Path

    @classmethod
    def load(cls, folder: str | Path) -> ServerKeys:
        """The keys in a folder that :func:`create_keys` has made, with one client at least."""
        clients = Path(folder) / _CLIENTS
        keys = cls(*_load(Path(folder) / f"{SERVER}{_SECRET}", secret=True), clients)
        if not any(keys._authorised()):
            raise InputError(clients, f"must hold the public key of a client, NAME{_PUBLIC}")
        return keys

    def apply(self, socket: Any) -> None:
        """Let a socket, before it is bound, accept the clients of its context's authenticator."""
        socket.curve_publickey, socket.curve_secretkey = self.public, self.secret
        socket.curve_server, socket.zap_domain = True, _DOMAIN.encode()
        socket.zap_enforce_domain = True

    def authenticate(self, context: Any) -> Any:
        """A thread that decides on clients of a context's sockets, to be stopped before it."""
        from zmq.auth.thread import ThreadAuthenticator

        authenticator = ThreadAuthenticator(context)
        authenticator.start()
        # Called by the authenticator: `callback(domain, key)`.
        authenticator.configure_curve_callback(_DOMAIN, credentials_provider=self)
        return authenticator

    def callback(self, domain: str, key: bytes) -> bool:
        """Whether a client with this public key, in Z85, is authorised now."""
        return key in self._authorised()

    def _authorised(self) -> Iterator[bytes]:
        """Public keys of clients; files that hold none are ignored."""
        for path in sorted(self.clients.glob(f"*{_PUBLIC}")):
            with suppress(InputError):
                yield _load(path)[0]


@dataclass(frozen=True)
class ClientKeys:
    """Keys of a client of a socket with :class:`ServerKeys`, and the ``server``'s public one."""

    public: bytes
    secret: bytes
    server: bytes

    @classmethod
    def load(cls, path: str | Path) -> ClientKeys:
        """A client's keys: ``NAME.key_secret`` with ``server.key`` beside it, or their folder."""
        path = Path(path)
        if path.is_dir():
            found = [each for each in path.glob(f"*{_SECRET}") if each.stem != SERVER]
            if len(found) != 1:
                rule = f"must hold one client's NAME{_SECRET}, but holds {len(found)}"
                raise InputError(path, f"{rule}; name the file")
            path = found[0]
        public, secret = _load(path, secret=True)
        server, _ = _load(path.with_name(f"{SERVER}{_PUBLIC}"))
        return cls(public, secret, server)

    def apply(self, socket: Any) -> None:
        """Let a socket, before it is connected, prove who it is and check the server's key."""
        socket.curve_publickey, socket.curve_secretkey = self.public, self.secret
        socket.curve_serverkey = self.server


def create_keys(folder: str | Path, client: str = "client") -> list[Path]:
    """Make the keys of a server, unless it has them, and those of a client that it accepts.

    Certificates of pyzmq that only their owner can read; returns those made, none overwritten.
    """
    folder = Path(folder)
    if not _NAME.fullmatch(client) or client == SERVER:
        rule = "must be letters, digits, - and _, up to 64, and not 'server'"
        raise InputError("--client", rule, client)
    if folder.exists() and not folder.is_dir():
        raise InputError(folder, "must be a folder, but is a file")
    if not folder.is_dir():
        check_output(folder)
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        (folder / _CLIENTS).mkdir(mode=0o700, exist_ok=True)
        targets = [folder / _CLIENTS / f"{client}{_PUBLIC}", folder / f"{client}{_SECRET}"]
        for target in targets:
            if target.exists():
                rule = "exists already, and is not overwritten; name another client with --client"
                raise InputError(target, rule)
        server = [folder / f"{SERVER}{_PUBLIC}", folder / f"{SERVER}{_SECRET}"]
        made = [] if any(path.exists() for path in server) else _create(SERVER, server)
        return made + _create(client, targets)
    except OSError as error:
        raise unwritable(error.filename2 or error.filename or folder, error) from error


def _create(name: str, targets: list[Path]) -> list[Path]:
    """Make a public and a secret certificate; fails where one exists."""
    zmq, auth = optional_modules("keys", ["zmq", "zmq.auth"])
    if not zmq.has("curve"):
        raise InputError("keys", "needs a libzmq that was built with CURVE")
    with tempfile.TemporaryDirectory(dir=targets[1].parent) as private:
        for made, target in zip(auth.create_certificates(private, name), targets, strict=True):
            os.chmod(made, 0o600)
            os.link(made, target)
    return targets


def _load(path: Path, secret: bool = False) -> tuple[bytes, bytes]:
    """Public and secret key of a certificate, of which others may not read a ``secret`` one."""
    auth = optional_module("zmq.auth", "--zmq-keys")
    if not path.is_file():
        raise InputError(path, "does not exist; `gr-wiforce keys FOLDER` makes keys")
    try:
        keys = auth.load_certificate(path)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise InputError(path, "must be a ZMQ certificate, but holds no key") from error
    if any(key is not None and len(key) != _KEY_LENGTH for key in keys):
        raise InputError(path, f"must hold keys of {_KEY_LENGTH} characters")
    if secret and keys[1] is None:
        raise InputError(path, "must hold a secret key, but holds a public one only")
    if secret and path.stat().st_mode & 0o007:
        raise InputError(path, "must not be accessible to others; correct it with chmod o=")
    return keys


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

    def serve(self, most: int) -> None:
        """Answer so many requests at most, and what was due, without waiting."""
        waiting, self._later = self._later, []
        for address, later in waiting:
            self._give(address, later)
        for _ in range(most):
            if not self._socket.poll(0):
                return
            parts = self._socket.recv_multipart()
            if b"" not in parts[1:]:
                continue  # nothing says where the peer's address ends
            begin = parts.index(b"", 1) + 1
            text = b" ".join(parts[begin:]).decode("utf-8", "replace").strip()
            self._give(parts[:begin], self._answer(text))

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
            with suppress(zmq.Again):  # refused already: to send would wait for ever
                client.send_string(word, zmq.NOBLOCK)
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
