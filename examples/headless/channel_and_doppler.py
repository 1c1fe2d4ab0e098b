#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Inside the receiver: the channel H[k, n], its Doppler spectrum and the clock of the tag.

Prints the power of the room, of the lines of the tag and of the noise, and the clock offset that
the receiver found. The same as channel_and_doppler.grc, without a window.
"""

import numpy as np
from gnuradio import blocks, gr, wiforce

GROUP_LENGTH = 625  # snapshots, so that the lines of the tag fall on whole bins
CLOCK_OFFSET_PPM = 40.0
DURATION_S = 2.0


def main():
    scene = wiforce.load_scene("tabletop")
    rate, frame_length = scene.radio.sample_rate_hz, scene.sounding.frame_length
    clock_hz = scene.sensors[0].clock_hz
    equalizer = scene.waveform().equalizer()
    plan = wiforce.plan(scene, snapshots=GROUP_LENGTH)

    flowgraph = gr.top_block("channel_and_doppler", catch_exceptions=False)
    sounder = wiforce.sounding_source(frame_length=frame_length, sample_rate=rate)
    stop_after = blocks.head(gr.sizeof_gr_complex, int(DURATION_S * rate))
    tag = wiforce.backscatter_tag(
        model="line-900mhz",
        clock_hz=clock_hz,
        clock_offset_ppm=CLOCK_OFFSET_PPM,
        snr_db=20,
        static_clutter_db=50,
        sample_rate=rate,
        frame_length=frame_length,
    )
    fold = wiforce.preamble_fold(frame_length=frame_length, sample_rate=rate)
    flowgraph.connect(sounder, stop_after, tag, fold)

    # H[k, n]: one snapshot of the channel per frame.
    channel = wiforce.ofdm_channel_estimator(factors=equalizer)
    snapshots = blocks.vector_sink_c(64)
    flowgraph.connect(fold, channel, snapshots)

    # The Doppler spectrum: the Fourier transform over a group of snapshots.
    spectrum = wiforce.phase_group_doppler.spectrum(group_length=GROUP_LENGTH)
    spectra = blocks.vector_sink_c(64 * GROUP_LENGTH)
    flowgraph.connect(fold, spectrum, spectra)

    # Only the lines of the tag, from which its clock is tracked.
    tones = wiforce.phase_group_doppler(weights=plan.table.weights, group_length=GROUP_LENGTH)
    tone_channel = wiforce.ofdm_channel_estimator(
        factors=equalizer,
        rows=len(plan.table.tones),
        rotation=plan.table.derotation(rate),
    )
    separation = wiforce.end_separation(plan)
    offset = wiforce.clock_offset()
    offsets = blocks.vector_sink_f()
    flowgraph.connect(fold, tones, tone_channel, separation, offset, offsets)
    flowgraph.msg_connect(tones, "incomplete", separation, "incomplete")
    flowgraph.run()

    h = np.reshape(snapshots.data(), (-1, 64))
    print(f"H[k,n]: {len(h)} snapshots of 64 subcarriers, mean |H| {np.abs(h[:, 1:32]).mean():.3f}")
    p = np.reshape(spectra.data(), (-1, GROUP_LENGTH, 64))[-1]
    power_db = 10 * np.log10(np.sum(np.abs(p) ** 2, axis=1))
    for m, name in ((0, "room"), (1, "end 1"), (2, "both"), (4, "end 2")):
        row = round(m * clock_hz * GROUP_LENGTH * scene.snapshot_period_s)
        print(f"Doppler {m * clock_hz:6.0f} Hz: {power_db[row]:6.1f} dB  ({name})")
    print(f"noise: {np.median(power_db):6.1f} dB")
    print(f"tag clock: {offsets.data()[-1]:+.2f} ppm found, {CLOCK_OFFSET_PPM:+.2f} ppm set")


if __name__ == "__main__":
    main()
