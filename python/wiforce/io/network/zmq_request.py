# SPDX-License-Identifier: GPL-3.0-or-later
"""A request to a ZMQ socket, and why it is not answered."""

import errno
import time
from typing import Any

from ...errors import InputError
from ..optional import optional_module
from .zmq_keys import ClientKeys
from .zmq_sockets import endpoint_of

_OPTION = "--zmq-keys"


class _Handshake:
    """Observes the connection of a client's socket.

    Parameters
    ----------
    socket : zmq.Socket
        Not connected yet.
    has_keys : bool
        Whether it has keys.
    """

    def __init__(self, socket: Any, has_keys: bool) -> None:
        import zmq

        self._socket, self._has_keys = socket, has_keys
        self.events = socket.get_monitor_socket(
            zmq.EVENT_HANDSHAKE_FAILED_AUTH
            | zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
            | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
        )
        self._cut_off = False

    def look(self) -> None:
        """Take the events so far.

        Raises
        ------
        InputError
            When the server does not accept the client, and has said why.
        """
        import zmq
        from zmq.utils.monitor import recv_monitor_message

        while self.events.poll(0):
            event = recv_monitor_message(self.events)["event"]
            if event == zmq.EVENT_HANDSHAKE_FAILED_AUTH:
                rule = "the server does not accept this client; its public key must be in the "
                raise InputError(_OPTION, f"{rule}folder 'clients' of the server's keys")
            if event == zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL and self._has_keys:
                raise InputError(_OPTION, "the server has no keys; connect without them")
            if event == zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL:
                raise InputError(_OPTION, "is missing: the server accepts clients with keys only")
            self._cut_off = True

    def explain(self) -> None:
        """What a silence means, once the time to wait is over.

        Raises
        ------
        InputError
            When the server ended the connection during the handshake.
        """
        self.look()
        if self._cut_off and self._has_keys:
            rule = "the server cannot read this client; its server.key is another server's"
            raise InputError(_OPTION, rule)
        if self._cut_off:
            rule = "is missing, or ENDPOINT is not that of a reader: it ended the connection"
            raise InputError(_OPTION, rule)

    def close(self) -> None:
        """Observe no more."""
        self._socket.disable_monitor()


def request(
    endpoint: str,
    word: str,
    timeout_s: float,
    option: str = "ENDPOINT",
    keys: ClientKeys | None = None,
) -> str | None:
    """Ask a :class:`zmq_sockets.Replies` for something.

    Returns str or None: the answer; None when there is none in time.

    Parameters
    ----------
    endpoint : str
        As for :func:`zmq_sockets.endpoint_of`.
    timeout_s : float
        Time to wait for the answer.
    option : str
        Name of the parameter, for messages.
    keys : ClientKeys, optional
        Where the server has keys.

    Raises
    ------
    InputError
        When pyzmq is missing, the endpoint is none, or the server does not accept the keys.
    """
    address = endpoint_of(endpoint, option)
    zmq = optional_module("zmq", option)
    with zmq.Context() as context, context.socket(zmq.REQ) as client:
        client.setsockopt(zmq.LINGER, 0)
        if keys is not None:
            keys.apply(client)
        handshake = _Handshake(client, keys is not None)
        try:
            client.connect(address)
            client.send_string(word)
            return _receive_answer(client, handshake, timeout_s)
        except zmq.ZMQError as error:
            reason = str(error)
            if error.errno == errno.EINVAL:
                reason = "ADDRESS must be that of one machine"
            raise InputError(option, f"cannot be connected to ({reason})", endpoint) from error
        finally:
            handshake.close()


def _receive_answer(client: Any, handshake: _Handshake, timeout_s: float) -> str | None:
    import zmq

    poller = zmq.Poller()
    poller.register(client, zmq.POLLIN)
    poller.register(handshake.events, zmq.POLLIN)
    deadline = time.monotonic() + timeout_s
    while (remaining_s := deadline - time.monotonic()) > 0:
        if client in dict(poller.poll(max(1, round(1000 * remaining_s)))):
            return str(client.recv_string())
        handshake.look()
    handshake.explain()
    return None
