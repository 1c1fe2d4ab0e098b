#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures the page of a live run on the software N210; docs/live.md states the results.

    build/run python3 tests/command/web/run.py delay --presses 30
    build/run python3 tests/command/web/run.py viewers --viewers 20 --seconds 30

`delay`: from a press to the browser. `viewers`: whether viewers, one of them stalled, change
readings or their delay. Each prints a report, and exits with 1 when its limit is exceeded.
"""

import argparse
import multiprocessing
import random
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "helpers"))

from browser import browser
from live_runs import GAINS, SLOW, ask, connected, free_ports, live, rows_of
from live_runs import scene_file as live_scene
from software_usrp import SoftwareUsrp
from web_pages import RawViewer
from wiforce_app.bench.live import _Messages, _processor_s, delays_s

_GROUP_S = 200 * 400 / 2.5e6
_SHOWN_S = 0.2  # a press is shown within this time (docs/live.md)
_LATER_S = 10e-3  # more than two runs without viewers differ on a busy machine
# Notes when every reading has been painted: after the frame that follows its message.
_NOTE = """
window.painted = [];
const original = window.take;
window.take = (message) => {
  original(message);
  const rows = message.rows ?? [];
  if (rows.length) requestAnimationFrame(() => setTimeout(() => {
    for (const row of rows) painted.push([row[1], row[2], Date.now() / 1000]);
  }));
};"""


class Page:
    """A live reader with its page, on a device of its own."""

    def __init__(self, stack, folder, presses=(), web=True, seconds=None):
        # Commands can press a sensor at any time; a scene that is long enough has only its own.
        scene = live_scene(folder, list(presses), 400, 0.5, **SLOW)
        self.device = stack.enter_context(SoftwareUsrp(scene))
        self.zmq, self.control, port = free_ports(3)
        self.output = folder / "readings.csv"
        options = ["--zmq", self.zmq, "--control", self.control, "-o", self.output]
        options += ["--web", port] if web else []
        # A device that a busy machine stalls for seconds counts as lost.
        options += ["--duration", seconds] if seconds else ["--reconnect"]
        self.process = stack.enter_context(
            live(self.device.args, scene, *GAINS, *options, limit=1e5)
        )
        self.url = f"http://127.0.0.1:{port}/"

    def server_pid(self):
        """Process that serves the page."""
        for child in children(self.process.pid):
            if b"page_process" in Path(f"/proc/{child}/cmdline").read_bytes():
                return child
        raise RuntimeError("there is no process that serves the page")

    def start_s(self):
        """Device time of the first sample."""
        with connected(3, self.control) as client:  # zmq.REQ
            return ask(client, "status")["device_start_s"]


def children(pid):
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return [int(child) for task in tasks for child in (task / "children").read_text().split()]


def quantiles(values_s):
    return ", ".join(
        f"{word} {1e3 * value:.1f}"
        for word, value in zip(
            ("median", "95 %", "largest"), np.quantile(values_s, [0.5, 0.95, 1.0]), strict=True
        )
    )


def measure_delay(arguments):
    """From the command that presses to the painted page, and from the last sample of a group."""
    rng, presses, painted, sent = random.Random(1), [], [], []
    steady = time.time() - time.monotonic()
    with ExitStack() as stack:
        page = Page(stack, Path(stack.enter_context(tempfile.TemporaryDirectory())))
        window = stack.enter_context(browser())
        window.open(page.url)
        window.wait("return page.status.state === 'reading'", 60)
        window.run(_NOTE)
        device_s, begun_s = page.start_s(), time.monotonic()
        messages = stack.enter_context(closing(_Messages(page.zmq)))
        arrived = arrivals(stack, page.url, device_s)
        streamed_s = page.device.command("status")["streaming_s"]
        for _ in range(arguments.presses):
            time.sleep(0.4 + rng.uniform(0, 0.1))
            painted += window.run("return painted.splice(0)")
            pressed_s = time.time()
            page.device.command("press arm 3 40")
            found = "const row = painted.find((row) => row[1] === 1); return row && row[2]"
            presses.append(window.wait(found) - pressed_s)
            time.sleep(0.3)
            page.device.command("release arm")
            window.wait("return painted.length && painted[painted.length - 1][1] === 0")
            painted += window.run("return painted.splice(0)")
            sent += page.device.command("sent")["sent_s"]
        passed_s = page.device.command("status")["streaming_s"] - streamed_s
        speed = passed_s / (time.monotonic() - begun_s)
    readings = [(row[2] - steady, device_s + row[0]) for row in painted]
    print(f"signal per second: {speed:.2f} s; groups of {1e3 * _GROUP_S:.0f} ms")
    print(f"press to painted page, {len(presses)} presses (ms): {quantiles(presses)}")
    for name, found in (
        ("a ZMQ client", messages.readings),
        ("a viewer that does not draw", arrived),
        ("the painted page", readings),
    ):
        delays = delays_s(found, sent, _GROUP_S / 2)
        print(f"last sample of a group to {name}, {len(delays)} (ms): {quantiles(delays)}")
    return np.quantile(presses, 0.95) <= _SHOWN_S


def arrivals(stack, url, device_s):
    """A list that fills with readings as they reach a viewer: when, and their device time."""
    found, viewer = [], stack.enter_context(closing(RawViewer(url)))

    def read():
        viewer.message()  # the history
        try:
            while (message := viewer.message()) is not None:
                now_s = time.monotonic()
                found.extend((now_s, device_s + row[1]) for row in message.get("rows", ()))
        except (OSError, ValueError):
            pass  # closed at the end

    threading.Thread(target=read, daemon=True).start()
    return found


def watch(url, stop, number):
    """Viewers that read, in a process of their own."""

    def read(viewer):
        while not stop.is_set() and viewer.message() is not None:
            pass

    with ExitStack() as stack:
        threads = []
        for _ in range(number):
            viewer = stack.enter_context(closing(RawViewer(url)))
            threads.append(threading.Thread(target=read, args=(viewer,)))
            threads[-1].start()
        for thread in threads:
            thread.join()


def measure_run(viewers, seconds):
    """Readings, delays and processor time of one run: with viewers, the last of which stalls."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        presses = [(2.0 + 2 * n, 2.0, 4.0, 30.0 + n) for n in range(int(seconds / 2) - 1)]
        page = Page(stack, folder, presses, seconds=seconds + 1)
        messages = stack.enter_context(closing(_Messages(page.zmq)))
        stop = multiprocessing.Event()
        if viewers:
            wait_for_page(page.url)
            stalled = stack.enter_context(closing(RawViewer(page.url, receive_buffer=4096)))
            assert stalled.status == 101
            crowd = multiprocessing.Process(target=watch, args=(page.url, stop, viewers - 1))
            crowd.start()
        messages.wait_for(touched=False)
        sent, used, begun = [], [], time.monotonic()
        while page.process.poll() is None and time.monotonic() - begun < 5 * seconds:
            time.sleep(0.5)
            try:
                answer = page.device.command("sent")["sent_s"]
                used.append(_processor_s(page.server_pid()))
            except (RuntimeError, OSError):
                break
            sent += answer
        page.process.wait(20)
        stop.set()
        if viewers:
            crowd.join(20)
        delays = delays_s(messages.readings, sent, _GROUP_S / 2)
        rows = rows_of(page.output)
    for row in rows:
        row.pop("run"), row.pop("time_utc")
    # From the middle on, when everything has been loaded, until before the end.
    first, last = (round(part * len(used)) for part in (0.5, 0.9))
    signal_s = (sent[-1][0] - sent[0][0]) * (last - first) / (len(used) - 1)
    return rows, delays, (used[last] - used[first]) / signal_s


