# SPDX-License-Identifier: GPL-3.0-or-later
"""What is known of a run: state, clock and age of its readings, for heartbeats and systemd."""

import os
import socket
import threading
import time
from collections.abc import Callable, MutableMapping
from dataclasses import dataclass

from gnuradio.wiforce.io.readings import Reading, written_utc
from gnuradio.wiforce.press.sensor_state import PATIENCE_S, describe_silence

from ..shell.log import WarningPace, log
from .radio_keeper import OPENING, RECONNECTING, RUNNING, STOPPING, RadioKeeper
from .session import LiveSession

# Without samples for this long the device counts as lost; it sends packets every millisecond.
_NO_SAMPLES_S = 1.0
_BEAT_S = 0.5
_LOOK_S = 0.05
_WITHOUT_DEVICE = {
    OPENING: ("waiting", "the device is not open yet"),
    RECONNECTING: ("lost", "the device is lost, and sought again"),
    STOPPING: ("ending", ""),
}
_DROPPED = ("gap",)  # flags of a group that was not received
# Signal by which a tare may take longer than its reference, for groups in processing.
_TARE_MARGIN_S = 2.0
# Of an output that takes no readings, or a block that does not return.
_STUCK_S = 10.0


def geometry(skin):
    """Where the strips of a surface are, as plain values."""
    strips = [
        {
            "sensor": strip.sensor,
            "y_mm": strip.y_mm,
            "x_mm": sorted([strip.x_mm, float(strip.x_of(strip.model.length_mm))]),
        }
        for strip in skin.strips
    ]
    return {"name": skin.name, "strips": strips, "y_span_mm": list(skin.y_span_mm)}


@dataclass
class _Tag:
    """When a sensor's readings held values."""

    length_mm: float
    arrived_s: float | None = None
    received_s: float | None = None
    first_s: float | None = None
    noted_s: float = 0.0
    lost_s: float = 0.0  # of groups that were not received since the tag was
    silent: bool = False


