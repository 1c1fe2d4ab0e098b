# SPDX-License-Identifier: GPL-3.0-or-later
"""Streams through unmodified gr-uhd and UHD: every sample, every tag, every fault."""

import numpy as np
import pmt
import pytest
from gnuradio import blocks, gr, uhd
from wiforce_app.radio.streams import Progress

RATE = 12.5e6
START_S = 2.0  # far enough ahead for a busy machine


class TagRecorder(gr.sync_block):
    """Collects the stream tags that pass."""

    def __init__(self):
        gr.sync_block.__init__(self, "tag recorder", [(np.int16, 2)], None)
        self.tags = []

    def work(self, inputs, _):
        self.tags += self.get_tags_in_window(0, 0, len(inputs[0]))
        return len(inputs[0])

    def times(self):
        """Offset to time in samples, of the rx_time tags."""
        found = {}
        for tag in self.tags:
            if str(tag.key) == "rx_time":
                seconds = pmt.to_uint64(pmt.tuple_ref(tag.value, 0))
                fraction = pmt.to_double(pmt.tuple_ref(tag.value, 1))
                found[tag.offset] = round((seconds + fraction) * RATE)
        return found


def record(args, count, path):
    """Counter values and rx_time tags of a timed reception through gr-uhd."""
    stream = uhd.stream_args(cpu_format="sc16", otw_format="sc16", channels=[0])
    source = uhd.usrp_source(f"{args},recv_frame_size=8000", stream)
    source.set_samp_rate(RATE)
    source.set_time_now(uhd.time_spec(0))
    source.set_start_time(uhd.time_spec(START_S))
    head, sink, recorder = blocks.head(4, count), blocks.file_sink(4, str(path)), TagRecorder()
    flowgraph = gr.top_block()
    flowgraph.connect(source, head, sink)
    flowgraph.connect(head, recorder)
    flowgraph.run()
    sink.close()
    pairs = np.fromfile(path, np.int16).reshape(-1, 2)
    values = pairs[:, 0].astype(np.uint16).astype(np.int64) | pairs[:, 1].astype(np.int64) << 16
    return values, recorder.times()


def test_stream_new_time_states_the_loss(software_usrp, tmp_path):
    device, lost = software_usrp("--air", "counter", faults=["+0.1 overflow 3630"]), 3630
    values, times = record(device.args, 2_000_000, tmp_path / "ramp")
    (start, first), (offset, resumed) = times.items()
    assert (start, first) == (0, START_S * RATE)
    assert offset == 0.1 * RATE and resumed - first - offset == lost
    # The counter holds device time: what is left is whole, and the tag tells the truth.
    assert np.array_equal(values[:offset], first + np.arange(offset))
    assert np.array_equal(values[offset:], resumed + np.arange(2_000_000 - offset))
    assert device.command("status")["rx_dropped_samples"] == lost


def test_a_process_that_was_stopped_does_not_take_its_device_for_lost():
    """After `kill -STOP`, or on a busy machine, a reader ended although all was well."""
    now = [0.0]
    progress = Progress(lambda: now[0])
    progress.still_s(7)
    found = []
    for passed_s in (0.02, 0.02, 6.0, 0.02):
        now[0] += passed_s
        found.append(progress.still_s(7))
    assert found == pytest.approx([0.02, 0.04, 0.24, 0.26])
    assert progress.still_s(8) == 0
