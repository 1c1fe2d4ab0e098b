# SPDX-License-Identifier: GPL-3.0-or-later
"""A flowgraph that is tared, asked and set all the while it runs, for the thread sanitizer.

./bootstrap sanitize
"""

import numpy as np
from gnuradio import blocks, gr, wiforce

SECONDS = 1.5
RATE = 12.5e6
SCENE = {"sensors": [{"name": "arm", "model": "line-900mhz"}], "reference_s": 0.2}


def main():
    """Runs it; raises what the chain raised, and where a group is missing from the count."""
    rng, readings = np.random.default_rng(1), []
    source, tag = wiforce.sounding_source(), wiforce.backscatter_tag(static_clutter_db=40)
    head = blocks.head(gr.sizeof_gr_complex, int(SECONDS * RATE))
    reader = wiforce.reader(SCENE, on_reading=readings.append)
    flowgraph = gr.top_block()
    flowgraph.connect(source, tag, head, reader)
    flowgraph.start()
    while not reader.ended.wait(0.001):
        tag.set_force_n(rng.uniform(0, 8))
        tag.set_location_mm(rng.uniform(20, 60))
        tag.set_clock_offset_ppm(rng.uniform(-100, 100))
        tag.set_snr_db(rng.uniform(0, 20))
        tag.set_on(rng.random() < 0.9)
        source.set_amplitude(rng.uniform(0.2, 0.5))
        if rng.random() < 0.02:
            reader.tare()
        reader.fold.snapshots(), reader.fold.gaps(), reader.fold.samples_lost()
        reader.fold.frames_moved(), reader.fold.samples_moved(), reader.fold.times_ignored()
    flowgraph.wait()
    if reader.failure is not None:
        raise reader.failure
    counted = reader.counts.groups
    if not counted == len(readings) == int(SECONDS * RATE) // (720 * 625):
        raise ValueError(f"{counted} groups counted, {len(readings)} read")
    print(f"{counted} groups, tared and set while they were read")


if __name__ == "__main__":
    main()
