#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Read a simulated sensor by one block per step of the paper, and compare its estimator with ours.

Prints the readings, the Doppler spectrum and the clock of the tag, and then what both estimators
make of the presses and of the release, after which the phases should be as before. The clock of the
tag is 40 ppm off, which the estimator of the paper does not track. The same as chain_simulated.grc,
without a window.
"""

import dataclasses
import signal
from itertools import pairwise

import numpy as np
from chain_from_file import Chain, steps_to_force
from command_line import start
from gnuradio import blocks, gr, wiforce
from press_simulation import PRESSES, SimulatedSensor, print_reading

CLOCK_OFFSET_PPM = 40.0
SPECTRUM_LENGTH = 625  # snapshots, so that the lines of the tag fall on whole bins
SETTLING_S = 0.1  # from a press until the readings show it alone


class ChainSimulated(gr.top_block):
    def __init__(self, scene):
        gr.top_block.__init__(self, "chain_simulated", catch_exceptions=False)
        plan = wiforce.plan(scene)  # the settings of all steps
        self.simulated = SimulatedSensor(scene, CLOCK_OFFSET_PPM)
        self.readings = []

        # Preambles (section 3.3): each frame repeats one symbol; the mean of the repetitions is a
        # snapshot of the channel.
        self.fold = wiforce.preamble_fold(
            **plan.waveform.folding, sample_rate=plan.waveform.sample_rate_hz
        )

        # Doppler, channel, ends, change, average and inversion: see chain_from_file.py.
        self.chain = Chain(plan, self.readings.append)
        self.chain.connect(self, *self.simulated.blocks, self.fold)

        # The estimator of the paper from the same tones: end 1 is line fs, end 2 line 4 fs, each
        # compared with the previous group; the clock of the tag is not tracked.
        of_paper = dataclasses.replace(plan, estimator="paper")
        self.readings_of_paper = []
        self.paper = steps_to_force(of_paper, self.readings_of_paper.append)
        self.connect(self.chain.channel, *self.paper)
        self.msg_connect(self.chain.tones, "incomplete", self.paper[0], "incomplete")

        # The ratios R of both ends, from which the force is read.
        self.ratios, self.steps_of_paper = blocks.vector_sink_c(2), blocks.vector_sink_c(2)
        self.connect(self.chain.to_force[2], self.ratios)
        self.connect(self.paper[2], self.steps_of_paper)

        # The whole Doppler spectrum, in which the chain reads the lines of the tag only.
        self.spectra = blocks.vector_sink_c(64 * SPECTRUM_LENGTH)
        self.connect(self.fold, wiforce.phase_group_doppler.spectrum(SPECTRUM_LENGTH), self.spectra)

        # The clock of the tag as the separation of the ends tracks it.
        self.offset, self.offsets = wiforce.clock_offset(), blocks.vector_sink_f()
        self.connect(self.chain.to_force[0], self.offset, self.offsets)


def print_spectrum(flowgraph, scene):
    """Power at the lines of the tag in the last spectrum, and the clock found."""
    power = np.abs(np.reshape(flowgraph.spectra.data(), (-1, SPECTRUM_LENGTH, 64))[-1]) ** 2
    power_db = 10 * np.log10(power.sum(axis=1))
    clock_hz = scene.sensors[0].clock_hz
    for m, name in ((0, "room"), (1, "end 1"), (2, "both"), (4, "end 2")):
        row = round(m * clock_hz * SPECTRUM_LENGTH * scene.snapshot_period_s)
        print(f"Doppler {m * clock_hz:6.0f} Hz: {power_db[row]:6.1f} dB  ({name})")
    print(f"noise: {np.median(power_db):6.1f} dB")
    found_ppm = flowgraph.offsets.data()[-1]
    print(f"tag clock: {found_ppm:+.2f} ppm found, {CLOCK_OFFSET_PPM:+.2f} ppm set")


def print_comparison(flowgraph):
    """Both estimators: the forces that they read, and their phases after the last release."""
    estimators = {"paper": flowgraph.readings_of_paper, "this project": flowgraph.readings}
    for (start_s, force_n, location_mm), (end_s, *_) in pairwise(PRESSES):
        print(f"press of {force_n} N at {location_mm} mm:")
        for name, readings in estimators.items():
            touched = [r for r in readings if start_s + SETTLING_S < r.time_s < end_s and r.touch]
            force = np.median([r.force_n for r in touched])
            location = np.median([r.location_mm for r in touched])
            print(f"{name:>14}: {force:5.2f} N at {location:5.2f} mm")
    # The paper gives the step from group to group: their product is the change since the start.
    ratios = {
        "paper": np.cumprod(np.reshape(flowgraph.steps_of_paper.data(), (-1, 2)), axis=0),
        "this project": np.reshape(flowgraph.ratios.data(), (-1, 2)),
    }
    print("phase changes after the last release:")
    for name, changes in ratios.items():
        ends = np.degrees(np.angle(changes[-1]))
        print(f"{name:>14}: end 1 {ends[0]:+7.2f} deg, end 2 {ends[1]:+7.2f} deg")


def main():
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # end quietly with `| head`
    scene = wiforce.load_scene("tabletop")
    flowgraph = ChainSimulated(scene)
    flowgraph.run()
    flowgraph.chain.check()
    for reading in flowgraph.readings:
        print_reading(reading)
    print_spectrum(flowgraph, scene)
    print_comparison(flowgraph)


if __name__ == "__main__":
    start(main)
