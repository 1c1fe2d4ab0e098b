# SPDX-License-Identifier: GPL-3.0-or-later
"""What latency is measured with: packets in full, times in order and never early."""

import time

import pytest
from gnuradio import blocks, gr
from gnuradio.wiforce.wiforce_bench import paced_source
from wiforce_app.bench.throughput.recording import GROUP_SAMPLES, tone_weights
from wiforce_app.bench.throughput.stream import ToneSink, collected_groups


@pytest.mark.parametrize("packet", [1, 364, 5000])
def test_marked_samples_go_out_in_order_and_not_before_their_time(packet):
    rate, every, count = 1e5, 1000, 10_000
    source, sink = paced_source(packet, rate, every, count), blocks.vector_sink_c()
    flowgraph = gr.top_block()
    flowgraph.connect(source, sink)
    before = time.monotonic()
    flowgraph.run()
    sent = -(-count // packet) * packet
    assert len(sink.data()) == sent
    assert not any(sink.data())
    marks = source.mark_times()
    assert len(marks) == sent // every
    assert marks == sorted(marks)
    for n, mark in enumerate(marks):
        assert mark - before >= (n + 1) * every / rate


def test_tones_of_every_group_have_a_time_after_their_last_sample():
    source = paced_source(364, 12.5e6, GROUP_SAMPLES, 8 * GROUP_SAMPLES)
    flowgraph, sink = gr.top_block(), ToneSink(tone_weights(4))
    flowgraph.connect(source, collected_groups("fc32"), sink)
    began = time.monotonic()
    flowgraph.run()
    sent, came = source.mark_times(), sink.times
    assert sink.failure is None and len(came) == len(sent) == 8
    assert came == sorted(came)
    # A mark is late where the thread of the source has to wait; the guard of the last frame is not
    # waited for.
    for group, after in enumerate(came):
        assert after - began >= ((group + 1) * GROUP_SAMPLES - 720) / 12.5e6


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0, 1.0, 1, 1), "packet_length must be >= 1, got 0"),
        ((1, 0.0, 1, 1), "sample_rate must be positive, got 0"),
        ((1, 1.0, 0, 1), "mark_every must be >= 1, got 0"),
        ((1, 1.0, 1, 1, 0), "item_size must be >= 1, got 0"),
    ],
)
def test_bad_parameters_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        paced_source(*arguments)
