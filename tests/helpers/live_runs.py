# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes, live readers and their outputs for the tests of the live tools."""

import json
import subprocess
import sys
import threading
from contextlib import contextmanager, suppress
from pathlib import Path

import zmq
from command_runs import rows_of  # noqa: F401  of those who use what is here
from gnuradio.wiforce.io.network.zmq_sockets import Replies
from machine import free_ports, wait_until  # noqa: F401

FRAMES = "recv_frame_size=8000,send_frame_size=8000"
GAINS = ["--tx-gain", "15", "--rx-gain", "15"]

# A fifth of the usual rate costs a fifth of the time, where the rate is not what is tested.
SLOW = {
    "radio": {"sample_rate_hz": 2.5e6},
    "sounding": {"frame_length": 400},
    "phase_group": {"snapshots": 200},
}
# For a reader that ends by itself to say why, when a test has failed by it.
_LAST_WORDS_S = 10
SLOW_GROUP_S = 200 * 400 / 2.5e6


def scene_of(presses, clock_hz=1000, reference_s=0.5, **sections):
    return {
        "sensors": [{"name": "arm", "model": "line-900mhz-calibrated", "clock_hz": clock_hz}],
        "reference_s": reference_s,
        "simulation": {
            "truth_model": "line-900mhz",
            "duration_s": max((start for start, *_ in presses), default=0) + 5,
            "snr_db": 10,
            "static_clutter_db": 60,
            "clock_offset_ppm": 40,
            "presses": [
                {
                    "start_s": start,
                    "rise_s": 0.1,
                    "hold_s": 0.8,
                    "force_n": force,
                    "end_force_n": last,
                    "location_mm": place,
                }
                for start, force, last, place in presses
            ],
        },
        **sections,
    }


def scene_file(folder, *arguments, **options):
    path = folder / "scene.yaml"
    path.write_text(json.dumps(scene_of(*arguments, **options)))
    return path


def live_command(args, scene, *options):
    command = [sys.executable, "-m", "wiforce_app.main", "live", "--scene", str(scene)]
    return [*command, "--args", args, *map(str, options)]


@contextmanager
def live(args, scene, *options, limit=300, before=None):
    """A running live reader; ended if the test doesn't. ``before`` is called in it first."""
    process = subprocess.Popen(
        live_command(f"{args},{FRAMES}", scene, *options),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=before,
    )
    timer = threading.Timer(limit, process.kill)
    timer.start()
    try:
        yield process
    except Exception:
        with suppress(subprocess.TimeoutExpired):
            process.wait(_LAST_WORDS_S)
        raise
    finally:
        timer.cancel()
        process.kill()
        print(*process.communicate())  # shown when the test fails


def streaming_s(device):
    return device.command("status")["streaming_s"]


def run_session(*arguments):
    """The last line that a run of session_runs.py prints, and what it says besides."""
    script = Path(__file__).with_name("session_runs.py")
    command = [sys.executable, str(script), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1]), done.stderr


@contextmanager
def connected(kind, port):
    """A ZMQ socket of this kind, connected to a reader's port."""
    with zmq.Context() as context, context.socket(kind) as client:
        client.setsockopt(zmq.LINGER, 0)
        client.setsockopt(zmq.RCVTIMEO, 60_000)
        client.connect(f"tcp://127.0.0.1:{port}")
        yield client


@contextmanager
def served(answer=str.upper, keys=None):
    """The port of a server of requests, and the list of what it was asked."""
    asked, ended = [], threading.Event()

    def noted(text):
        asked.append(text)
        return answer(text)

    (port,) = free_ports(1)
    replies = Replies(str(port), noted, keys=keys)

    def serve():
        while not ended.wait(0.005):
            replies.serve(10)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield port, asked
    finally:
        ended.set()
        thread.join()
        replies.close()


def ask(client, word):
    client.send_string(word)
    return json.loads(client.recv_string())
