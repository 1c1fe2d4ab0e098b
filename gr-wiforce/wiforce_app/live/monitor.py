# SPDX-License-Identifier: GPL-3.0-or-later
"""Monitors a live session: status line and warnings."""

import math
import sys
import time
from collections import deque
from collections.abc import Callable

import click
from gnuradio.wiforce.io.readings import Reading

from ..read.recordings import RoomNews, describe_events, describe_loss
from ..shell.log import WarningPace, log
from .health import RunHealth
from .session import LiveSession

_LINE_S = 0.5
_WARN_S = 1.0
_SEARCHES = 8  # of 0.12 s each, after which missing frames are reported
_MANY_GAPS = 3  # within a second: more than chance
# What somebody who is about to press must know, by the state of a run.
_UNTOUCHED = "the untouched reference is measured: touch no sensor"
_BEGINS = {
    "acquiring": _UNTOUCHED,  # the reference begins with it
    "reference": _UNTOUCHED,
    "reading": "reading: sensors may be pressed",
}
# Advice for losses of this kind, with the buffer that UHD asks for.
_TOO_SLOW = (
    "this machine or its network is too slow, or its socket buffers are too small: "
    "sysctl -w net.core.rmem_max=50000000"
)


class SessionMonitor:
    """Monitors a session on standard error, where ``line`` allows with a status line."""

    def __init__(
        self,
        session: LiveSession,
        health: RunHealth,
        now: Callable[[], float] = time.monotonic,
        line: bool = True,
    ):
        self._session, self._health, self._now = session, health, now
        self._started_s = self._line_s = self._warn_s = now()
        self._pace = WarningPace(now)
        self._gaps = self._lost = 0
        self._latest_gaps = 0  # when it was looked at last
        self._moved = self._ignored = 0
        self._no_frames_reported = self._recording_reported = False
        self._begun = None
        self._terminal = log.line_in_use = line and sys.stderr.isatty() and not log.journal
        self._last = {}
        self._room = RoomNews()
        # Sentences of the reader, which come from other threads.
        self._said = deque()
        session.reader.groups.on_warning = self._said.append

    def note(self, reading: Reading) -> None:
        """Keep a reading for the status line."""
        self._last[reading.sensor] = reading

    def look(self) -> None:
        """Update the status line, and warn."""
        now = self._now()
        if (begins := _BEGINS.get(self._health.state[0])) is not None and begins != self._begun:
            self._begun = begins
            log.info(begins)
        failure = self._session.recording_failure
        if failure is not None and not self._recording_reported:
            self._recording_reported = True
            log.warning(f"the recording has ended: {failure}; readings continue")
        if now - self._warn_s >= _WARN_S:
            self._warn_s = now
            self._warn()
        if self._terminal and now - self._line_s >= _LINE_S:
            self._line_s = now
            click.echo(f"\r\033[K{self.line()}", err=True, nl=False)

    def finish(self) -> None:
        """End the status line, and warn of what has happened since the last warnings."""
        if self._terminal:
            log.line_in_use = False
            click.echo(err=True)
        self._warn()

    def line(self) -> str:
        """Status in one line: time, rate, gaps, groups, level, clocks, sensors."""
        session = self._session
        elapsed = max(self._now() - self._started_s, 1e-3)
        parts = [
            self._health.state[0],
            f"{session.time_s:.1f} s",
            f"{session.samples / elapsed / 1e6:.2f} Msps",
            f"{session.fold.gaps()} gaps",
            str(session.reader.counts),
            f"peak {20 * math.log10(max(session.take_peak(), 1e-5)):.0f} dBFS",
        ]
        tare = session.reader.stream.tares.state
        if tare.state != "none":
            parts.append(f"tare {tare.state}")
        offsets = list(session.clock_offsets_ppm.values())
        parts += [f"clock {ppm:+.1f} ppm" for ppm in offsets if ppm is not None]
        if not offsets and session.alignment.offset is None:
            parts.append("no frames yet")
        presses = [f"{name}: {last.press(bounds=False)}" for name, last in self._last.items()]
        return ", ".join(parts + presses)

    def status(self) -> dict:
        """State of the session as plain values."""
        session = self._session
        room = session.reader.findings
        return {
            **self._health.report(),
            "device_start_s": session.start_s,
            "frames_moved": session.fold.frames_moved(),
            "times_ignored": session.fold.times_ignored(),
            "frame_offset": session.alignment.offset,
            "clock_offset_ppm": list(session.clock_offsets_ppm.values()),
            "room": None if room is None else [finding.row() for finding in room],
            "readings": {name: reading.row() for name, reading in self._last.items()},
        }

    def summary(self) -> str:
        """What was read and what was lost, in one line."""
        session, fold = self._session, self._session.fold
        text = f"{session.time_s:.3f} s, {session.reader.counts}"
        if gaps := fold.gaps():
            text += f", {describe_loss(gaps, fold.samples_lost())}"
        return ", ".join([text, *describe_events(fold.frames_moved(), fold.times_ignored())])

    def _warn(self):
        session, pace = self._session, self._pace
        # Of a stream that never began, what ended it is said already.
        while self._said and session.time_s:
            sentence = self._said.popleft()
            silent = sentence.partition(": ")[2] in self._health.silences.values()
            if not silent and pace.allows(sentence.partition(" since ")[0]):
                log.warning(sentence)
        self._room.report(session.reader.findings)
        gaps, lost = session.fold.gaps(), session.fold.samples_lost()
        many = gaps - self._latest_gaps >= _MANY_GAPS
        self._latest_gaps = gaps
        if gaps > self._gaps and pace.allows("gaps"):
            loss = describe_loss(gaps - self._gaps, lost - self._lost)
            text = f"{loss} at {session.time_s:.1f} s"
            if many:
                text += f"; {_TOO_SLOW}"
            log.warning(text)
            self._gaps, self._lost = gaps, lost
        moved, ignored = session.fold.frames_moved(), session.fold.times_ignored()
        if (moved, ignored) != (self._moved, self._ignored) and pace.allows("timing"):
            for event in describe_events(moved - self._moved, ignored - self._ignored):
                log.warning(f"at {session.time_s:.1f} s: {event}")
            self._moved, self._ignored = moved, ignored
        search = session.alignment
        missing = search.offset is None and search.searches >= _SEARCHES
        if missing and not self._no_frames_reported:
            self._no_frames_reported = True
            problem = search.problem()
            remedy = "check antennas, --tx-gain and --rx-gain as well"
            log.warning(f"no sounding frames found: {problem}; {remedy}")
