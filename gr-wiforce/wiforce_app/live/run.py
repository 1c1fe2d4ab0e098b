# SPDX-License-Identifier: GPL-3.0-or-later
"""A live run: a session with its device, outputs and requests, from its start to its end."""

import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial

from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network.zmq_sockets import Replies, ServerKeys, answer_words
from gnuradio.wiforce.io.outputs import Output, Outputs
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.press.tares import TareState
from gnuradio.wiforce.scene.schema import Scene

from ..radio.link import RadioLink
from ..radio.request import DeviceLost, RadioRequest, shorten_pauses
from ..shell.interrupts import BAD_INPUT, FAILED
from ..shell.log import WarningPace, log
from .health import Heartbeat, RunHealth, ServiceManager
from .monitor import SessionMonitor
from .radio_keeper import RadioKeeper, warn_of_oscillators
from .session import LiveSession

_LOOK_S = 0.1
# Of samples without frames, before a shorter run ends: a transmitter needs time to start.
_LEAST_SEARCH_S = 2.0
# So that a flood of requests does not delay the warnings.
_REQUESTS_A_LOOK = 100


@dataclass
class LiveRun:
    """What a run is made of, and the run itself."""

    scene: Scene
    request: RadioRequest
    outputs: Outputs
    files: Sequence[Output]  # added to the outputs as the last: a pipe may wait for its reader
    name: str
    endpoints: Sequence[tuple[str, ServerKeys | None]]  # where requests are taken
    duration_s: float | None  # of the stream; None: until it is ended
    reconnects: bool
    line: bool  # whether a status line may be shown
    tracked: bool
    recording: str | None

    def __post_init__(self):
        self._ending = Ending()
        self._session = LiveSession(
            self.scene, self.request, self._take, self.tracked, self.recording
        )
        self._keeper = RadioKeeper(
            self.request, self._session, self.reconnects, on_open=self._opened
        )
        self._health = RunHealth(self.name, self._session, log.info, lambda: self._keeper.state)
        self._monitor = SessionMonitor(self._session, self._health, line=self.line)
        self._service = ServiceManager(self._session, self._keeper)
        self._tares = TareLog(self._session, log.info)

    def run(self) -> int:
        """Run until a signal, a request or the duration ends it; the exit status, or DeviceLost."""
        with ExitStack() as held:
            requests = []
            for endpoint, keys in self.endpoints:
                stop = partial(self._ending.request, "request")
                replies = serve_requests(
                    endpoint, self._tares, self._monitor.status, stop=stop, keys=keys
                )
                requests.append(held.enter_context(closing(replies)))
            for file in self.files:
                self.outputs.add(file)
            self._heed_signals()
            shorten_pauses()
            return self._read(requests)

    def _opened(self, link: RadioLink) -> None:
        self.outputs.begin()
        warn_of_oscillators(link)
        log.debug(f"opened {link.hardware}")

    def _take(self, reading: Reading) -> None:
        self.outputs.write(reading, self._health.stamp(reading))
        self._health.note(reading)
        self._monitor.note(reading)

    def _heed_signals(self):
        numbers = signal.SIGINT, signal.SIGTERM
        before = {number: signal.getsignal(number) for number in numbers}

        def end(number, _):
            # Asked again, the run does not wait for the radio, but closes its files.
            signal.signal(number, before[number])
            self._ending.request("signal")

        for number in numbers:
            signal.signal(number, end)
        signal.signal(signal.SIGUSR1, lambda *_: self._tares.request())

    def _read(self, requests: Sequence[Replies]) -> int:
        session = self._session
        try:
            with Heartbeat(self._health.report, partial(self.outputs.send, "heartbeat")):
                try:
                    while self._goes_on():
                        self._look(requests)
                finally:
                    self._service.stopping()
                    try:
                        self._keeper.stop()
                    finally:
                        session.stop()
            if session.reader.failure is not None:
                raise session.reader.failure
        finally:
            self._service.close()
            self._health.look()
            self._monitor.finish()
            failure = session.recording_failure
            self.outputs.send("end", {**self._health.report(), **self._ending.report(failure)})
            if failure is not None:
                log.error(f"--record: the recording is incomplete ({failure.strerror})")
        log.info(f"read {self._monitor.summary()}")
        return 0 if failure is None else FAILED

    def _goes_on(self) -> bool:
        return not self._ending.requested.wait(_LOOK_S) and self._session.reader.failure is None

    def _look(self, requests: Sequence[Replies]) -> None:
        for part in (self._keeper, self._monitor, self._health, self._service):
            part.look()
        for each in requests:
            each.serve(_REQUESTS_A_LOOK)
        if self.duration_s is None:
            return
        searched_s = self._session.searched_s
        if self._session.time_s >= self.duration_s:
            self._ending.request("duration")
        elif searched_s >= max(self.duration_s, _LEAST_SEARCH_S):
            raise DeviceLost(f"no sounding frames found in {searched_s:.1f} s of samples")


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

    words = {
        "tare": tare,
        "tare force": lambda: tare(True),
        "status": status,
        "stop": lambda: stop() or {},
    }
    return Replies(endpoint, answer_words(words), keys=keys)


class Ending:
    """The end of a run, and why it ends."""

    def __init__(self):
        self.requested = threading.Event()
        self._reason = ""

    def request(self, reason):
        """End the run; the first reason counts."""
        self._reason = self._reason or reason
        self.requested.set()

    def report(self, failure=None):
        """The end as a message, by the exception that is being raised, or a ``failure``, if any."""
        error = sys.exc_info()[1] or failure
        reason = self._reason if error is None else str(error) or type(error).__name__
        status = BAD_INPUT if isinstance(error, InputError) else FAILED
        return {"state": "ended", "reason": reason, "exit_status": status if error else 0}
