# SPDX-License-Identifier: GPL-3.0-or-later
"""recording_source against numpy, and against the stream blocks that it stands for."""

import numpy as np
import pmt
import pytest
from device_times import rx_time
from gnuradio import blocks, gr, wiforce
from gnuradio.wiforce.blocks import names
from press_capture import Run, array_source, counted_on, cut

FRAME = 720


def random_samples(count, datatype, seed=1):
    rng = np.random.default_rng(seed)
    if datatype == "ci16_le":
        return rng.integers(-32768, 32768, size=(count, 2)).astype("<i2")
    return rng.normal(size=(count, 2)).astype("<f4")


def as_complex(samples):
    scale = 32768 if samples.dtype == np.int16 else 1
    return (samples[:, 0] + 1j * samples[:, 1]) / scale


def run(*chain):
    """Output and tags {key: {offset: value}} of a chain."""
    found = Run(*chain)
    found.tags.pop(names.NOISE, None)  # held to a reference in qa_interference.py
    return found.items, found.tags


def whole_frames(kept, offset, first, length):
    """Frames of the grid whose averaged samples all lie in one kept run."""
    begin = kept[0][0]
    frames = []
    for start, end in kept:
        for f in range((end - begin) // FRAME + 1):
            at = begin + offset + f * FRAME + first
            if start <= at and at + length <= end:
                frames.append(f)
    return frames


KEPT = {
    "whole": [(0, 30 * FRAME)],
    "ends inside a preamble": [(0, 30 * FRAME + 250)],
    "gap in a preamble": [(0, 5 * FRAME + 100), (5 * FRAME + 110, 20 * FRAME)],
    "gap in a guard": [(0, 5 * FRAME + 400), (5 * FRAME + 410, 20 * FRAME)],
    "many gaps": [(3, 90), (95, 2000), (9000, 9100), (9500, 17000), (17001, 25000)],
}


@pytest.mark.parametrize("datatype", ["ci16_le", "cf32_le"])
@pytest.mark.parametrize("offset", [0, 431])
@pytest.mark.parametrize("kept", KEPT)
def test_folded_vectors_and_indices_follow_the_grid_over_gaps(tmp_path, datatype, offset, kept):
    samples = random_samples(40 * FRAME, datatype)
    data, segments = cut(samples, KEPT[kept])
    path = tmp_path / "x.sigmf-data"
    path.write_bytes(b"7 bytes" + data.tobytes())
    source = wiforce.recording_source(
        str(path), datatype, segments, FRAME, frame_offset=offset, header_bytes=7
    )
    folded, tags = run(source)
    frames = whole_frames(KEPT[kept], offset, 64, 256)
    base = KEPT[kept][0][0] + offset + 64
    signal = as_complex(samples)
    want = np.array([signal[base + f * FRAME :][:256].reshape(4, 64).mean(0) for f in frames])
    np.testing.assert_allclose(folded, want, atol=1e-6)  # a few ulp of values near 1
    assert counted_on(tags["snapshot"], len(folded)) == frames
    assert source.snapshots() == len(frames)
    assert source.samples_missing() == 0


@pytest.mark.parametrize(
    ("samples", "held", "frames"), [(10 * FRAME, 7 * FRAME + 100, 7), (319, 319, 0)]
)
def test_a_file_cut_short_is_read_as_far_as_it_goes(tmp_path, samples, held, frames):
    path = tmp_path / "x.bin"
    path.write_bytes(random_samples(samples, "cf32_le").tobytes()[: 8 * held + 3])
    source = wiforce.recording_source(str(path), "cf32_le", [(0, 0, samples)], FRAME)
    folded, _ = run(source)
    assert len(folded) == frames
    assert source.samples_missing() == samples - held


@pytest.mark.parametrize("segment", [(0, 0), (0, 0, 1, 0, 0)])
def test_a_segment_of_another_length_is_named(tmp_path, segment):
    (tmp_path / "x.bin").write_bytes(bytes(8))
    with pytest.raises(ValueError, match="segments must have 3 or 4 numbers each, got"):
        wiforce.recording_source(str(tmp_path / "x.bin"), "ci16_le", [segment], FRAME)


def test_indices_stay_true_when_the_flowgraph_is_started_again(tmp_path):
    """Vectors in buffers are lost then: all readings that followed were early."""
    frames = 20_000
    samples = np.repeat(np.arange(frames, dtype="<i2"), 2 * FRAME).reshape(-1, 2)
    (tmp_path / "x.bin").write_bytes(samples.tobytes())
    source = wiforce.recording_source(
        str(tmp_path / "x.bin"), "ci16_le", [(0, 0, len(samples))], FRAME
    )
    head, sink = blocks.head(64 * gr.sizeof_gr_complex, 100), blocks.vector_sink_c(64)
    flowgraph = gr.top_block()
    flowgraph.connect(source, head, sink)
    for first_run in (True, False):
        flowgraph.run()
        tags = {
            tag.offset: pmt.to_uint64(tag.value)
            for tag in sink.tags()
            if str(tag.key) == "snapshot"
        }
        held = np.rint(np.reshape(sink.data(), (100, 64))[:, 0].real * 32768).astype(int)
        assert (held[0] == 0) == first_run
        assert counted_on(tags, 100) == held.tolist()
        head.reset()
        sink.reset()


@pytest.fixture
def logged(capfd):
    """What blocks log, also behind commands in this process, which switch that off."""
    before = gr.logging().default_level()
    gr.logging().set_default_level(gr.log_levels.warn)
    yield capfd
    gr.logging().set_default_level(before)


@pytest.mark.parametrize("datatype, item_type", [("ci16_le", "sc16"), ("cf32_le", "fc32")])
def test_frames_that_move_without_a_tag_are_followed_as_in_a_stream_to_the_last_bit(
    tmp_path, logged, datatype, item_type
):
    length, offset = 96, 41
    rng = np.random.default_rng(5)
    frame = rng.normal(size=(length, 2)) * (np.arange(length) < 70)[:, None]
    sent = 3000 * (np.tile(frame, (4000, 1)) + 0.1 * rng.normal(size=(4000 * length, 2)))
    moved = np.delete(sent, slice(700 * length + 30, 705 * length + 77), axis=0)
    stated, lost = 1800 * length + 7, 993  # and a moment later some come twice
    kept = [moved[:stated], moved[stated + lost : 2400 * length], moved[2399 * length + 9 :]]
    samples = np.concatenate(kept)
    samples = np.rint(samples).astype("<i2") if item_type == "sc16" else samples.astype("<f4")
    path = tmp_path / "x.bin"
    path.write_bytes(samples.tobytes())
    back = stated + lost + 5 * length + 47
    segments = [(0, 0, stated), (stated, back, len(samples) - stated)]
    source = wiforce.recording_source(
        str(path), datatype, segments, length, first_averaged=3, repetitions=1, frame_offset=offset
    )
    folded, tags = run(source)
    # Whole frames that were lost do not show.
    assert "frame timing slipped by 47 samples before frame" in "".join(logged.readouterr())
    times = [(0, 0.0), (stated, back / 12.5e6)]
    want, want_tags = folded_in_a_stream(samples, item_type, times, length, offset)
    np.testing.assert_array_equal(folded, want)
    assert tags == want_tags
    assert len(tags["snapshot"]) == 4  # the start, the gap, and where frames were found again
    assert len(tags["slipped"]) == 2


def folded_in_a_stream(samples, item_type, times, length, offset):
    """Output and tags of preamble_fold on samples with an rx_time at some items."""
    tags = [rx_time(item, seconds) for item, seconds in times]
    if item_type == "fc32":
        samples = (samples[:, 0] + 1j * samples[:, 1]).astype(np.complex64)
    fold = wiforce.preamble_fold(length, 3, 1, frame_offset=offset, item_type=item_type)
    return run(array_source(samples, tags), fold)
