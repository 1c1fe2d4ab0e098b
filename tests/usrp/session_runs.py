# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs of a LiveSession for the tests, in a process of their own: UHD's blocks end a process
whose device is gone, and must not end the tests'.

    session_runs.py timed SCENE ARGS NAME SECONDS   records, prints when which reading came
    session_runs.py on_request SCENE ARGS NAME      starts at a line of input; prints what it read
    session_runs.py repeated SCENE ARGS             starts and stops, prints what is held open
    session_runs.py refused OPTIONS ...             `live` with each of these lists; their statuses
"""

import gc
import json
import os
import sys
import time

from gnuradio.wiforce.scene import load_scene
from wiforce_app.live_session import LiveSession
from wiforce_app.main import main
from wiforce_app.radio import Radio


def timed(scene, args, name, seconds):
    came = []
    scene = load_scene(scene)
    session = LiveSession(
        scene,
        Radio(args, scene, 15, 15),
        lambda reading: came.append({"came_s": session.time_s, **reading.row()}),
        recording=name,
    )
    session.start()
    while session.time_s < float(seconds):
        time.sleep(0.02)
    session.stop()
    print(json.dumps(came))


def on_request(scene, args, name):
    scene = load_scene(scene)
    times = []
    radio = Radio(args, scene, 15, 15)
    print("opened", flush=True)
    sys.stdin.readline()
    session = LiveSession(
        scene, radio, lambda reading: times.append(reading.time_s), recording=name
    )
    session.start()
    while session.time_s < 1.3:
        time.sleep(0.02)
    session.stop()
    print(json.dumps({"time_s": times, "gaps": session.gaps}))


def repeated(scene, args):
    scene = load_scene(scene)
    held = []
    for _ in range(5):
        radio = Radio(args, scene, 15, 15)
        for _ in range(2):
            session = LiveSession(scene, radio, lambda reading: None)
            session.start()
            session.stop()
        del radio, session
        gc.collect()
        held.append(_held())
    print(json.dumps(held))


def refused(*cases):
    print(json.dumps([main(["live", *map(str, json.loads(case))]) for case in cases]))


def _held():
    """Sockets and threads of this process."""
    sockets = 0
    for descriptor in os.listdir("/proc/self/fd"):
        try:
            sockets += os.readlink(f"/proc/self/fd/{descriptor}").startswith("socket")
        except FileNotFoundError:
            pass
    return sockets, len(os.listdir("/proc/self/task"))


if __name__ == "__main__":
    runs = (timed, on_request, repeated, refused)
    run = {each.__name__: each for each in runs}[sys.argv[1]]
    run(*sys.argv[2:])
