# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench live``: delay of readings behind the samples, on the software N210."""

import json
import os
import random
import socket
import subprocess
import sys
import tempfile
import threading
import time
from bisect import bisect_left
from contextlib import closing, contextmanager
from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce.io.optional import check_installed

from ..shell.log import progress
from ..shell.options import IntegerRange
from ..shell.tables import Column, echo, table

_TRIES = 30
_STOP_S = 10
# The command, whatever the name under which it is installed.
RUN = "from wiforce_app.main import run; raise SystemExit(run())"


class DeviceProcess:
    """A running software N210 of UHD arguments ``args``; RuntimeError if it does not start."""

    def __init__(self, *arguments, address=None):
        command = [sys.executable, "-c", RUN, "emulate", *map(str, arguments)]
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        for _ in range(_TRIES):
            self.address = address or f"127.0.{random.randrange(1, 255)}.{random.randrange(1, 255)}"
            self.process = subprocess.Popen([*command, "--bind", self.address], text=True, **pipes)
            if self.process.stdout.readline().startswith("listening"):
                break
            _, reason = self.process.communicate(timeout=_STOP_S)
            if "is in use" not in reason:
                raise RuntimeError(reason.strip())
        self._ending = False  # on request; a signal might then find Python without its handlers
        self._lock = threading.Lock()
        # With the type UHD skips the search for other kinds of devices, which takes 0.5 s.
        self.args = f"addr={self.address},type=usrp2"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.returncode is None:
            self.stop()

    def command(self, line):
        """The answer to a line of its control, as a dict; may be called by several threads."""
        try:
            with self._lock:
                self._ending = line == "stop"
                self.process.stdin.write(line + "\n")
                self.process.stdin.flush()
                return json.loads(self.process.stdout.readline())
        except (BrokenPipeError, json.JSONDecodeError):
            raise RuntimeError(f"the device has ended: {self.process.stderr.read()}") from None

    def stop(self):
        """End it; (exit status, standard error)."""
        if not self._ending and self.process.poll() is None:
            self.process.terminate()
        try:
            _, said = self.process.communicate(timeout=_STOP_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise
        return self.process.returncode, said


# Sample rate in Msps and what else a scene of about a hundred readings per second needs.
_SETTINGS = {
    "12.5": {"frame_length": 720, "snapshots": 125, "clock_hz": 1040.0},
    "1.25": {"frame_length": 360, "snapshots": 35, "clock_hz": 390.0},
}
_REFERENCE_S = 0.5
_PRESS = "press arm 3 40"
_HELD_S, _PAUSE_S = 0.3, 0.35
_START_LIMIT_S = 30.0


# The delay is that from the last sample of the next group, which a reading waits for, as it was
# sent by the device, to the group's message in another process. Cores are processor time per second
# of signal, of the live reader and of its process that has the device, without the software N210,
# which takes more than both.
COLUMNS = (
    Column("Msps", "msps", "g"),
    Column("group (ms)", "group_ms", ".2f"),
    Column("readings", "readings"),
    Column("delay after the next group (ms)", "work_ms", ".1f"),
    Column("95 %", "work_95_ms", ".1f"),
    Column("press to message (ms)", "press_ms", ".1f"),
    Column("95 %", "press_95_ms", ".1f"),
    Column("reader (cores)", "reader_cores", ".2f"),
    Column("radio (cores)", "radio_cores", ".2f"),
)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Rows as JSON.")
@click.option("--presses", default=30, type=IntegerRange(1), help="At each sample rate.")
def live(as_json, presses):
    """Measure the delay of readings behind the samples and behind a press.

    Three processes on loopback: a software N210, `gr-wiforce live`, and this one, which presses the
    sensor at random times and receives the readings by ZMQ.
    """
    from gnuradio import gr  # noqa: F401  of the reader, which would say so much later

    check_installed("bench live", ["zmq"])
    rows = []
    with progress("pressing", len(_SETTINGS) * presses) as step:
        for rate in _SETTINGS:
            try:
                rows.append(_measure(rate, presses, step))
            except RuntimeError as error:  # of the software N210
                raise click.ClickException(str(error)) from error
    echo(rows, as_json, lambda _: table(rows, COLUMNS))


def scene_of(msps):
    """The scene of a sample rate, as a mapping."""
    settings = _SETTINGS[msps]
    return {
        "radio": {"sample_rate_hz": float(msps) * 1e6},
        "sounding": {"frame_length": settings["frame_length"]},
        "phase_group": {"snapshots": settings["snapshots"]},
        "reference_s": _REFERENCE_S,
        "sensors": [
            {"name": "arm", "model": "line-900mhz", "clock_hz": settings["clock_hz"]},
        ],
        "simulation": {"duration_s": 1.0, "snr_db": 15, "static_clutter_db": 50},
    }


def _measure(msps, presses, step):
    from gnuradio.wiforce.planning.plan import plan

    group_s = plan(scene_of(msps)).group_period_s
    with tempfile.TemporaryDirectory(prefix="wiforce-live-") as folder:
        scene = Path(folder) / "scene.yaml"
        scene.write_text(json.dumps(scene_of(msps)), encoding="utf-8")
        with DeviceProcess(scene) as device, _live_reader(scene, device) as (port, reader):
            with closing(_Messages(port)) as messages:
                messages.wait_for(touched=False)
                before, rng = _counters(device, reader.pid), random.Random(1)
                sent, pressed_s = [], []
                for _ in range(presses):
                    pressed_s.append(_press(device, messages, rng))
                    sent += device.command("sent")["sent_s"]
                    step(1)
                signal_s, *cores_s = _counters(device, reader.pid) - before
            reader.terminate()
            reader.wait()
    work_s = delays_s(messages.readings, sent, 3 / 2 * group_s)
    return {
        "msps": float(msps),
        "group_ms": 1e3 * group_s,
        "readings": len(work_s),
        **_quantiles_ms("work", work_s),
        **_quantiles_ms("press", pressed_s),
        "reader_cores": round(cores_s[0] / signal_s, 3),
        "radio_cores": round(cores_s[1] / signal_s, 3),
    }


def _quantiles_ms(name, values_s):
    """Median and 95 % quantile as entries of a row."""
    found = (1e3 * np.percentile(values_s, [50, 95])).round(2).tolist()
    return dict(zip((f"{name}_ms", f"{name}_95_ms"), found, strict=True))


def delays_s(readings, sent, after_s):
    """Delays of messages behind the sample ``after_s`` after their group's centre, in s.

    ``readings`` are (arrival, device time of the centre), ``sent`` (device time, when), rising.
    """
    delays = []
    for arrived_s, centre_s in readings:
        at = bisect_left(sent, centre_s + after_s - 1e-9, key=lambda step: step[0])
        if 0 < at < len(sent):
            delays.append(arrived_s - sent[at][1])
    return np.array(delays)


def _press(device, messages, rng):
    """Seconds from a command to press to the first message with a touch."""
    messages.wait_for(touched=False)
    time.sleep(_PAUSE_S + rng.uniform(0, 0.1))
    sent_s = time.monotonic()
    device.command(_PRESS)
    delay_s = messages.wait_for(touched=True) - sent_s
    time.sleep(_HELD_S)
    device.command("release arm")
    return delay_s


def _counters(device, pid):
    """Signal, and processor time of the reader and of its children, in s; (3,)."""
    return np.array([device.command("status")["streaming_s"], *_processor_s(pid)])


def _processor_s(pid):
    """Processor time of a process and of its children, in s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    ticks = int(fields[11]) + int(fields[12])  # utime and stime, proc(5)
    own_s = ticks / os.sysconf("SC_CLK_TCK")
    tasks = Path(f"/proc/{pid}/task").iterdir()
    children = [child for task in tasks for child in (task / "children").read_text().split()]
    return own_s, sum(sum(_processor_s(int(child))) for child in children)


@contextmanager
def _live_reader(scene, device):
    """Port of the readings, and the process."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    frames = "recv_frame_size=8000,send_frame_size=8000"
    command = [sys.executable, "-c", RUN, "live", "--scene", str(scene), "--zmq", str(port)]
    command += ["--args", f"{device.args},{frames}"]
    command += ["-o", str(scene.with_name("readings.csv"))]
    command += ["--tx-gain", "15", "--rx-gain", "15"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        yield port, process
    except TimeoutError as error:
        process.kill()
        said = process.stderr.read().strip()[-300:]
        raise click.ClickException(f"{error}; the live reader wrote: {said}") from error
    finally:
        process.kill()
        process.communicate()


class _Messages:
    """Messages of a live reader: (arrival by `time.monotonic`, device time at the centre)."""

    def __init__(self, port):
        self.readings = []
        self._touched, self._at_s = None, 0.0
        self._changed = threading.Condition()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._receive, args=(port,))
        self._thread.start()

    def _receive(self, port):
        import zmq

        with zmq.Context() as context, context.socket(zmq.SUB) as socket_:
            socket_.connect(f"tcp://127.0.0.1:{port}")
            socket_.subscribe('{"message": "reading"')
            while not self._ended.is_set():
                if socket_.poll(100):
                    message = socket_.recv_json()
                    self._note(message, time.monotonic())

    def _note(self, message, arrived_s):
        # The first readings were held back for the reference.
        if message.get("device_time_s") is None or message["time_s"] < 2 * _REFERENCE_S:
            return
        self.readings.append((arrived_s, message["device_time_s"]))
        with self._changed:
            self._touched, self._at_s = bool(message["touch"]), arrived_s
            self._changed.notify_all()

    def wait_for(self, touched):
        """Wait for a reading in this state; when it arrived, by `time.monotonic`."""
        with self._changed:
            if self._changed.wait_for(lambda: self._touched is touched, _START_LIMIT_S):
                return self._at_s
        state = "touched" if touched else "untouched"
        raise TimeoutError(f"no {state} reading within {_START_LIMIT_S:g} s")

    def close(self):
        self._ended.set()
        self._thread.join()