class RunHealth:
    """Observes a session of a ``run``; ``log`` takes a line for the user."""

    def __init__(
        self,
        run: str,
        session: LiveSession,
        log: Callable[[str], None],
        device_state: Callable[[], str] = lambda: RUNNING,
        now: Callable[[], float] = time.monotonic,
    ):
        self.run = run
        self._session, self._log, self._now = session, log, now
        self._device_state = device_state
        self._tags = {each.name: _Tag(each.model.length_mm) for each in self._stream.plan.sensors}
        # Offset of UTC from the device's clock by the latest comparison, and its uncertainty, in s.
        self._compared: tuple[float, float] | None = None
        self._events: dict[str, str] = {}  # silence or return, the latest of each sensor
        self._pace = WarningPace(now)
        self.silences: dict[str, str] = {}  # what was said last of tags that were not received
        self._suspected = set()

    def note(self, reading: Reading) -> None:
        """Take a reading, in the thread that made it."""
        tag = self._tags.get(reading.sensor)
        if tag is None:
            return  # a surface, whose strips have tags
        if tag.first_s is None:
            tag.first_s = tag.noted_s = reading.time_s
        passed_s, tag.noted_s = reading.time_s - tag.noted_s, reading.time_s
        if reading.touch is not None:
            if tag.silent:
                self._events[reading.sensor] = self._returns(reading, tag)
            tag.silent, tag.received_s, tag.arrived_s = False, reading.time_s, self._now()
            tag.lost_s = 0.0
            return
        if "moved" in reading.flags and self._stream.reference_problem(reading.sensor):
            return
        # Groups that were not received, as those of a lost device, say nothing about the tag. After
        # an hour of them there are no rows.
        if reading.flags == _DROPPED or passed_s > PATIENCE_S:
            tag.lost_s += passed_s
        since_s = tag.first_s if tag.received_s is None else tag.received_s
        if not tag.silent and reading.time_s - since_s - tag.lost_s > PATIENCE_S:
            tag.silent = True
            self.silences[reading.sensor] = describe_silence(reading.sensor, since_s)
            self._events[reading.sensor] = self.silences[reading.sensor]

    def _returns(self, reading, tag):
        name, problem = reading.sensor, self._stream.reference_problem(reading.sensor)
        if tag.received_s is None:
            text = f"{name} is received from {reading.time_s:.2f} s on, after its reference time"
            return f"{text}; readings are flagged inconsistent until a tare"
        silent_s = reading.time_s - tag.received_s
        text = f"{name} is received again at {reading.time_s:.2f} s, after {silent_s:.1f} s"
        if problem:
            return f"{text}; {problem}: readings are flagged until a tare"
        return f"{text}; readings continue from the former reference"

    def look(self) -> None:
        """Log what has happened, and give up a tare that cannot be completed."""
        for name in list(self._events):
            if self._pace.allows(name):
                self._log(self._events.pop(name))
        for name, found in self._stream.suspicions().items():
            for kind, text in found:
                if (name, kind) not in self._suspected:
                    self._suspected.add((name, kind))
                    self._log(f"{name}: {text}")
        silent_s = self._session.source.idle_s
        tares = self._stream.tares
        if tares.measuring:
            reference_s = self._stream.plan.reference_groups * self._stream.plan.group_period_s
            late_s = self._session.time_s - (tares.state.time_s or 0.0) - reference_s
            if silent_s > _NO_SAMPLES_S or late_s > _TARE_MARGIN_S:
                reason = "no groups are received; the former reference is kept"
                self._session.reader.cancel_tare(reason)

    @property
    def state(self) -> tuple[str, str]:
        """State of the reader, as in docs/live.md, and the reason where it is not reading."""
        session, silent_s = self._session, self._session.source.idle_s
        if (without := _WITHOUT_DEVICE.get(self._device_state())) is not None:
            return without
        if session.alignment.offset is None:
            reason = "no samples" if silent_s > _NO_SAMPLES_S else "no sounding frames yet"
            return "waiting", reason
        if silent_s > _NO_SAMPLES_S:
            return "lost", f"no samples for {silent_s:.1f} s"
        state = self._stream.state
        if state != "reading":
            return state, ""
        silent = [name for name, tag in self._tags.items() if tag.silent]
        if len(silent) == len(self._tags):
            return "lost", f"not received: {', '.join(silent)}"
        return "reading", f"not received: {', '.join(silent)}" if silent else ""

    def report(self) -> dict:
        """Health as plain values."""
        session, now, compared = self._session, self._now(), self._follow_clock()
        state, reason = self.state
        clocks_ppm = session.clock_offsets_ppm
        sensors = {
            name: {
                "age_s": None if tag.arrived_s is None else round(now - tag.arrived_s, 3),
                "received": tag.arrived_s is not None and not tag.silent,
                "reference_problem": self._stream.reference_problem(name),
                "clock_offset_ppm": clocks_ppm.get(name),
                "length_mm": tag.length_mm,
            }
            for name, tag in self._tags.items()
        }
        skin = self._stream.plan.skin
        surface = {} if skin is None else {"surface": geometry(skin)}
        return {
            **surface,
            "run": self.run,
            "scene": "" if (path := self._stream.plan.require_scene().path) is None else path.stem,
            "time_utc": written_utc(time.time()),
            "time_utc_uncertainty_s": None if compared is None else compared[1],
            "time_s": session.time_s,
            "state": state,
            "reason": reason,
            "tare": self._stream.tares.state.row(),
            "sensors": sensors,
            "gaps": session.fold.gaps(),
            "samples_lost": session.fold.samples_lost(),
            "groups": session.reader.counts.asdict(),
        }

    def stamp(self, reading: Reading) -> dict:
        """What a reading carries besides its own columns: run, and times of its group's centre."""
        start_s, compared = self._session.start_s, self._follow_clock()
        device_s = None if start_s is None else round(start_s + reading.time_s, 6)
        utc_s = None if device_s is None or compared is None else device_s + compared[0]
        return {"run": self.run, "time_utc": written_utc(utc_s), "device_time_s": device_s}

    def _follow_clock(self):
        """The latest comparison of the clocks, which is kept while the device is lost."""
        self._compared = self._session.clock or self._compared
        return self._compared

    @property
    def _stream(self):
        return self._session.reader.stream


class Heartbeat:
    """Sends a report every half second and when the state changes, in a thread of its own."""

    def __init__(self, report: Callable[[], dict], send: Callable[[dict], None]):
        self._report, self._send = report, send
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()

    def _run(self):
        sent_s, state = -_BEAT_S, None
        while True:
            now_s, report = time.monotonic(), self._report()
            if report["state"] != state or now_s - sent_s >= _BEAT_S:
                sent_s, state = now_s, report["state"]
                self._send(report)
            if self._ended.wait(_LOOK_S):
                return


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
        self._alive_s, self._ready, self._stuck = 0.0, False, False
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.setblocking(False)

    def look(self) -> None:
        """Tell what is due, and that the reader works unless samples are not taken from it."""
        now = self._now()
        if not self._ready and (self._keeper.state != OPENING or self._keeper.waits):
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

    def stopping(self) -> None:
        self._send("STOPPING=1")

    def close(self) -> None:
        self._socket.close()

    def _send(self, text):
        """Whether systemd has it; a queue that is full is tried again by the next call."""
        try:
            if self._address:
                self._socket.sendto(text.encode(), self._address)
        except OSError:
            return False
        return True
