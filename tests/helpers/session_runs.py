# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs that a radio or its driver may refuse, in a process of their own.

session_runs.py refused OPTIONS ...             `live` with each of these lists; their statuses
session_runs.py opened SCENE SETTINGS ...       opens the device alone; what is refused of each
"""

import json
import sys

from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.scene import load_scene
from wiforce_app.main import main
from wiforce_app.radio.radio import open_radio
from wiforce_app.radio.request import RadioRequest


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
    runs = (refused, opened)
    run = {each.__name__: each for each in runs}[sys.argv[1]]
    run(*sys.argv[2:])
