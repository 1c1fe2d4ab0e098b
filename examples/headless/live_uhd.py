#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmit, receive and read with one USRP, and print the readings.

The same as live_uhd.grc, without a window:

    live_uhd.py addr=192.168.10.2 scene.yaml

Two numbers that follow are the gains of transmitter and receiver in dB; without them, each has a
third of its range.
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


def usrp_of(scene, device, tx_gain=None, rx_gain=None):
    """The block; where no such device answers, a sentence and the end."""
    try:
        return wiforce.usrp(scene, device, tx_gain, rx_gain)
    except ValueError as error:
        print(error, file=sys.stderr)
        sys.exit(2)


def main(device, scene, tx_gain=None, rx_gain=None):
    flowgraph = gr.top_block("live_uhd", catch_exceptions=False)
    usrp = usrp_of(scene, device, tx_gain, rx_gain)
    flowgraph.connect(usrp, wiforce.reader(scene, input_type="sc16", on_reading=print))
    run(flowgraph)


if __name__ == "__main__":
    if len(sys.argv) not in (3, 5):
        sys.exit(
            "usage: live_uhd.py DEVICE SCENE [TX_GAIN RX_GAIN], "
            "for example: live_uhd.py type=b200 demo"
        )
    main(*sys.argv[1:3], *map(float, sys.argv[3:]))
