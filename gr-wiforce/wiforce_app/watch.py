# SPDX-License-Identifier: GPL-3.0-or-later
"""Monitors a live session: status line, warnings, and the end when the device is gone."""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import click
from gnuradio.wiforce.estimation.frame import describe_frames
from gnuradio.wiforce.io.readings import Reading

from .live_session import DeviceLost, LiveSession
from .room_report import RoomNews, finding_rows
from .stream_events import describe_events, describe_loss

_LINE_S = 0.5
_WARN_S = 1.0
_SILENCE_S = 5.0
_SEARCHES = 8  # of 0.12 s each, after which missing frames are reported
_MANY_GAPS = 3  # within a second: more than chance
_BUFFER_LIMIT = Path("/proc/sys/net/core/rmem_max")
_WANTED_BUFFER = 50_000_000  # what UHD asks for


class Watch:
    """Monitors a session and reports to standard error.

    Parameters
    ----------
    session : LiveSession
    args : str
        The device's arguments, for messages.
    quiet : bool
        Print neither status line nor warnings; only detect that the device is gone.
    now : callable
        Returns wall time in seconds.

    Attributes
    ----------
    health : RunHealth or None
        Of the run, for status line and status.
    """

    def __init__(
        self,
        session: LiveSession,
        args: str,
        quiet: bool = False,
        now: Callable[[], float] = time.monotonic,
    ):
        self._session, self._args, self._now = session, args, now
        self._started_s = self._line_s = self._warn_s = self._heard_s = now()
        self._heard, self._gaps, self._lost, self._saturated = 0, 0, 0, False
        self._moved = self._ignored = 0
        self._no_frames_reported = self._recording_reported = False
        self._quiet = quiet
        self._terminal = sys.stderr.isatty() and not quiet
        self._last = {}
        self._room = RoomNews()
        self.health = None

    def note(self, reading: Reading) -> None:
        """Keep a reading for the status line, and whether it is saturated."""
        self._last[reading.sensor] = reading
        self._saturated = self._saturated or "saturated" in reading.flags

    def look(self) -> None:
        """Update the status line, warn, and check that samples still arrive.

        Raises
        ------
        DeviceLost
            When none has arrived for five seconds.
        """
        now = self._now()
        if not self._quiet and now - self._warn_s >= _WARN_S:
            self._warn_s = now
            self._warn()
        if self._terminal and now - self._line_s >= _LINE_S:
            self._line_s = now
            click.echo(f"\r\033[K{self.line()}", err=True, nl=False)
        self._check_samples(now)

    def finish(self) -> None:
        """End the status line."""
        if self._terminal:
            click.echo(err=True)

    def line(self) -> str:
        """Status in one line: time, rate, gaps, groups, level, clocks, sensors."""
        session = self._session
        elapsed = max(self._now() - self._started_s, 1e-3)
        parts = [
            f"{session.time_s:.1f} s",
            f"{session.samples / elapsed / 1e6:.2f} Msps",
            f"{session.gaps} gaps",
            session.reader.counts.short(),
            f"peak {_db(session.take_peak()):.0f} dBFS",
        ]
        if self.health is not None:
            parts.insert(0, self.health.state[0])
            tare = session.reader.stream.tares.state
            if tare.state != "none":
                parts.append(f"tare {tare.state}")
        offsets = _clock_offsets(session)
        parts += [f"clock {ppm:+.1f} ppm" for ppm in offsets]
        if not offsets and session.alignment.offset is None:
            parts.append("no frames yet")
        return ", ".join(parts + [_short(reading) for reading in self._last.values()])

    def status(self) -> dict:
        """State of the session as plain values."""
        session = self._session
        room = session.reader.findings
        return {
            **({} if self.health is None else self.health.report()),
            "time_s": session.time_s,
            "device_start_s": session.start_s,
            "gaps": session.gaps,
            "samples_lost": session.samples_lost,
            "frames_moved": session.frames_moved,
            "times_ignored": session.times_ignored,
            "groups": session.reader.counts.asdict(),
            "frame_offset": session.alignment.offset,
            "clock_offset_ppm": _clock_offsets(session),
            "room": None if room is None else finding_rows(room),
            "readings": {name: reading.row() for name, reading in self._last.items()},
        }

    def summary(self) -> str:
        """What was read and what was lost, in one line."""
        session = self._session
        text = f"{session.time_s:.3f} s, {session.reader.counts}"
        if session.gaps:
            text += f", {describe_loss(session.gaps, session.samples_lost)}"
        return ", ".join([text, *describe_events(session.frames_moved, session.times_ignored)])

    def _warn(self):
        session = self._session
        self._room.report(session.reader.findings)
        gaps, lost = session.gaps, session.samples_lost
        if gaps > self._gaps:
            text = (
                f"{describe_loss(gaps - self._gaps, lost - self._lost)} at {session.time_s:.1f} s"
            )
            if gaps - self._gaps >= _MANY_GAPS:
                text += f"; this machine or its network is too slow{_buffer_advice()}"
            self._warn_of(text)
        self._gaps, self._lost = gaps, lost
        moved, ignored = session.frames_moved, session.times_ignored
        for event in describe_events(moved - self._moved, ignored - self._ignored):
            self._warn_of(f"at {session.time_s:.1f} s: {event}")
        self._moved, self._ignored = moved, ignored
        if self._saturated:
            self._warn_of("the receiver is saturated; lower --rx-gain, --tx-gain or --amplitude")
            self._saturated = False
        if session.alignment.searches >= _SEARCHES and not self._no_frames_reported:
            self._no_frames_reported = True
            frames = describe_frames(session.waveform)
            self._warn_of(
                f"no sounding frames found ({frames}); check antennas, --tx-gain and --rx-gain"
            )
        failure = session.recorder.failure if session.recorder is not None else None
        if failure is not None and not self._recording_reported:
            self._recording_reported = True
            self._warn_of(f"the recording has ended: {failure}; readings continue")

    def log(self, text: str) -> None:
        """Print a line above the status line."""
        start = "\r\033[K" if self._terminal else ""
        click.echo(f"{start}gr-wiforce: {text}", err=True)

    def _warn_of(self, text):
        self.log(f"warning: {text}")

    def _check_samples(self, now):
        heard = self._session.samples_received
        if heard != self._heard:
            self._heard, self._heard_s = heard, now
        elif now - self._heard_s > _SILENCE_S:
            event = f"the device {self._args!r} has sent no samples for {_SILENCE_S:g} s"
            raise DeviceLost(f"{event}; all readings until then are kept")


def _db(amplitude):
    from math import log10

    return 20 * log10(max(amplitude, 1e-5))


def _buffer_advice():
    """Advice on socket buffers that are smaller than UHD asks for; empty when they are not."""
    try:
        limit = int(_BUFFER_LIMIT.read_text())
    except (OSError, ValueError):
        return ""
    if limit >= _WANTED_BUFFER:
        return ""
    return f"; larger socket buffers may help: sysctl -w net.core.rmem_max={_WANTED_BUFFER}"


def _short(reading):
    if reading.touch is None:
        return f"{reading.sensor}: ?"
    if not reading.touch:
        return f"{reading.sensor}: no touch"
    if reading.force_n is None:
        return f"{reading.sensor}: touched"
    location = "" if reading.location_mm is None else f" at {reading.location_mm:.1f} mm"
    return f"{reading.sensor}: {reading.force_n:.2f} N{location}"


def _clock_offsets(session) -> list[float]:
    """Offset of every tag's clock in the latest group, in ppm."""
    groups = session.latest
    return groups.clock_offset_ppm[-1].tolist() if len(groups) else []
