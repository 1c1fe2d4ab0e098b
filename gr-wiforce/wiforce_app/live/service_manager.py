# SPDX-License-Identifier: GPL-3.0-or-later
"""A live run as a service: systemd's protocol, and what it is told."""

import os
import socket
import time
from collections.abc import Callable, MutableMapping

from ..shell.log import log
from .radio_keeper import OPENING, RUNNING, RadioKeeper
from .session import LiveSession


class ServiceManager:
    """The protocol of ``sd_notify(3)``, for this process only; nothing without systemd."""

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


_STATUS_S = 10.0
# Of an output that takes no readings, or a block that does not return.
_STUCK_S = 10.0


class ServiceReport:
    """Reports a session to systemd, and to the log when it is stuck."""

    def __init__(
        self,
        service: ServiceManager,
        session: LiveSession,
        keeper: RadioKeeper,
        now: Callable[[], float] = time.monotonic,
    ):
        self._service, self._session, self._keeper, self._now = service, session, keeper, now
        self._status_s = -_STATUS_S
        self._state = ""
        self._stuck = False

    def look(self) -> None:
        """Report what is due."""
        if self._keeper.state != OPENING or self._keeper.waits:
            self._service.ready()
        self._note_progress()
        now, state = self._now(), self._keeper.state
        if state != self._state or now - self._status_s >= _STATUS_S:
            self._state, self._status_s = state, now
            self._service.status(self._text(state))

    def _note_progress(self):
        """Tell that the reader works; say nothing while samples are not taken from it."""
        stuck = self._session.behind_s > _STUCK_S
        if not stuck:
            self._service.alive()
        elif not self._stuck:
            log.error(
                f"no samples have been read for {_STUCK_S:g} s, although the device runs: an "
                "output takes no readings, or this machine is far too slow"
            )
        self._stuck = stuck

    def _text(self, state):
        session = self._session
        text = {OPENING: "waiting for the device", RUNNING: "reading"}.get(state, state)
        return f"{text}; {session.time_s:.0f} s, {session.reader.counts.short()}"
