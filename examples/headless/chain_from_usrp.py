#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Transmit, receive and read with one USRP by one block per step of the paper.

The same as chain_from_usrp.grc, without a window:

    chain_from_usrp.py addr=192.168.10.2 scene.yaml

Two numbers that follow are the gains of transmitter and receiver in dB; without them, each has a
third of its range.
"""

from chain_from_file import Chain
from command_line import gains_db, run, start
from gnuradio import gr, wiforce

# Groups that may wait while Python pauses: two seconds of the scene `demo`.
BUFFERED_GROUPS = 56


class ChainFromUsrp(gr.top_block):
    def __init__(self, device, scene, on_reading, tx_gain=None, rx_gain=None):
        gr.top_block.__init__(self, "chain_from_usrp", catch_exceptions=False)
        scene = wiforce.load_scene(scene)
        plan = wiforce.plan(scene)  # the settings of all steps

        # Both directions of the device; its samples from the first whole frame on.
        self.usrp = wiforce.usrp(scene, device, tx_gain, rx_gain)

        # Preambles (section 3.3): each frame repeats one symbol; the mean of the repetitions is a
        # snapshot of the channel. Samples that were lost are noticed by the tag rx_time.
        self.fold = wiforce.preamble_fold(
            **plan.waveform.folding, sample_rate=plan.waveform.sample_rate_hz, item_type="sc16"
        )

        # Doppler, channel, ends, change, average and inversion: see chain_from_file.py.
        self.chain = Chain(plan, on_reading)
        self.chain.channel.set_min_output_buffer(BUFFERED_GROUPS)
        self.connect(self.usrp, self.fold)
        self.chain.connect(self, self.fold)


def main(device, scene, *gains):
    flowgraph = ChainFromUsrp(device, scene, print, *gains_db(gains))
    run(flowgraph)
    flowgraph.chain.check()


if __name__ == "__main__":
    start(main, "DEVICE SCENE [TX_GAIN RX_GAIN]", (2, 4), "type=b200 demo")
