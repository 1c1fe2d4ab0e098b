# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench live``: delay of readings behind the samples, on the software N210."""

import json
import random
import resource
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np

from ..markdown import markdown_table
from ..options import IntegerRange
from ..progress import progress

# Sample rate in Msps and what else a scene of about a hundred readings per second needs.
_SETTINGS = {
    "12.5": {"frame_length": 720, "snapshots": 125, "clock_hz": 1040.0},
    "1.25": {"frame_length": 360, "snapshots": 35, "clock_hz": 390.0},
}
_REFERENCE_S = 0.5
_PRESS = "press arm 3 40"
_HELD_S, _PAUSE_S = 0.3, 0.35
_START_LIMIT_S = 30.0
_TRIES = 20
_RUN = "from wiforce_app.main import run; raise SystemExit(run())"


@dataclass(frozen=True)
class Row:
    """One sample rate.

    Attributes
    ----------
    msps, group_ms : float
        Sample rate in Msps, length of a phase group in ms.
    readings : int
        Readings whose delay was measured.
    delay_ms, delay_95_ms, delay_99_ms : float
        Time from the last sample of a group to its message in another process: median and
        quantiles.
    presses : int
        Presses among them.
    press_ms, press_95_ms : float
        Time from the command to press to the first message with a touch.
    cores : float
        Processor time of the live reader over time, its start included.
    """

    msps: float
    group_ms: float
    readings: int
    delay_ms: float
    delay_95_ms: float
    delay_99_ms: float
    presses: int
    press_ms: float
    press_95_ms: float
    cores: float


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Rows as JSON.")
@click.option(
    "--presses", default=30, type=IntegerRange(1), show_default=True, help="At each sample rate."
)
@click.option(
    "--latency",
    type=click.Choice(["low", "relaxed"]),
    default="low",
    show_default=True,
    help="Option of the live reader.",
)
@click.option(
    "--msps", multiple=True, type=click.Choice(list(_SETTINGS)), help="Only this sample rate."
)
def live(as_json, presses, latency, msps):
    """Measure the delay of readings behind the samples and behind a press.

    Three processes on loopback: a software N210, `gr-wiforce live`, and this one, which presses the
    sensor at random times and receives the readings by ZMQ.
    """
    rows = []
    rates = msps or list(_SETTINGS)
    with progress("pressing", len(rates) * presses) as step:
        for rate in rates:
            rows.append(_measure(rate, presses, latency, step))
    click.echo(json.dumps([asdict(row) for row in rows], indent=1) if as_json else table(rows))


def table(rows):
    """Rows as a table in Markdown."""
    head = ["Msps", "group (ms)", "readings", "delay (ms)", "95 %", "99 %"]
    head += ["presses", "press to message (ms)", "95 %", "cores"]
    cells = [
        [
            f"{row.msps:g}",
            f"{row.group_ms:.2f}",
            str(row.readings),
            f"{row.delay_ms:.1f}",
            f"{row.delay_95_ms:.1f}",
            f"{row.delay_99_ms:.1f}",
            str(row.presses),
            f"{row.press_ms:.1f}",
            f"{row.press_95_ms:.1f}",
            f"{row.cores:.2f}",
        ]
        for row in rows
    ]
    return markdown_table(head, cells)


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


def _measure(msps, presses, latency, step):
    from gnuradio.wiforce.planning.plan import plan

    group_s = plan(scene_of(msps)).group_period_s
    with tempfile.TemporaryDirectory(prefix="wiforce-live-") as folder:
        scene = Path(folder) / "scene.yaml"
        scene.write_text(json.dumps(scene_of(msps)), encoding="utf-8")
        with _Device(scene) as device, _live_reader(scene, device, latency) as (port, reader):
            messages = _Messages(port, device.clock)
            with closing(messages):
                pressed = _press(device, messages, presses, step)
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            reader.terminate()
            reader.wait()
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            ran_s = time.monotonic() - messages.started_s
    delays_ms = 1e3 * (np.array(messages.delays_s) - group_s / 2)
    return Row(
        float(msps),
        1e3 * group_s,
        len(delays_ms),
        *np.round(np.quantile(delays_ms, [0.5, 0.95, 0.99]), 2).tolist(),
        presses,
        *np.round(1e3 * np.quantile(pressed, [0.5, 0.95]), 2).tolist(),
        round((sum(after[:2]) - sum(before[:2])) / ran_s, 3),
    )


def _press(device, messages, presses, step):
    """Seconds from every command to press to the first message with a touch."""
    rng = random.Random(1)
    delays_s = []
    for _ in range(presses):
        messages.wait_for(touched=False)
        time.sleep(_PAUSE_S + rng.uniform(0, 0.1))
        sent_s = time.monotonic()
        device.command(_PRESS)
        delays_s.append(messages.wait_for(touched=True) - sent_s)
        time.sleep(_HELD_S)
        device.command("release arm")
        step(1)
    return delays_s


class _Device:
    """A software N210 in a process of its own, and the relation of its time to ours."""

    def __init__(self, scene):
        command = [sys.executable, "-c", _RUN, "emulate", str(scene), "--bind"]
        for _ in range(_TRIES):
            self.address = f"127.0.{random.randrange(1, 255)}.{random.randrange(1, 255)}"
            pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
            self._process = subprocess.Popen([*command, self.address], text=True, **pipes)
            if self._process.stdout.readline().startswith("listening"):
                break
            _, reason = self._process.communicate()
            if "is in use" not in reason:
                raise click.ClickException(reason.strip())
        self._lock = threading.Lock()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.terminate()
        self._process.communicate()

    def command(self, line):
        """The answer to a line of its control, as a dict."""
        with self._lock:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()
            return json.loads(self._process.stdout.readline())

    def clock(self):
        """Device time minus ours, in s."""
        sent_s = time.monotonic()
        device_s = self.command("status")["device_time_s"]
        return device_s - (sent_s + time.monotonic()) / 2


@contextmanager
def _live_reader(scene, device, latency):
    """Port of the readings, and the process."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    frames = "recv_frame_size=8000,send_frame_size=8000"
    command = [sys.executable, "-c", _RUN, "live", "--scene", str(scene), "--zmq", str(port)]
    command += ["--args", f"addr={device.address},type=usrp2,{frames}"]
    command += ["-o", str(scene.with_name("readings.csv")), "--latency", latency]
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
    """Messages of a live reader as they arrive."""

    def __init__(self, port, clock):
        self.delays_s = []
        self.started_s = time.monotonic()
        self._clock = clock
        self._touched, self._at_s = None, 0.0
        self._changed = threading.Condition()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._receive, args=(port,))
        self._thread.start()

    def _receive(self, port):
        import zmq

        with zmq.Context() as context, context.socket(zmq.SUB) as socket_:
            socket_.connect(f"tcp://127.0.0.1:{port}")
            socket_.subscribe("")
            offset_s, asked_s = self._clock(), time.monotonic()
            while not self._ended.is_set():
                if not socket_.poll(100):
                    continue
                message = socket_.recv_json()
                arrived_s = time.monotonic()
                self._note(message, arrived_s, offset_s)
                if arrived_s - asked_s > 0.1 and not socket_.poll(0):
                    offset_s, asked_s = self._clock(), time.monotonic()

    def _note(self, message, arrived_s, offset_s):
        # The first readings were held back for the reference.
        if message.get("device_time_s") is None or message["time_s"] < 2 * _REFERENCE_S:
            return
        self.delays_s.append(arrived_s + offset_s - message["device_time_s"])
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
