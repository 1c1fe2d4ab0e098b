#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmit the sounding frames with a USRP, without receiving.

The same as transmit_uhd.grc, without a window:

    transmit_uhd.py addr=192.168.10.2 scene.yaml
"""

from command_line import run, start
from gnuradio import gr, uhd, wiforce
from gnuradio.wiforce.errors import InputError

GAIN_DB = 15.0


def main(device, scene):
    scene = wiforce.load_scene(scene)
    flowgraph = gr.top_block("transmit_uhd", catch_exceptions=False)
    sounder = wiforce.sounding_source(
        waveform=scene,
        amplitude=0.5,
        item_type="sc16",
    )
    stream = uhd.stream_args(cpu_format="sc16", otw_format="sc16", channels=[0])
    try:
        transmitter = uhd.usrp_sink(device, stream)
    except (RuntimeError, LookupError) as error:
        reason = " ".join(str(error).split())
        raise InputError("device", f"must be a USRP that answers ({reason})", device) from error
    transmitter.set_samp_rate(scene.radio.sample_rate_hz)
    transmitter.set_center_freq(scene.radio.center_frequency_hz)
    transmitter.set_gain(GAIN_DB)
    transmitter.set_antenna("TX/RX")
    flowgraph.connect(sounder, transmitter)
    run(flowgraph)


if __name__ == "__main__":
    start(main, "DEVICE SCENE", (2,))
