# SPDX-License-Identifier: GPL-3.0-or-later
"""What a running live session has to say: a line on a terminal, warnings, and its end."""

import sys
import time
from pathlib import Path

import click

from .live_session import DeviceLost
from .stream_events import describe_events

_LINE_S = 0.5
_WARN_S = 1.0
_SILENCE_S = 5.0
_NO_FRAMES = 8  # searches without finding frames, of 0.12 s each
_BEHIND = 3  # gaps within a second that mean more than an accident
_BUFFER_LIMIT = Path("/proc/sys/net/core/rmem_max")
_WANTED_BUFFER = 50_000_000  # what UHD asks for


class Watch:
    """Looks after a session from the outside.

    Parameters
    ----------
    session : LiveSession
    args : str
        The device's arguments, for messages.
    quiet : bool
        Neither draw nor warn: only notice when the device is gone.
    now : callable
        Seconds of wall time.
    """

    def __init__(self, session, args, quiet=False, now=time.monotonic):
        self._session, self._args, self._now = session, args, now
        self._started_s = self._line_s = self._warn_s = self._heard_s = now()
        self._heard, self._gaps, self._lost, self._clips = 0, 0, 0, False
        self._moved = self._ignored = 0
        self._no_frames_told = self._recording_told = False
        self._quiet = quiet
        self._terminal = sys.stderr.isatty() and not quiet
        self._last = {}

    def note(self, reading):
        """Keep a reading for the status line, and whether it warns of clipping."""
        self._last[reading.sensor] = reading
        self._clips = self._clips or "saturated" in reading.flags

    def look(self):
        """Draw, warn, and see whether samples still come.

        Raises
        ------
        DeviceLost
        """
        now = self._now()
        if not self._quiet and now - self._warn_s >= _WARN_S:
            self._warn_s = now
            self._warn()
        if self._terminal and now - self._line_s >= _LINE_S:
            self._line_s = now
            click.echo(f"\r\033[K{self.line()}", err=True, nl=False)
        self._listen(now)

    def finish(self):
        """Leave the status line."""
        if self._terminal:
            click.echo(err=True)

    def line(self):
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
        states = session.probe.states
        if states:
            parts += [f"clock {clock.offset_ppm:+.1f} ppm" for clock in states[-1].clocks]
        elif session.alignment.offset is None:
            parts.append("no frames yet")
        return ", ".join(parts + [_short(reading) for reading in self._last.values()])

    def status(self):
        """The same as plain values."""
        session = self._session
        states = session.probe.states
        return {
            "time_s": session.time_s,
            "device_start_s": session.start_s,
            "gaps": session.gaps,
            "samples_lost": session.samples_lost,
            "frames_moved": session.frames_moved,
            "times_ignored": session.times_ignored,
            "groups": session.reader.counts.asdict(),
            "frame_offset": session.alignment.offset,
            "clock_offset_ppm": [c.offset_ppm for c in states[-1].clocks] if states else [],
            "readings": {name: reading.row() for name, reading in self._last.items()},
        }

    def summary(self):
        """What was read and lost, in one line."""
        session = self._session
        text = f"{session.time_s:.3f} s, {session.reader.counts}"
        if session.gaps:
            text += f", {session.gaps} gaps, {session.samples_lost} samples lost"
        return ", ".join([text, *describe_events(session.frames_moved, session.times_ignored)])

    def _warn(self):
        session = self._session
        gaps, lost = session.gaps, session.samples_lost
        if gaps > self._gaps:
            text = f"{gaps - self._gaps} gaps, {lost - self._lost} samples lost"
            if gaps - self._gaps >= _BEHIND:
                text += f": this machine or its network cannot keep up{_buffer_advice()}"
            self._tell(f"{text} (at {session.time_s:.1f} s)")
        self._gaps, self._lost = gaps, lost
        moved, ignored = session.frames_moved, session.times_ignored
        for said in describe_events(moved - self._moved, ignored - self._ignored):
            self._tell(f"{said} (at {session.time_s:.1f} s)")
        self._moved, self._ignored = moved, ignored
        if self._clips:
            self._tell("the receiver clips: lower --rx-gain, --tx-gain or --amplitude")
            self._clips = False
        if session.alignment.searches >= _NO_FRAMES and not self._no_frames_told:
            self._no_frames_told = True
            self._tell("no sounding frames heard: look at antennas, --tx-gain and --rx-gain")
        failure = session.recorder.failure if session.recorder is not None else None
        if failure is not None and not self._recording_told:
            self._recording_told = True
            self._tell(f"not recorded further: {failure}")

    def _tell(self, text):
        start = "\r\033[K" if self._terminal else ""
        click.echo(f"{start}gr-wiforce: warning: {text}", err=True)

    def _listen(self, now):
        heard = self._session.samples_heard
        if heard != self._heard:
            self._heard, self._heard_s = heard, now
        elif now - self._heard_s > _SILENCE_S:
            rule = f"the device {self._args!r} has sent nothing for {_SILENCE_S:g} s"
            raise DeviceLost(f"{rule}; what was read until then is kept")


def _db(amplitude):
    from math import log10

    return 20 * log10(max(amplitude, 1e-5))


def _buffer_advice():
    """What to do about socket buffers that are smaller than UHD wants; empty when they are not."""
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
    place = "" if reading.location_mm is None else f" at {reading.location_mm:.1f} mm"
    return f"{reading.sensor}: {reading.force_n:.2f} N{place}"
