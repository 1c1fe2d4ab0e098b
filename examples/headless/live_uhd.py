#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmit, receive and read with one USRP, and print the readings.

The same as live_uhd.grc, without a window:

    live_uhd.py addr=192.168.10.2 scene.yaml
"""

import sys

from gnuradio import gr, wiforce


def run(flowgraph):
    """Run until Enter is pressed."""
    flowgraph.start()
    try:
        input("Press Enter to end.\n")
    finally:
        flowgraph.stop()
        flowgraph.wait()


def main(device, scene):
    flowgraph = gr.top_block("live_uhd", catch_exceptions=False)
    usrp = wiforce.usrp(scene, device)  # with tx_gain and rx_gain in dB, or a third of their range
    flowgraph.connect(usrp, wiforce.reader(scene, input_type="sc16", on_reading=print))
    run(flowgraph)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: live_uhd.py DEVICE SCENE, for example: live_uhd.py addr=192.168.10.2 demo")
    main(*sys.argv[1:])