def wait_for_page(url):
    """Until the server answers."""
    end = time.monotonic() + 30
    while True:
        try:
            return RawViewer(url).close()
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.2)


def measure_viewers(arguments):
    """Whether viewers change anything for the reader."""
    without = measure_run(0, arguments.seconds)
    with_viewers = measure_run(arguments.viewers, arguments.seconds)
    for name, (rows, delays, cores) in (("no", without), ("all", with_viewers)):
        print(f"{name} viewers: {len(rows)} readings; delay of {len(delays)} (ms): ", end="")
        print(f"{quantiles(delays)}; processor time of the page: {cores:.3f} cores")
    common = min(len(without[0]), len(with_viewers[0]))
    same = without[0][:common] == with_viewers[0][:common]
    print(f"{common} readings common to both runs are {'equal' if same else 'NOT EQUAL'}")
    later_s = np.median(with_viewers[1]) - np.median(without[1])
    print(f"median delay with {arguments.viewers} viewers: {1e3 * later_s:+.1f} ms")
    return same and common > 20 * arguments.seconds and later_s < _LATER_S


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    delay = commands.add_parser("delay")
    delay.add_argument("--presses", type=int, default=30)
    viewers = commands.add_parser("viewers")
    viewers.add_argument("--viewers", type=int, default=20)
    viewers.add_argument("--seconds", type=float, default=30.0)
    arguments = parser.parse_args()
    measures = {"delay": measure_delay, "viewers": measure_viewers}
    try:
        passed = measures[arguments.command](arguments)
    except subprocess.TimeoutExpired as error:
        sys.exit(f"tests/command/web/run.py: {error}")
    print("passed" if passed else "FAILED")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
