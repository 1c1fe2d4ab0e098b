# SPDX-License-Identifier: GPL-3.0-or-later
"""A short press as captured samples, and a source of them for flowgraphs."""

from collections import defaultdict
from contextlib import contextmanager

import numpy as np
import pmt
from gnuradio import blocks, gr, wiforce
from gnuradio.wiforce.blocks import names
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate

# A quarter of the usual rate costs a quarter of the time; a phase group lasts 36 ms, as usual.
RATE_HZ, FRAME, SNAPSHOTS = 3.2e6, 360, 320
# Samples of a phase group.
GROUP = SNAPSHOTS * FRAME

# A slow radio takes a fifth of the time of the usual one; groups last as long.
SLOW = {
    "radio": {"sample_rate_hz": 2.5e6},
    "sounding": {"frame_length": 360},
    "phase_group": {"snapshots": 250},
    "sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 670}],
}
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


def press_codes(folder, scene=SCENE):
    """ADC codes of a scene's capture, which is written to ``folder``; int16, shape (n, 2)."""
    simulate(load_scene(scene), folder / "press")
    return codes_of(folder / "press")


def codes_of(capture):
    """ADC codes of a capture by its name; int16, shape (n, 2)."""
    return np.fromfile(f"{capture}.sigmf-data", "<i2").reshape(-1, 2)


class array_source(gr.sync_block):
    """Emits the items of an array, ``packet`` at once at most, with tags: (offset, key, value)."""

    def __init__(self, items, tags=(), packet=None):
        shape = (items.dtype, items.shape[1]) if items.ndim == 2 else items.dtype
        gr.sync_block.__init__(self, "array_source", in_sig=None, out_sig=[shape])
        self._items = items
        self._tags = list(tags)
        self._at = 0
        if packet is not None:
            self.set_max_noutput_items(packet)

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


@contextmanager
def running(flowgraph):
    """Within the block, a flowgraph runs."""
    flowgraph.start()
    try:
        yield
    finally:
        flowgraph.stop()
        flowgraph.wait()


class Run:
    """What blocks in a row, the last of which gives complex vectors, give to their end.

    In place of the first one, several sources may be given for the inputs of the second.
    ``items``: (n, length). ``tags``: values by their key, and by the offset of the item.
    ``incomplete``: (group, mask, snapshots) of each group that was announced as incomplete.
    """

    def __init__(self, first, *chain):
        chain = [*chain] if isinstance(first, tuple) else [first, *chain]
        length = chain[-1].output_signature().sizeof_stream_item(0) // gr.sizeof_gr_complex
        sink, messages = blocks.vector_sink_c(length), blocks.message_debug()
        flowgraph = gr.top_block()
        flowgraph.connect(*chain, sink)
        for port, source in enumerate(first if isinstance(first, tuple) else ()):
            flowgraph.connect(source, (chain[0], port))
        for block in chain:
            if names.INCOMPLETE in pmt.to_python(block.message_ports_out()):
                flowgraph.msg_connect((block, names.INCOMPLETE), (messages, "store"))
        flowgraph.run()
        self.items = np.array(sink.data(), np.complex64).reshape(-1, length)
        self.tags = defaultdict(dict)
        for tag in sink.tags():
            self.tags[str(tag.key)][tag.offset] = _plain(tag.value)
        self.incomplete = [
            _incomplete(messages.get_message(n)) for n in range(messages.num_messages())
        ]


def _plain(value):
    """Value of a tag as a number or a list; another one as it is."""
    for kind in ("f32", "c32", "u8", "u64"):
        if getattr(pmt, f"is_{kind}vector")(value):
            return list(getattr(pmt, f"{kind}vector_elements")(value))
    return pmt.to_uint64(value) if pmt.is_uint64(value) else value


def _incomplete(message):
    about, snapshots = pmt.car(message), pmt.cdr(message)
    group, mask = (
        pmt.dict_ref(about, pmt.intern(key), pmt.PMT_NIL) for key in (names.GROUP, names.MASK)
    )
    mask = np.array(pmt.u8vector_elements(mask), bool)
    snapshots = np.array(pmt.c32vector_elements(snapshots), np.complex64)
    return pmt.to_uint64(group), mask, snapshots.reshape(len(mask), -1)


def counted_on(tagged, count):
    """Numbers of so many items, of which those are tagged that do not follow on."""
    found, number = [], None
    for n in range(count):
        number = tagged.get(n, None if number is None else number + 1)
        found.append(number)
    return found


def cut(samples, kept):
    """What a file holds of the (first, last) runs of a stream that are kept, and its segments."""
    parts = [samples[first:last] for first, last in kept]
    starts = np.cumsum([0, *map(len, parts)])
    base = 10**6  # of the device's count
    segments = [
        (int(at), base + first, last - first)
        for at, (first, last) in zip(starts, kept, strict=False)
    ]
    return np.concatenate(parts), segments
