#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmit with one USRP and record the received samples as SigMF.

As record_uhd.grc, without a window:

    record_uhd.py addr=192.168.10.2 scene.yaml recorded
    gr-wiforce read recorded
"""

from command_line import run, start
from gnuradio import gr, wiforce


def main(device, scene, name):
    scene = wiforce.load_scene(scene)
    flowgraph = gr.top_block("record_uhd", catch_exceptions=False)
    recorder = wiforce.sigmf_recorder(
        name,
        sample_rate=scene.radio.sample_rate_hz,
        center_frequency=scene.radio.center_frequency_hz,
        item_type="sc16",
        fields={"core:hw": device, "wiforce:scene": scene.as_dict(name)},
    )
    flowgraph.connect(wiforce.usrp(scene, device), recorder)
    run(flowgraph)


if __name__ == "__main__":
    start(main, "DEVICE SCENE RECORDING", (3,))
