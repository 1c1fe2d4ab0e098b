# SPDX-License-Identifier: GPL-3.0-or-later
"""The world around a live reader: what is played to it, when, and what it must report then."""

import bisect
import json
import math
import threading
import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np
import zmq
from device import PACKET, PlayedLink, wait_for
from loops import FRAME, RATE_HZ, SLOT

STILL, OFF, LOST = 0, -1, -2  # loops that are none: no tag, no samples
# Signal that may wait in the reader.
MOST_BEHIND_S = 2.0
# Of this age are states that a heartbeat may still show.
STATE_AGE_S = MOST_BEHIND_S + 1.0
_LATEST = 12  # events and tags that a problem is reported with


class RunEnded(Exception):
    """The live reader takes no samples any more."""


@dataclass
class Run:
    """What was played in one run of the reader, on its grid of samples.

    ``starts``, ``loops``, ``positions``: first sample of each stretch, its loop, and where in the
    loop it begins; ``total``: samples so far, lost ones included; ``received``: samples sent so
    far; ``slips``: where samples were lost without a trace; ``gaps``: times that they were lost,
    and the device said so; ``utc``: sample and difference of UTC and the run's time from there on,
    in s; ``full``: whether the disk was full.
    """

    begun_s: float
    starts: list = field(default_factory=list)
    loops: list = field(default_factory=list)
    positions: list = field(default_factory=list)
    total: int = 0
    received: int = 0
    slips: list = field(default_factory=list)
    gaps: int = 0
    utc: list = field(default_factory=list)
    status: int | None = None
    full: bool = False

    def note(self, loop, position):
        """Another stretch begins, unless it continues the last one."""
        if self.loops and self.loops[-1] == loop:
            expected = self.positions[-1] + self.total - self.starts[-1]
            if loop in (OFF, LOST) or expected == position:
                return
        self.starts.append(self.total)
        self.loops.append(loop)
        self.positions.append(position)


