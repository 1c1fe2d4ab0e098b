# SPDX-License-Identifier: GPL-3.0-or-later
"""preamble_fold against a plain numpy reference: values, tags, offsets, lost samples."""

import numpy as np
import pmt
import pytest
from gnuradio import blocks, gr

from gnuradio import wiforce


def rx_time(offset, seconds):
    whole = int(np.floor(seconds))
    value = pmt.make_tuple(pmt.from_uint64(whole), pmt.from_double(seconds - whole))
    return gr.tag_utils.python_to_tag((offset, pmt.intern("rx_time"), value, pmt.PMT_F))


def run_fold(samples, tags=(), chunk=None, **parameters):
    """Folded vectors, {offset: snapshot} and the block, after a run over the samples."""
    fold = wiforce.preamble_fold(**parameters)
    if parameters.get("item_type") == "sc16":
        # vector_source has no complex int16: pairs of shorts have its layout.
        pairs = np.asarray(samples, np.int16).reshape(-1)
        source = blocks.vector_source_s(pairs.tolist(), False, 2, list(tags))
    else:
        source = blocks.vector_source_c(np.asarray(samples).tolist(), False, 1, list(tags))
    sink = blocks.vector_sink_c(64)
    flowgraph = gr.top_block()
    if chunk:
        source.set_max_noutput_items(chunk)
    flowgraph.connect(source, fold, sink)
    flowgraph.run()
    indices = {t.offset: pmt.to_uint64(t.value) for t in sink.tags() if str(t.key) == "snapshot"}
    return np.array(sink.data()).reshape(-1, 64), indices, fold


def reference_fold(samples, frame_length, first=64, repetitions=4, offset=0):
    """Means of all frames whose averaged part is whole; shape (frames, 64)."""
    length = 64 * repetitions
    starts = range(offset + first, len(samples) - length + 1, frame_length)
    return np.array([samples[s : s + length].reshape(-1, 64).mean(0) for s in starts])


def noise(count, seed=1):
    rng = np.random.default_rng(seed)
    return (rng.normal(size=count) + 1j * rng.normal(size=count)).astype(np.complex64)


@pytest.mark.parametrize("chunk", [None, 1, 63, 364, 721])
@pytest.mark.parametrize(
    "layout", [(720, 64, 4, 0), (320, 64, 4, 5), (720, 192, 2, 719), (333, 13, 5, 2000)]
)
def test_folded_vectors_are_the_means_whatever_the_packet_size(layout, chunk):
    frame_length, first, repetitions, offset = layout
    samples = noise(12 * 720 + 17)
    folded, indices, fold = run_fold(
        samples,
        chunk=chunk,
        frame_length=frame_length,
        first_averaged=first,
        repetitions=repetitions,
        frame_offset=offset,
    )
    want = reference_fold(samples, frame_length, first, repetitions, offset)
    assert folded.shape == want.shape
    np.testing.assert_allclose(folded, want, atol=1e-6)  # a few ulp of values near 1
    assert indices == {0: 0}
    assert fold.snapshots() == len(want)
    assert fold.gaps() == fold.samples_lost() == 0
