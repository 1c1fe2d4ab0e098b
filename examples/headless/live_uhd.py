#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmit, receive and read with one USRP, and print the readings.

The same as live_uhd.grc, without a window:

    live_uhd.py addr=192.168.10.2 scene.yaml
"""

import sys

from gnuradio import gr, uhd, wiforce

GAIN_DB = 15.0
# Both directions start at a common time, late enough for both to be configured before.
START_S = 2.0
RECEIVE_SAMPLES = 1 << 16  # small packets would need two cores at 12.5 Msps


class Usrp:
    """Both directions of a USRP, configured by a scene: from `sounder` to the air to `frames`."""

    def __init__(self, device, scene):
        # The section `sounding` of a scene states all that is sent, with the symbol of a file.
        sounding = {"waveform": scene, "item_type": "sc16"}
        self.sounder = wiforce.sounding_source(amplitude=0.5, **sounding)
        self.transmitter = prepared(uhd.usrp_sink, device, scene, "TX/RX")
        self.receiver = prepared(uhd.usrp_source, device, scene, "RX2")
        self.receiver.set_recv_timeout(0.1, False)
        self.receiver.set_max_noutput_items(RECEIVE_SAMPLES)
        self.frames = wiforce.frame_alignment(**sounding)
        for block in (self.receiver, self.frames):
            block.set_min_output_buffer(4 * RECEIVE_SAMPLES)

    def connect(self, flowgraph, *blocks):
        """Connect the received samples, from the first whole frame on, to blocks of a flowgraph."""
        flowgraph.connect(self.sounder, self.transmitter)
        flowgraph.connect(self.receiver, self.frames, *blocks)

    def start_together(self):
        """Schedule both directions for one device time; call just before the flowgraph starts."""
        start = self.receiver.get_time_now() + uhd.time_spec(START_S)
        self.transmitter.set_start_time(start)
        self.receiver.set_start_time(start)


def prepared(direction, device, scene, antenna):
    """One direction of a device with rate, carrier, gain and antenna set."""
    end = direction(device, uhd.stream_args(cpu_format="sc16", otw_format="sc16", channels=[0]))
    end.set_samp_rate(scene.radio.sample_rate_hz)
    end.set_center_freq(scene.radio.center_frequency_hz)
    end.set_gain(GAIN_DB)
    end.set_antenna(antenna)
    return end


def run(flowgraph, *usrps):
    """Run until Enter is pressed."""
    for usrp in usrps:
        usrp.start_together()
    flowgraph.start()
    try:
        input("Press Enter to end.\n")
    finally:
        flowgraph.stop()
        flowgraph.wait()


def main(device, scene):
    scene = wiforce.load_scene(scene)
    flowgraph = gr.top_block("live_uhd", catch_exceptions=False)
    usrp = Usrp(device, scene)
    reader = wiforce.reader(scene, input_type="sc16", on_reading=print)
    usrp.connect(flowgraph, reader)
    run(flowgraph, usrp)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: live_uhd.py DEVICE SCENE, for example: live_uhd.py addr=192.168.10.2 demo")
    main(*sys.argv[1:])
