# SPDX-License-Identifier: GPL-3.0-or-later
"""Reports of a live run to systemd: readiness, one line of state, and signs of life."""

import time
from collections.abc import Callable

from ..shell.log import log
from .radio_keeper import OPENING, RUNNING, RadioKeeper
from .service_manager import ServiceManager
from .session import LiveSession

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