class World:
    """Plays signal to the reader and notes what follows from it.

    ``ports``: of ``--zmq`` and ``--control``; ``group``: samples of a phase group. ``problems``:
    where the reader was wrong; ``retuned``: the device was opened again, without a tare since.
    """

    def __init__(self, loops, device, clock, ports, group):
        self.loops, self.device, self.clock = loops, device, clock
        self.group, self._ports = group, ports
        self.position, self.runs, self.problems = 0, {}, []
        self.run = self.health = self.session = None
        self.retuned = False
        self.ended = threading.Event()
        self._silence = np.tile(loops.silence, (PACKET // FRAME + 2, 1))
        self._allowed = [(clock.now_s, frozenset(["waiting"]))]
        self._context = zmq.Context()
        self.beats, self.checks = 0, 0
        self._latest = deque(maxlen=_LATEST)

    # What the main thread calls

    def take_health(self, health):
        """A run has begun."""
        self.ended.clear()
        self.retuned = False
        self.run = self.runs[health.run] = Run(self.clock.now_s)
        self.health, self.session = health, health._session
        self.allow("waiting")

    def link(self, request):
        """What stands in for a RadioLink."""
        return PlayedLink(self.device)

    def take_end(self, status):
        """A run has ended."""
        self.run.status = status
        self.allow("ended")
        self.ended.set()

    # Playing

    def play(self, seconds, loop=STILL):
        """Play a loop from the present position on.

        Raises RunEnded when nobody takes samples any more.
        """
        remaining = round(seconds * RATE_HZ)
        while remaining > 0:
            count = min(PACKET, remaining, self.loops.length - self.position)
            self._send(self._codes(loop, count), loop)
            remaining -= count
            self._keep_up()

    def play_slot(self, loop=STILL):
        """Play what is left of a slot."""
        self.play((SLOT - self.position % SLOT) / RATE_HZ, loop)

    def go_on_anywhere(self, rng):
        """Continue at another slot, in the same frames: the tag's clock has another phase there."""
        slot = int(rng.integers(self.loops.length // SLOT))
        self.position = slot * SLOT + self.position % FRAME

    def lose(self, samples, slips=False):
        """Lose samples on the way; the device says so, unless the frame timing just slips."""
        self.clock.now_s += samples / RATE_HZ
        self.miss(samples, slips)

    def miss(self, samples, slips=False):
        """Lose the samples of a time that has passed already."""
        if not slips:
            self.run.note(LOST, 0)
            self.run.gaps += 1
            self.device.tag_next()
        else:
            self.run.slips.append(self.run.total)
        self.run.total += samples
        self.position = (self.position + samples) % self.loops.length

    def wait(self, seconds):
        """Let time pass without samples, in steps that the reader can notice."""
        end_s = self.clock.now_s + seconds
        while (remaining_s := end_s - self.clock.now_s) > 1e-9:
            passed_s = seconds - remaining_s
            self.clock.now_s += min(remaining_s, 0.1 if passed_s < 12 else passed_s / 50)
            time.sleep(0.04)
            self._check_ended()

    def begin_stream(self):
        """Wait until the reader has opened the device, and send it the first samples."""
        while self.device.link is None or not self.device.link.streams:
            self.clock.now_s += 0.05
            time.sleep(3e-3)
            self._check_ended()
        run, link, first = self.run, self.device.link, self.run.received == 0
        self.position -= self.position % FRAME  # both directions start together
        received = self.session.source.received
        count = 20 * FRAME
        if not first:
            self.run.note(LOST, 0)
            run.gaps += 1
            gone = run.total + (self.clock.now_s + count / RATE_HZ - self._lost_at_s) * RATE_HZ
            run.total = math.ceil(gone / FRAME) * FRAME
            self.retuned = True
        run.utc.append((run.total, self._utc_of_run()))
        self.allow("waiting", "lost", "acquiring", "reference", "reading")
        self._send(self._codes(STILL, count), STILL)
        link.started = True
        if not wait_for(lambda: self.session.source.received > received):
            self._check_ended()
            raise RuntimeError("no samples are taken")

    def leave(self):
        """The device is gone; note the time of its last sample."""
        self.settle()
        self._lost_at_s = self.clock.now_s

    def note_utc(self):
        """The host's clock was set."""
        self.run.utc.append((self.run.total, self._utc_of_run()))

    def _utc_of_run(self):
        return self.clock.time() - self.run.total / RATE_HZ

    def _codes(self, loop, count):
        if loop == OFF:
            first = self.position % FRAME
            return self._silence[first : first + count]
        return self.loops.loops[loop].codes[self.position : self.position + count]

    def _send(self, codes, loop):
        self.run.note(loop, self.position)
        if self.device.tags_next:
            self.note(f"rx_time with sample {self.run.total}")
        if not self.device.send(codes):
            self._check_ended(must=True)
        self.run.total += len(codes)
        self.run.received += len(codes)
        self.position = (self.position + len(codes)) % self.loops.length

    def send_part(self, samples, loop=STILL):
        """Send a part of a packet, after which the device is lost."""
        codes = self._codes(loop, samples)
        self.run.note(loop, self.position)
        self.device.send_part(codes)
        self.run.total += samples
        self.run.received += samples

    def _check_ended(self, must=False):
        if must:
            self.ended.wait(60)
        if self.ended.is_set():
            raise RunEnded

    # Where the reader is

    @property
    def _behind(self):
        fold, groups = self.session.reader.fold, self.session.reader.groups
        waiting = fold.nitems_written(0) - groups.nitems_read(0)
        return self.run.received - fold.nitems_read(0) + waiting * self.group

    def _keep_up(self):
        most = MOST_BEHIND_S * RATE_HZ + (
            0 if self.session.alignment.offset is not None else 2000 * FRAME
        )
        if not wait_for(lambda: self._behind < most or self.ended.is_set()):
            raise RuntimeError(f"the reader stays {self._behind / RATE_HZ:.1f} s behind")
        self._check_ended()

    def settle(self):
        """Wait until the reader has taken all that was sent."""
        for _ in range(30_000):
            self._check_ended()
            if self._is_settled():
                return
            time.sleep(2e-3)
        raise RuntimeError("the reader does not take what was sent")

    def _is_settled(self):
        session, received = self.session, self.run.received
        fold, groups = session.reader.fold, session.reader.groups
        aligned = session.source.nitems_written(0)
        offset = session.alignment.offset
        return (
            session.source.received == received
            and (offset is None or aligned == received - offset)
            and aligned - fold.nitems_read(0) < FRAME
            and groups.nitems_read(0) == fold.nitems_written(0)
        )

    # What must be reported

    def allow(self, *states):
        """From now on the reader may report these states, and those before for a moment."""
        self._allowed.append((self.clock.now_s, frozenset(states)))

    def expect(self, state, reason="", **more):
        """Settle, and compare the report with what follows from the events."""
        self.settle()
        report = self.health.report()
        self.allow(state)
        self.checks += 1
        said = {
            "tare": report["tare"]["state"],
            "reference_problem": report["sensors"]["arm"]["reference_problem"],
        }
        right = report["state"] == state and reason in report["reason"]
        for key, wanted in more.items():
            right &= bool(said[key]) if wanted is True else said[key] == wanted
        if not right:
            got = f"{report['state']} ({report['reason']}), {said}"
            self.report(f"reports {got} instead of {state} ({reason}), {more}")
        lasted_s = abs(report["time_s"] - self.run.total / RATE_HZ)
        if lasted_s > 2 * FRAME * (2 + len(self.run.slips)) / RATE_HZ + 0.01:
            self.report(f"time_s {report['time_s']} instead of {self.run.total / RATE_HZ}")

    def take_beat(self, beat):
        """Compare the state of a heartbeat with those that are possible."""
        self.beats += 1
        now_s = self.clock.now_s
        allowed, moments = list(self._allowed), [at for at, _ in self._allowed]
        first = max(bisect.bisect_right(moments, now_s - STATE_AGE_S) - 1, 0)
        possible = frozenset().union(*(states for _, states in allowed[first:]))
        if beat["state"] not in possible:
            self.report(f"heartbeat says {beat['state']} instead of {sorted(possible)}")

    def report(self, text):
        """Note that the reader was wrong."""
        at_s = self.run.total / RATE_HZ
        run = len(self.runs)
        self.problems.append(f"run {run} at {at_s:.3f} s: {text}")
        print("PROBLEM", self.problems[-1], flush=True)
        print("  after", *self._latest, sep="\n    ", flush=True)

    def note(self, text):
        """Something happens; the latest few are printed with a problem."""
        total = 0 if self.run is None else self.run.total
        self._latest.append(f"{total / RATE_HZ:.6f} s, device {self.device.time_s:.6f} s: {text}")

    # Requests

    def ask(self, word):
        """Send a request to the reader; a Request, whose answer may come later."""
        return Request(self._context, self._ports[1], word)

    def tare(self, force=False):
        """Request a tare, and wait until the reader has taken the request."""
        self.settle()
        self.allow(*self._allowed[-1][1], "reference")
        before = self.session.reader.stream.tares.state
        request = self.ask("tare force" if force else "tare")
        tares = self.session.reader.stream.tares
        wait_for(lambda: tares.state is not before or self.ended.is_set(), 10)
        self._check_ended()
        return request

    def close(self):
        """Give the sockets back."""
        self._context.destroy(linger=0)


class Request:
    """A request and its answer."""

    def __init__(self, context, port, word):
        self._socket = context.socket(zmq.REQ)
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.connect(f"tcp://127.0.0.1:{port}")
        self._socket.send_string(word)

    def answer(self, limit_s=20):
        """The answer as a dict; an empty one when there is none in time."""
        with self._socket as asked:
            return json.loads(asked.recv_string()) if asked.poll(1000 * limit_s) else {}
