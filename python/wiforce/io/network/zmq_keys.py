# SPDX-License-Identifier: GPL-3.0-or-later
"""CURVE keys of ZMQ sockets: encryption, and which clients may connect."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import InputError, unwritable
from ..optional import optional_module, optional_modules
from ..text.textfile import check_output

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
