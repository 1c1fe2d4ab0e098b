# SPDX-License-Identifier: GPL-3.0-or-later
"""Requests to a live run, and the pace of what it says."""

import json
import math
import time
from collections.abc import Callable
from concurrent.futures import Future

from gnuradio.wiforce.io.network.zmq_sockets import Replies, ServerKeys, answer_words
from gnuradio.wiforce.press.tares import TareState

from .session import LiveSession

_SHORTEST_S, _LONGEST_S = 1.0, 600.0


class WarningPace:
    """Allows a kind of warning, after pauses that double from 1 s to 10 min while it goes on."""

    def __init__(self, now: Callable[[], float]):
        self._now = now
        self._last_s: dict[str, float] = {}
        self._pause_s: dict[str, float] = {}

    def allows(self, kind: str) -> bool:
        """Whether a warning that is due may be written now; if so, it counts as written."""
        now, pause_s = self._now(), self._pause_s.get(kind, 0.0)
        quiet_s = now - self._last_s.get(kind, -math.inf)
        if quiet_s < pause_s:
            return False
        longer = quiet_s < 2 * max(pause_s, _SHORTEST_S)
        self._pause_s[kind] = min(2 * pause_s, _LONGEST_S) if longer and pause_s else _SHORTEST_S
        self._last_s[kind] = now
        return True


class TareLog:
    """Requests tares, and says in the log what became of them, which no flood of them fills."""

    def __init__(
        self,
        session: LiveSession,
        log: Callable[[str], None],
        now: Callable[[], float] = time.monotonic,
    ):
        self._session, self._log = session, log
        self._pace = WarningPace(now)
        self._logged: TareState | None = None

    def request(self, force: bool = False, done: Callable[[TareState], None] | None = None):
        """Request a tare; ``done`` is called in another thread with its outcome."""

        def finish(state):
            # Requests during a tare share it and its outcome.
            if state is not self._logged and self._pace.allows(state.state):
                forced = " (forced)" * state.forced
                reason = f": {state.reason}" * bool(state.reason)
                self._log(f"tare {state.state}{forced}{reason}")
            self._logged = state
            if done is not None:
                done(state)

        self._session.reader.tare(force, finish)


def serve_requests(
    endpoint: str,
    tares: TareLog,
    status: Callable[[], dict],
    stop: Callable[[], None],
    keys: ServerKeys | None = None,
) -> Replies:
    """Accept requests on a ZMQ socket: ``tare``, ``tare force``, ``status`` and ``stop``."""

    def tare(force=False):
        later = Future()

        def done(state):
            ok = state.state == "complete"
            error = {} if ok else {"error": f"tare {state.state}: {state.reason}"}
            later.set_result(json.dumps({"ok": ok, **error, **state.row()}))

        tares.request(force, done)
        return later

    def end():
        stop()
        return {}

    words = {
        "tare": tare,
        "tare force": lambda: tare(True),
        "status": status,
        "stop": end,
    }
    return Replies(endpoint, answer_words(words), keys=keys)
