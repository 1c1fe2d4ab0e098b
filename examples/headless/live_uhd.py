#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmit, receive and read with one USRP, and print the readings.

The same as live_uhd.grc, without a window:

    live_uhd.py addr=192.168.10.2 scene.yaml

Two numbers that follow are the gains of transmitter and receiver in dB; without them, each has a
third of its range.
"""

from command_line import gains_db, run, start
from gnuradio import gr, wiforce


def main(device, scene, *gains):
    flowgraph = gr.top_block("live_uhd", catch_exceptions=False)
    usrp = wiforce.usrp(scene, device, *gains_db(gains))
    flowgraph.connect(usrp, wiforce.reader(scene, input_type="sc16", on_reading=print))
    run(flowgraph)


if __name__ == "__main__":
    start(main, "DEVICE SCENE [TX_GAIN RX_GAIN]", (2, 4), "type=b200 demo")
