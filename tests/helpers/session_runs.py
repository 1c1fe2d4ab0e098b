# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs of a LiveSession for the tests, in a process of their own.

session_runs.py timed SCENE ARGS NAME SECONDS   records, prints when which reading came
session_runs.py on_request SCENE ARGS NAME      starts at a line of input; prints what it read
session_runs.py refused OPTIONS ...             `live` with each of these lists; their statuses
session_runs.py opened SCENE SETTINGS ...       opens the device alone; what is refused of each
"""

import json
import sys
import time

from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.scene import load_scene
from wiforce_app.live.radio_keeper import RadioKeeper
from wiforce_app.live.session import LiveSession
from wiforce_app.main import main
from wiforce_app.radio.radio import open_radio
from wiforce_app.radio.request import RadioRequest


class Run:
    """A session with its device, driven by the test."""

    def __init__(self, scene, args, on_reading, name=None, on_open=lambda link: None):
        scene = load_scene(scene)
        request = RadioRequest.of_scene(scene, args, tx_gain_db=15, rx_gain_db=15)
        self.session = LiveSession(scene, request, on_reading, recording=name)
        self._keeper = RadioKeeper(request, self.session, on_open=on_open)

    def until(self, condition):
        """Read until a condition holds, then stop."""
        while not condition(self.session):
            self._keeper.look()
            time.sleep(0.02)
        self._keeper.stop()
        self.session.stop()


def timed(scene, args, name, seconds):
    came = []
    run = Run(
        scene,
        args,
        lambda reading: came.append({"came_s": run.session.time_s, **reading.row()}),
        name,
    )
    run.until(lambda session: session.time_s >= float(seconds))
    print(json.dumps(came))


def on_request(scene, args, name):
    times = []

    def opened(link):
        print("opened", flush=True)
        sys.stdin.readline()

    run = Run(scene, args, lambda reading: times.append(reading.time_s), name, opened)
    run.until(lambda session: session.time_s >= 1.3)
    print(json.dumps({"time_s": times, "gaps": run.session.gaps}))


def refused(*cases):
    print(json.dumps([main(["live", *map(str, json.loads(case))]) for case in cases]))


def opened(scene, *cases):
    scene, refusals = load_scene(scene), []
    for case in cases:
        try:
            radio = open_radio(RadioRequest.of_scene(scene, driver="soapy", **json.loads(case)))
            json.dumps([radio.settings(), radio.hardware], allow_nan=False).encode()
            refusals.append("")
        except InputError as error:
            refusals.append(str(error))
    print(json.dumps(refusals))


if __name__ == "__main__":
    runs = (timed, on_request, refused, opened)
    run = {each.__name__: each for each in runs}[sys.argv[1]]
    run(*sys.argv[2:])
