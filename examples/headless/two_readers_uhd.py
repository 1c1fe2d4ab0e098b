#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Two USRPs, each with a reader of its own and at its own carrier.

The same as two_readers_uhd.grc, without a window:

    two_readers_uhd.py addr=192.168.10.2 scene.yaml addr=192.168.10.3 other.yaml
"""

from functools import partial
from threading import Lock

from command_line import run, start
from gnuradio import gr, wiforce

printing = Lock()


def show(device, reading):
    """Print a reading; each reader calls this from a thread of its own."""
    with printing:
        print(device, reading)


def main(*devices_and_scenes):
    flowgraph = gr.top_block("two_readers_uhd", catch_exceptions=False)
    for device, scene in zip(devices_and_scenes[::2], devices_and_scenes[1::2], strict=True):
        reader = wiforce.reader(scene, input_type="sc16", on_reading=partial(show, device))
        flowgraph.connect(wiforce.usrp(scene, device), reader)
    run(flowgraph)


if __name__ == "__main__":
    start(main, "DEVICE SCENE DEVICE SCENE", (4,))
