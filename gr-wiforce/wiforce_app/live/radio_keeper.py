# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps a live session supplied with samples: opens the device, and again when it is lost."""

import time
from collections.abc import Callable

from gnuradio.wiforce.errors import InputError

from ..radio.link import RadioLink
from ..radio.request import DeviceAbsent, DeviceLost, RadioRequest
from ..shell.log import WarningPace, log
from .session import LiveSession

OPENING, RUNNING, RECONNECTING, STOPPING = "opening", "running", "reconnecting", "stopping"

_SHORTEST_PAUSE_S, _LONGEST_PAUSE_S = 0.5, 30.0
_STEADY_S = 10.0  # of samples, after which the next loss is not the last one continued
_SILENCE_S = 8.0  # longer than the device's process takes to find out by itself
_REMIND_S = 600.0


class RadioKeeper:
    """Opens a session's device; with ``reconnect``, waits 0.5 s to 30 s for one that is lost.

    ``on_open`` is called before its first sample; ``state`` is ``opening`` at first.
    """

    def __init__(
        self,
        request: RadioRequest,
        session: LiveSession,
        reconnect: bool = False,
        on_open: Callable[[RadioLink], None] = lambda link: None,
        link: Callable[[RadioRequest], RadioLink] = RadioLink,
        now: Callable[[], float] = time.monotonic,
    ):
        self._request, self._session, self._reconnect = request, session, reconnect
        self._on_open, self._make_link, self._now = on_open, link, now
        self._link: RadioLink | None = None
        self._attached = False
        self._underflow_s = 0.0  # of the link, as far as it was warned of
        self._pause_s = _SHORTEST_PAUSE_S
        self._next_s = self._running_s = self._lost_s = now()
        self._pace = WarningPace(now)
        self._reason, self._reminded_s = "", -_REMIND_S
        self.state = OPENING

    @property
    def waits(self) -> bool:
        """Whether the device is absent, and sought again and again."""
        return self._reason != ""

    def look(self) -> None:
        """Open, start or lose the device, without waiting; DeviceLost if not to be reopened."""
        if self._link is None:
            if self._now() < self._next_s:
                return
            request = self._session.next_request(self._request)
            self._link, self._attached = self._make_link(request), False
            self._underflow_s = 0.0
        try:
            self._link.poll()
            self._check_samples()
        except InputError as error:
            absent = isinstance(error, DeviceAbsent)
            self._fail(error, final=self.state == OPENING and not absent)
        except DeviceLost as error:
            self._fail(DeviceLost(f"the device {self._request.args!r} {error}"))
        else:
            self._advance(self._link)

    def stop(self) -> None:
        """Stop the device; the session's stream ends after the samples received so far."""
        self.state = STOPPING
        if self._link is not None:
            try:
                if self._attached:
                    self._link.stop()
                self._link.close()
            except BaseException:  # asked again: a driver that hangs must not keep the device
                self._link.discard()
                raise
            self._link = None

    def _advance(self, link):
        if link.opened and not self._attached:
            self._attached = True
            self._on_open(link)
            self._session.attach(link)
            link.start()
        if (silent_s := link.underflow_s - self._underflow_s) > 0:
            self._underflow_s = link.underflow_s
            self._warn_of_underflow(silent_s)
        if not link.started:
            return
        now = self._now()
        if self.state != RUNNING:
            if self.state == RECONNECTING:
                log.info(
                    f"the device {self._request.args!r} is back after {now - self._lost_s:.1f} s; "
                    "readings continue, and are flagged moved until a tare"
                )
            self.state, self._reason, self._running_s = RUNNING, "", now
        elif now - self._running_s > _STEADY_S:
            self._pause_s = _SHORTEST_PAUSE_S

    def _warn_of_underflow(self, silent_s):
        if self._pace.allows("underflow"):
            log.warning(
                f"transmit underflow: no frames were sent for {silent_s:.2f} s, which are missing "
                "in the readings; this machine is too slow or busy"
            )

    def _check_samples(self):
        since_s = self._now() - self._running_s
        if self.state == RUNNING and min(self._session.silent_s, since_s) > _SILENCE_S:
            raise DeviceLost.silent(_SILENCE_S)

    def _fail(self, error, final=False):
        """End the link; raise the error, or try again later."""
        self._link.discard()
        self._link = None
        if final or not self._reconnect:
            raise error
        now = self._now()
        if self.state == RUNNING:
            self._lost_s = now - self._session.silent_s
            self.state = RECONNECTING
        self._next_s = now + self._pause_s
        reason = str(error)
        if reason != self._reason or now - self._reminded_s >= _REMIND_S:
            self._reason, self._reminded_s = reason, now
            log.warning(f"{reason}; waiting for the device")
        else:
            log.debug(f"{reason}; next attempt in {self._pause_s:g} s")
        self._pause_s = min(2 * self._pause_s, _LONGEST_PAUSE_S)


def warn_of_oscillators(link: RadioLink) -> None:
    for direction in link.unlocked:
        log.warning(f"the {direction} oscillator does not lock; readings may drift")
