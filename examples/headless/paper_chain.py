#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The receiver of the paper and the one of this project on the same samples.

Nothing presses the sensor, so both phases should stay at 0. The clock of the tag is 40 ppm off;
only a receiver that tracks it keeps the phases at 0. The same as paper_chain.grc, without a window.
"""

import numpy as np
from gnuradio import blocks, gr, wiforce

CLOCK_OFFSET_PPM = 40.0
DURATION_S = 2.0


class Chains(gr.top_block):
    def __init__(self):
        gr.top_block.__init__(self, "paper_chain", catch_exceptions=False)
        scene = wiforce.load_scene("tabletop")
        rate, frame_length = scene.radio.sample_rate_hz, scene.sounding.frame_length
        self.air = [
            wiforce.sounding_source(frame_length=frame_length, sample_rate=rate),
            blocks.head(gr.sizeof_gr_complex, int(DURATION_S * rate)),
            wiforce.backscatter_tag(
                model="line-900mhz",
                clock_hz=scene.sensors[0].clock_hz,
                clock_offset_ppm=CLOCK_OFFSET_PPM,
                snr_db=20,
                static_clutter_db=50,
                sample_rate=rate,
                frame_length=frame_length,
            ),
            wiforce.preamble_fold(frame_length=frame_length, sample_rate=rate),
        ]
        self.connect(*self.air)
        self.plan = wiforce.plan(scene)
        self.paper = self.paper_chain(wiforce.plan(scene, estimator="paper"))
        self.ours = self.our_chain(self.plan)
        for tones, chain in (self.paper, self.ours):
            self.connect(self.air[-1], *chain)
            separation = next(b for b in chain if isinstance(b, wiforce.end_separation))
            self.msg_connect(tones, "incomplete", separation, "incomplete")

    def tones(self):
        # With these weights static paths do not leak into groups of no whole clock periods.
        return wiforce.phase_group_doppler(
            weights=self.plan.table.weights, group_length=self.plan.group_length
        )

    def paper_chain(self, plan):
        """Channel of every snapshot, lines +1 and +4, relative to the previous group."""
        tones = self.tones()
        return tones, [
            wiforce.ofdm_channel_estimator(factors=plan.waveform.equalizer()),
            tones,
            wiforce.end_separation(plan, derotated=False),
            wiforce.conjugate_difference(plan),
            wiforce.subcarrier_average(plan),
            blocks.vector_sink_c(2),
        ]

    def our_chain(self, plan):
        """Tones first, all lines, tracked clock, relative to the untouched sensor."""
        tones = self.tones()
        return tones, [
            tones,
            wiforce.ofdm_channel_estimator(
                factors=plan.waveform.equalizer(),
                rows=len(plan.table.tones),
                rotation=plan.table.derotation(plan.waveform.sample_rate_hz),
            ),
            wiforce.end_separation(plan),
            wiforce.conjugate_difference(plan),
            wiforce.subcarrier_average(plan),
            blocks.vector_sink_c(2),
        ]


def main():
    chains = Chains()
    chains.run()
    ratios = {}
    for name, (_, chain) in (("paper", chains.paper), ("this project", chains.ours)):
        ratios[name] = np.reshape(chain[-1].data(), (-1, 2))
    # Ratios to the previous group: their product is the change since the start.
    ratios["paper"] = np.cumprod(ratios["paper"], axis=0)
    for name, values in ratios.items():
        ends = np.degrees(np.angle(values[-1]))
        print(f"{name:12}: end 1 {ends[0]:+7.2f} deg, end 2 {ends[1]:+7.2f} deg")


if __name__ == "__main__":
    main()
