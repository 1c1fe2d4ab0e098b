#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""A day of a live reader, as fast as it can: what must not happen in it, and does not.

    build/run python3 tests/soak/run.py --hours 24 --losses 50
    build/run python3 tests/soak/run.py --short

Runs `gr-wiforce live` with a device that plays simulated samples at 1.25 Msps, in a time that
passes as they are played. Only UHD and its process are replaced; docs/live.md says what is
checked. Prints a report, and exits with 1 when something was wrong.
"""

import argparse
import faulthandler
import json
import os
import resource
import socket
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from pathlib import Path

import numpy as np
import zmq
from device import Device, PlayedTime
from events import SHORT, Events, schedule
from judge import Judge
from loops import FRAME, RATE_HZ, SLOT_S, Loops, Noise, scene_of
from wiforce_app.main import main as command
from world import RunEnded, World

_REPORT_SLOTS = 700  # half an hour of signal


class Soak:
    """A soak test: the reader in the main thread, the world around it in another."""

    def __init__(self, options, folder):
        self._options, self._folder = options, Path(folder)
        self._output = self._folder / "readings.csv"
        self._rng = np.random.default_rng(options.seed)
        begun_s = time.monotonic()
        slots = 4 if options.short else 16
        loops = Loops(options.loops, slots, self._rng)
        print(f"made {options.loops + 1} loops in {time.monotonic() - begun_s:.1f} s", flush=True)
        self._scene = self._folder / "scene.yaml"
        self._scene.write_text(json.dumps(scene_of(snapshots=options.snapshots)))
        self._clock = PlayedTime()
        device = Device(self._clock, Noise(loops.noise_codes, self._rng), self._rng)
        self._ports = _free_ports()
        group = options.snapshots * FRAME
        self.world = World(loops, device, self._clock, self._ports, group)
        breaks_s = (1.0, 2.0) if options.short else (3.0, 90.0)
        self.events = Events(self.world, self._output, self._rng, breaks_s)
        self.judge = Judge(self._output, self.world)
        self.held, self.happened = [], Counter()
        self._finished, self._starting = threading.Event(), threading.Event()
        self._running = threading.Event()
        self._clock.install(self.world.link, self._take_health)
        self.signal_s = self.wall_s = 0.0

    def run(self):
        """Run all of it; whether nothing was wrong."""
        begun_s = time.monotonic()
        player = threading.Thread(target=self._play, name="player", daemon=True)
        beats = threading.Thread(target=self._listen, name="beats", daemon=True)
        beats.start()
        player.start()
        arguments = ["live", "--scene", str(self._scene), "--args", "played", "--reconnect"]
        arguments += ["-o", str(self._output), "--append", "--rotate", "1h", "--rotate", "20MB"]
        arguments += ["--zmq", str(self._ports[0]), "--control", str(self._ports[1])]
        while not self._finished.is_set():
            status = command(arguments)
            self.world.take_end(status)
            self._starting.wait(120)
            self._starting.clear()
        player.join()
        self.signal_s = sum(run.received for run in self.world.runs.values()) / RATE_HZ
        self.judge.read_all()
        self.wall_s = time.monotonic() - begun_s
        return self._report()

    def _take_health(self, health):
        self.world.take_health(health)
        self._running.set()

    def _play(self):
        try:
            self._start()
            if self._options.short:
                for name in SHORT:
                    self._happen(name)
            else:
                self._play_for_hours()
            self._happen("stopped", restart=False)
        except BaseException:
            # The main thread may wait for samples for ever.
            traceback.print_exc()
            os._exit(3)
        finally:
            self._finished.set()
            self._starting.set()

    def _play_for_hours(self):
        options = self._options
        due = schedule(options.hours, options.losses, options.restarts, self._rng)
        slots = round(options.hours * 3600 / SLOT_S)
        done = 0
        while self._played_s() < options.hours * 3600 or done <= max(due):
            for name in due.get(done, []):
                self._happen(name)
            self.events.ordinary()
            done += 1
            if done % _REPORT_SLOTS == 0:
                self._look(done, slots)

    def _played_s(self):
        return sum(run.received for run in self.world.runs.values()) / RATE_HZ

    def _start(self):
        self._running.wait(60)
        self._running.clear()
        self.events.started()

    def _happen(self, name, restart=True):
        self.happened[name] += 1
        self.world.note(name)
        try:
            getattr(self.events, name)()
        except RunEnded:
            self.world.report(f"the run has ended in {name} with status {self.world.run.status}")
        if restart and self.world.ended.is_set():
            self._starting.set()
            self._start()

    def _listen(self):
        """Take heartbeats as another process would."""
        with zmq.Context() as context, context.socket(zmq.SUB) as subscriber:
            subscriber.connect(f"tcp://127.0.0.1:{self._ports[0]}")
            subscriber.subscribe('{"message": "heartbeat"')
            while not self._finished.is_set():
                if subscriber.poll(100):
                    self.world.take_beat(json.loads(subscriber.recv_string()))

    def _look(self, done, slots):
        self.judge.read_renamed()
        held = _held()
        self.held.append(held)
        print(
            f"{self._played_s() / 3600:.2f} h of signal, slot {done} of {slots}, "
            f"{sum(self.happened.values())} events, {self.world.beats} heartbeats, "
            f"{held[0] / 1e6:.0f} MB, {held[1]} descriptors, {held[2]} threads, "
            f"{len(self.world.problems) + len(self.judge.problems)} problems",
            flush=True,
        )

    def _report(self):
        world, judge = self.world, self.judge
        problems = world.problems + judge.problems
        print(f"signal: {self.signal_s / 3600:.3f} h in {self.wall_s:.0f} s", end=", ")
        print(f"{self.signal_s / self.wall_s:.1f} times as fast as it comes")
        print(f"runs: {len(world.runs)}, device lost and found {self.events.losses} times")
        print(f"events: {dict(self.happened)}")
        print(f"readings: {dict(judge.counts)}")
        print(f"flags: {dict(judge.flags.most_common(12))}")
        print(f"states: {world.checks} checks, {world.beats} heartbeats")
        if len(self.held) > 2:
            first, last = self.held[1], self.held[-1]
            print(f"memory: {first[0] / 1e6:.0f} to {last[0] / 1e6:.0f} MB", end=", ")
            print(f"descriptors {first[1]} to {last[1]}, threads {first[2]} to {last[2]}")
        for problem in problems[:50]:
            print(f"problem: {problem}")
        print(f"{len(problems)} problems")
        world.close()
        return not problems


def _held():
    """Memory in bytes, descriptors and threads of this process."""
    with open("/proc/self/statm") as file:
        pages = int(file.read().split()[1])
    descriptors, threads = len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))
    return pages * resource.getpagesize(), descriptors, threads


def _free_ports():
    with (
        socket.create_server(("127.0.0.1", 0)) as one,
        socket.create_server(("127.0.0.1", 0)) as other,
    ):
        return one.getsockname()[1], other.getsockname()[1]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=24.0, help="of signal")
    parser.add_argument("--losses", type=int, default=50, help="of the device")
    parser.add_argument("--restarts", type=int, default=6, help="by a full disk")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--loops", type=int, default=3, help="of presses that are simulated")
    parser.add_argument("--snapshots", type=int, default=125, help="of a phase group")
    parser.add_argument("--short", action="store_true", help="a minute, with few events")
    options = parser.parse_args()
    faulthandler.enable()
    with tempfile.TemporaryDirectory() as folder:
        return 0 if Soak(options, folder).run() else 1


if __name__ == "__main__":
    sys.exit(main())
