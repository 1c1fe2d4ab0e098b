# SPDX-License-Identifier: GPL-3.0-or-later
"""Reports to systemd: readiness, state in one line, and signs of life."""

import os
import socket
import time
from collections.abc import Callable, MutableMapping


class ServiceManager:
    """The protocol of ``sd_notify(3)``; does nothing unless systemd started the process.

    ``environment``: of the process. The variables of the protocol are removed, so that processes
    that are started do not report in its place.
    """

    def __init__(
        self,
        environment: MutableMapping[str, str] = os.environ,
        now: Callable[[], float] = time.monotonic,
    ):
        self._now = now
        address = environment.pop("NOTIFY_SOCKET", None)
        limit_us = environment.pop("WATCHDOG_USEC", "")
        process = environment.pop("WATCHDOG_PID", str(os.getpid()))
        watched = limit_us.isdecimal() and process == str(os.getpid())
        # Half of the limit, as sd_watchdog_enabled(3) advises.
        self._every_s = int(limit_us) * 0.5e-6 if watched else None
        self._alive_s = -float("inf")
        self._ready, self._status = False, None
        self._socket = None
        if address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
            self._address = "\0" + address[1:] if address.startswith("@") else address

    def ready(self) -> None:
        """The service has started."""
        if not self._ready:
            self._ready = self._send("READY=1")

    def status(self, text: str) -> None:
        """The state, as ``systemctl status`` shows it."""
        if text != self._status and self._send(f"STATUS={text}"):
            self._status = text

    def alive(self) -> None:
        """The service does its work; systemd restarts one that does not say so in time."""
        due = self._every_s is not None and self._now() - self._alive_s >= self._every_s
        if due and self._send("WATCHDOG=1"):
            self._alive_s = self._now()

    def stopping(self) -> None:
        """The service ends."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Give back the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text):
        """Whether systemd has it; a queue that is full is tried again by the next call."""
        if self._socket is not None:
            try:
                self._socket.sendto(text.encode(), self._address)
            except OSError:
                return False
        return True
