#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Read a recording by one block per step of the paper, and write the readings to a file.

The same as chain_from_file.grc, without a window:

    build/run gr-wiforce simulate tabletop table
    build/run python3 examples/headless/chain_from_file.py table readings.csv

Two words that follow are the scene and the type of raw samples: demo ci16_le.
"""

from command_line import start
from gnuradio import blocks, gr, wiforce
from gnuradio.wiforce.io.capture import open_capture


class Chain:
    """From snapshots to readings: the steps of WiForce (NSDI 2021), a block each.

    H is the channel, k the subcarrier, n the snapshot, g the phase group of N_g snapshots.
    """

    def __init__(self, plan, on_reading):
        waveform, lines = plan.waveform, plan.table

        # Doppler (section 3.3, phase groups): a Fourier sum over the snapshots of each group,
        #     P_m[k, g] = sum_n w_m[n] H[k, g N_g + n]
        # at every line m fs of a tag that switches at fs. The weights w_m null the static paths.
        self.tones = wiforce.phase_group_doppler(
            weights=lines.weights,
            group_length=plan.group_length,
            symbol_length=waveform.symbol_length,
        )

        # Channel (section 3.3): H[k] = FFT of the received symbol / X_k, the symbol that was sent.
        # Both steps are linear. In this order there is an FFT per line, not one per snapshot.
        self.channel = wiforce.ofdm_channel_estimator(
            factors=waveform.equalizer(),
            rows=len(lines.tones),
            rotation=lines.derotation(waveform.sample_rate_hz, waveform.symbol_length),
        )

        self.to_force = steps_to_force(plan, on_reading)

    def connect(self, flowgraph, *before):
        """Connect the chain behind blocks, the last of which gives snapshots."""
        separation = self.to_force[0]
        flowgraph.connect(*before, self.tones, self.channel, *self.to_force)
        # Groups that lack samples are solved from the snapshots that were received.
        flowgraph.msg_connect(self.tones, "incomplete", separation, "incomplete")

    def check(self):
        """Raise the exception that ended the flowgraph, if there was one."""
        for block in self.to_force:
            failure = getattr(block, "failure", None)  # of the module's own blocks
            if failure is not None:
                raise failure


def steps_to_force(plan, on_reading):
    """The steps behind the channel at each line; the estimator of the plan decides how."""
    return [
        # Ends (section 3.2): end 1 of the sensor is line fs of its tag, end 2 is line 4 fs. Here
        # both are fitted to all lines together, at the phase of the tag's clock, which is tracked.
        wiforce.end_separation(plan),
        # Change (section 3.3): V_i[k, g] conj(V_i,ref[k]) of each end i. The air cancels. The paper
        # refers to the previous group, this project to the untouched sensor.
        wiforce.conjugate_difference(plan),
        # Average (section 3.3): R_i = sum_k w_k V_i conj(V_i,ref) / sum_k w_k |V_i,ref|^2 over the
        # subcarriers. The phase change of end i is arg R_i.
        wiforce.subcarrier_average(plan),
        # Inversion (section 3.1, the sensor): two phases give two unknowns, force and location, by
        # the sensor's model, for which the paper fits a cubic of phase against force per location.
        wiforce.force_inversion(plan, on_reading=on_reading),
    ]


# Bytes of a sample and its type in the blocks, by the type that SigMF states.
SAMPLES = {"ci16_le": (2 * gr.sizeof_short, "sc16"), "cf32_le": (gr.sizeof_gr_complex, "fc32")}


def main(capture, output, scene=None, datatype=None):
    capture = open_capture(capture, datatype)
    # The settings of all steps: those of the capture's scene, adapted to the room.
    plan = wiforce.plan_for_capture(capture, scene)
    flowgraph = gr.top_block("chain_from_file", catch_exceptions=False)
    with wiforce.open_writer(output, capture.files) as writer:
        size, item_type = SAMPLES[capture.datatype]
        recorded = blocks.file_source(size, str(capture.path), repeat=False)

        # Preambles (section 3.3): each frame repeats one symbol; the mean of the repetitions is a
        # snapshot of the channel.
        fold = wiforce.preamble_fold(
            **plan.waveform.folding, sample_rate=plan.waveform.sample_rate_hz, item_type=item_type
        )

        chain = Chain(plan, writer.write)
        chain.connect(flowgraph, recorded, fold)
        flowgraph.run()
        chain.check()


if __name__ == "__main__":
    start(main, "CAPTURE READINGS.csv [SCENE ci16_le|cf32_le]", (2, 4))
