# SPDX-License-Identifier: GPL-3.0-or-later
"""A short press as captured samples, and a source of them for flowgraphs."""

import numpy as np
import pmt
from gnuradio import gr, wiforce
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate

# A quarter of the usual rate costs a quarter of the time; a phase group lasts 36 ms, as usual.
RATE_HZ, FRAME, SNAPSHOTS = 3.2e6, 360, 320
# Samples of a phase group.
GROUP = SNAPSHOTS * FRAME

# As sampled unless a scene states otherwise.
DEFAULT = {
    "sensors": [{"name": "arm", "model": "line-900mhz"}],
    "reference_s": 0.3,
    "simulation": {
        "truth_model": "line-900mhz",
        "duration_s": 0.9,
        "seed": 4,
        "snr_db": 10,
        "static_clutter_db": 50,
        "clock_offset_ppm": -60,
        "presses": [
            {"start_s": 0.5, "rise_s": 0.02, "hold_s": 0.3, "force_n": 4.0, "location_mm": 37.0}
        ],
    },
}
SCENE = DEFAULT | {
    "radio": {"sample_rate_hz": RATE_HZ},
    "sounding": {"frame_length": FRAME},
    "phase_group": {"snapshots": SNAPSHOTS},
}


def press_codes(folder):
    """ADC codes of the scene's capture, which is written to ``folder``; int16, shape (n, 2)."""
    simulate(load_scene(SCENE), folder / "press")
    return codes_of(folder / "press")


def codes_of(capture):
    """ADC codes of a capture by its name; int16, shape (n, 2)."""
    return np.fromfile(f"{capture}.sigmf-data", "<i2").reshape(-1, 2)


class array_source(gr.sync_block):
    """Emits the items of an array, with tags: (offset, key, value)."""

    def __init__(self, items, tags=()):
        shape = (items.dtype, items.shape[1]) if items.ndim == 2 else items.dtype
        gr.sync_block.__init__(self, "array_source", in_sig=None, out_sig=[shape])
        self._items = items
        self._tags = list(tags)
        self._at = 0

    def work(self, input_items, output_items):
        count = min(len(output_items[0]), len(self._items) - self._at)
        if count == 0:
            return -1
        output_items[0][:count] = self._items[self._at : self._at + count]
        while self._tags and self._tags[0].offset < self._at + count:
            tag = self._tags.pop(0)
            self.add_item_tag(0, tag.offset, tag.key, tag.value)
        self._at += count
        return count


def as_floats(codes):
    """ADC codes as complex64 of full scale 1."""
    return codes.astype(np.float32).view(np.complex64).ravel() / 32768


def source_of(capture, scene, input_type="sc16"):
    """Samples of a capture, or its folded frames, for a reader of this type of input."""
    if input_type == "folded":
        return wiforce.capture_source(capture, scene)
    codes = codes_of(capture)
    return array_source(codes if input_type == "sc16" else as_floats(codes))


def run_flowgraph(*chain):
    """Connect blocks in a row, and run them to their end."""
    flowgraph = gr.top_block()
    flowgraph.connect(*chain)
    flowgraph.run()


def numbers_in(sink, key):
    """Whole numbers in the tags of a sink, by the offset of their items."""
    return {tag.offset: pmt.to_uint64(tag.value) for tag in sink.tags() if str(tag.key) == key}


def counted_on(tagged, count):
    """Numbers of so many items, of which those are tagged that do not follow on."""
    found, number = [], None
    for n in range(count):
        number = tagged.get(n, None if number is None else number + 1)
        found.append(number)
    return found
