# SPDX-License-Identifier: GPL-3.0-or-later
"""A live run as a service: what it reports to systemd, and the log when it is stuck."""

import os
import socket
import time
from collections.abc import Callable, MutableMapping

from ..shell.log import log
from .radio_keeper import OPENING, RUNNING, RadioKeeper
from .session import LiveSession

_STATUS_S = 10.0
# Of an output that takes no readings, or a block that does not return.
_STUCK_S = 10.0


class ServiceManager:
    """The protocol of ``sd_notify(3)``, for this process only; without systemd only the log."""

    def __init__(
        self,
        session: LiveSession,
        keeper: RadioKeeper,
        environment: MutableMapping[str, str] = os.environ,
        now: Callable[[], float] = time.monotonic,
    ):
        self._session, self._keeper, self._now = session, keeper, now
        address = environment.pop("NOTIFY_SOCKET", "")
        limit_us = environment.pop("WATCHDOG_USEC", "")
        process = environment.pop("WATCHDOG_PID", str(os.getpid()))
        watched = limit_us.isdecimal() and process == str(os.getpid())
        # Half of the limit, as sd_watchdog_enabled(3) advises.
        self._alive_every_s = 0.5e-6 * int(limit_us) if watched else float("inf")
        self._alive_s, self._status_s = 0.0, -_STATUS_S
        self._ready, self._stuck, self._state = False, False, ""
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.setblocking(False)

    def look(self) -> None:
        """Tell what is due, and that the reader works unless samples are not taken from it."""
        now, state = self._now(), self._keeper.state
        if not self._ready and (state != OPENING or self._keeper.waits):
            self._ready = self._send("READY=1")
        stuck = self._session.behind_s > _STUCK_S
        if stuck and not self._stuck:
            log.error(
                f"no samples have been read for {_STUCK_S:g} s, although the device runs: an "
                "output takes no readings, or this machine is far too slow"
            )
        self._stuck = stuck
        if not stuck and now - self._alive_s >= self._alive_every_s and self._send("WATCHDOG=1"):
            self._alive_s = now
        if state != self._state or now - self._status_s >= _STATUS_S:
            text = {OPENING: "waiting for the device", RUNNING: "reading"}.get(state, state)
            groups = self._session.reader.counts.short()
            if self._send(f"STATUS={text}; {self._session.time_s:.0f} s, {groups}"):
                self._state, self._status_s = state, now

    def stopping(self) -> None:
        """The service ends."""
        self._send("STOPPING=1")

    def close(self) -> None:
        """Give back the socket."""
        self._socket.close()

    def _send(self, text):
        """Whether systemd has it; a queue that is full is tried again by the next call."""
        try:
            if self._address:
                self._socket.sendto(text.encode(), self._address)
        except OSError:
            return False
        return True
