#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads live with one USRP and prints: live_uhd.grc without a window.

live_uhd.py addr=192.168.10.2 scene.yaml
"""

import sys
import time

from gnuradio import gr, uhd, wiforce

# Both directions start this long after the device's time was set: making them takes a while.
START_S = 1.0


class LiveUhd(gr.top_block):
    def __init__(self, device, scene, tx_gain_db=10.0, rx_gain_db=10.0):
        gr.top_block.__init__(self, "live_uhd", catch_exceptions=False)
        self.scene = wiforce.load_scene(scene)
        rate, carrier_hz = self.scene.radio.sample_rate_hz, self.scene.radio.center_frequency_hz
        stream = uhd.stream_args(cpu_format="sc16", otw_format="sc16", channels=[0])
        self.transmitter = uhd.usrp_sink(device, stream)
        self.receiver = uhd.usrp_source(device, stream)
        for end, gain_db, antenna in (
            (self.transmitter, tx_gain_db, "TX/RX"),
            (self.receiver, rx_gain_db, "RX2"),
        ):
            end.set_samp_rate(rate)
            end.set_center_freq(carrier_hz)
            end.set_gain(gain_db)
            end.set_antenna(antenna)
        self.sounder = wiforce.sounding_source(
            waveform=self.scene.sounding.waveform,
            frame_length=self.scene.sounding.frame_length,
            sample_rate=rate,
            amplitude=0.3,
            item_type="sc16",
        )
        self.reader = wiforce.reader(self.scene, input_type="sc16", on_reading=print)
        self.connect(self.sounder, self.transmitter)
        self.connect(self.receiver, self.reader)
        self.receiver.set_time_now(uhd.time_spec(time.time()))
        start = self.receiver.get_time_now() + uhd.time_spec(START_S)
        self.transmitter.set_start_time(start)
        self.receiver.set_start_time(start)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: live_uhd.py DEVICE SCENE     for example: addr=192.168.10.2 demo")
    flowgraph = LiveUhd(*sys.argv[1:])
    flowgraph.start()
    try:
        input("Press Enter to end.\n")
    finally:
        flowgraph.stop()
        flowgraph.wait()
