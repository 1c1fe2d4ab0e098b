# SPDX-License-Identifier: GPL-3.0-or-later
"""preamble_fold against a plain numpy reference: values, tags, offsets, lost samples."""

import numpy as np
import pmt
import pytest
from device_times import NO_TIMES, rx_time, tag_at
from gnuradio import blocks, wiforce
from press_capture import Run, array_source, counted_on


def run_fold(samples, tags=(), chunk=None, **parameters):
    """Folded vectors, {offset: snapshot} and the block, after a run over the samples."""
    fold = wiforce.preamble_fold(**parameters)
    run = Run(array_source(samples, tags, chunk), fold)
    return run.items, run.tags["snapshot"], fold


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
    samples = noise(12 * 720 + 320)  # the last frame ends with its averaged part
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


def test_flowgraph_that_is_started_again_reads_tags_from_its_first_item_on():
    """GNU Radio counts items anew then; the tags of before would be searched for far behind."""
    samples = noise(40 * 720)
    source = blocks.vector_source_c(samples.tolist(), False, 1, [rx_time(0, 10.0)])
    fold = wiforce.preamble_fold(720)
    Run(source, fold)
    assert fold.snapshots() == 40 and fold.gaps() == 0
    source.rewind()
    source.set_data(samples.tolist(), [rx_time(0, 20.0)])
    run = Run(source, fold)
    assert fold.gaps() == 1 and fold.samples_lost() == 125_000_000 - len(samples)
    first = 125_000_000 // 720 + 1  # its frame begins within the gap's last frame
    assert first in run.tags["snapshot"].values()


def with_losses(samples, losses, rate, start=1000.25):
    """The samples received after (first lost, number lost), with tags as gr-uhd sets them."""
    keep = np.ones(len(samples), bool)
    tags = [rx_time(0, start)]
    for first, count in losses:
        keep[first : first + count] = False
    for first, count in losses:
        # gr-uhd gives times to a fraction of a sample, not exactly.
        seconds = start + (first + count + 0.3) / rate
        tags.append(rx_time(int(keep[:first].sum()), seconds))
    return samples[keep], tags, keep


@pytest.mark.parametrize("chunk", [None, 100, 719])
@pytest.mark.parametrize(
    "losses",
    [
        [(720 * 3 + 100, 50)],  # inside an averaged part
        [(720 * 3 + 330, 20)],  # in the guard: nothing is lost
        [(720 * 3 + 600, 720)],  # one whole averaged part, in two guards
        [(720 * 2 + 5, 720 * 4 + 77), (720 * 9, 1), (720 * 9 + 200, 2000)],
        [(0 + 10, 5), (30, 800)],  # before the first snapshot
    ],
)
def test_lost_samples_cost_their_snapshots_and_no_others(losses, chunk):
    rate = 12.5e6
    frames = 16
    samples = noise(frames * 720, seed=3)
    received, tags, keep = with_losses(samples, losses, rate)
    whole = [f for f in range(frames) if keep[f * 720 + 64 : f * 720 + 320].all()]
    folded, indices, fold = run_fold(
        received, tags, chunk=chunk, frame_length=720, sample_rate=rate
    )
    np.testing.assert_allclose(folded, reference_fold(samples, 720)[whole], atol=1e-6)
    # The index of every snapshot follows from the tags before it.
    assert counted_on(indices, len(folded)) == whole
    assert fold.gaps() == len(losses)
    assert fold.samples_lost() == sum(count for _, count in losses)


@pytest.mark.parametrize("chunk", [None, 100])
@pytest.mark.parametrize("tagged_late", [False, True])
def test_frames_are_found_again_after_a_loss_without_a_tag(tagged_late, chunk):
    length, lost, at = 96, 5 * 96 + 30, 300 * 96 + 20
    frame = noise(length, 5) * (np.arange(length) < 64)
    sent = np.tile(frame, 1500) + 0.1 * noise(1500 * length, 6)
    samples = np.delete(sent, slice(at, at + lost))
    tags = [rx_time(0, 2.5)]
    if tagged_late:
        tags.append(rx_time(1300 * length, 2.5 + (1300 * length + lost) / 12.5e6))
    folded, indices, fold = run_fold(
        samples, tags, chunk, frame_length=length, first_averaged=0, repetitions=1
    )
    there = np.abs(folded - frame[:64]).max(axis=1) < 1
    # Lost frames are on the count only where a tag tells of them, sooner or later.
    assert fold.frames_moved() == 1 and fold.samples_moved() == lost % length
    assert fold.samples_lost() == (lost - lost % length if tagged_late else 0)
    assert fold.gaps() == tagged_late
    assert there[:300].all() and not there[300:500].any()
    back = 300 + np.argmax(there[300:])
    assert back < 1100 and there[back:].all()
    assert indices[back] == back + 1  # one frame was cut
    assert 0 not in np.diff(list(indices.values()))


@pytest.mark.parametrize("item_type", ["fc32", "sc16"])
@pytest.mark.parametrize("chunk", [None, 364])
def test_tones_in_one_thread_are_those_of_two_blocks_to_the_bit(chunk, item_type):
    group_length, rate = 8, 12.5e6
    rng = np.random.default_rng(4)
    samples = rng.integers(-2000, 2000, size=(90 * 720, 2)).astype(np.int16)
    # In a group, over whole groups, and in a guard.
    losses = [(720 * 11 + 100, 1500), (720 * 30 + 70, 720 * 20), (720 * 70 + 400, 30)]
    received, times, _ = with_losses(samples, losses, rate)
    retuned = [tag_at(tag.offset, "retuned", pmt.from_uint64(1)) for tag in times[1:]]
    tags = sorted([*times, *retuned], key=lambda tag: tag.offset)
    if item_type == "fc32":
        received = (received[:, 0] + 1j * received[:, 1]).astype(np.complex64)
        received[720 * 40 + 99] = np.nan
    weights = rng.normal(size=(3, group_length)) + 1j * rng.normal(size=(3, group_length))
    parameters = {"frame_length": 720, "sample_rate": rate, "item_type": item_type}
    two = [wiforce.preamble_fold(**parameters), wiforce.phase_group_doppler(weights, group_length)]
    one = [wiforce.preamble_fold.tones(weights, group_length, **parameters)]
    want, found = (Run(array_source(received, tags, chunk), *chain) for chain in (two, one))
    np.testing.assert_array_equal(found.items, want.items)
    assert found.tags == want.tags
    # The groups before whole ones that are lost were received with the former settings.
    assert [found.tags["group"][item] for item in found.tags["retuned"]] == [1, 6, 8]
    for group, same in zip(found.incomplete, want.incomplete, strict=True):
        for value, of_same in zip(group, same, strict=True):
            np.testing.assert_array_equal(value, of_same)
    assert len(want.items) == 9  # of 11: two whole groups are lost
    assert len(want.incomplete) == (4 if item_type == "fc32" else 3)
    assert one[0].gaps() == two[0].gaps() == 3
    assert one[0].snapshots() == two[0].snapshots()


@pytest.mark.parametrize("chunk", [None, 364])
def test_collected_groups_hold_the_snapshots_with_their_mask(chunk):
    """The room is surveyed in them, and the tones are computed from them."""
    length, rate = 8, 12.5e6
    samples = np.random.default_rng(5).integers(-2000, 2000, size=(90 * 720, 2)).astype(np.int16)
    received, tags, _ = with_losses(samples, [(720 * 11 + 100, 1500), (720 * 30, 720 * 20)], rate)
    parameters = {"frame_length": 720, "sample_rate": rate, "item_type": "sc16"}
    two = [wiforce.preamble_fold(**parameters), wiforce.phase_group_doppler.collected(length)]
    one = [wiforce.preamble_fold.collected(length, **parameters)]
    for collecting in (one[0], two[1]):  # no port that never sends anything
        assert not pmt.to_python(collecting.message_ports_out())
    folded, snapshots, _ = run_fold(received, tags, chunk, **parameters)
    by_snapshot = dict(zip(counted_on(snapshots, len(folded)), folded, strict=True))
    for chain in (one, two):
        run = Run(array_source(received, tags, chunk), *chain)
        assert len(run.items) == 9
        for row, item in enumerate(run.items.reshape(-1, length, 64)):
            first = run.tags["group"][row] * length
            present = np.array([first + n in by_snapshot for n in range(length)])
            assert run.tags["mask"].get(row, [1] * length) == present.tolist()
            assert run.tags["missing"].get(row, 0) == np.sum(~present)
            for n in np.flatnonzero(present):
                np.testing.assert_array_equal(item[n], by_snapshot[first + n])
            assert not item[~present].any()


@pytest.mark.parametrize(("chunk", "offset"), [(None, 0), (777, 5)])
def test_mean_frame_is_that_of_the_first_frames_with_their_guards(chunk, offset):
    """Compression of the receiver shows in the guards only."""
    samples = noise(1003 * 90)
    fold = run_fold(
        samples, chunk=chunk, frame_length=90, repetitions=1, first_averaged=0, frame_offset=offset
    )[2]
    frames = samples[offset : offset + 1000 * 90].reshape(1000, 90)
    np.testing.assert_allclose(fold.mean_frame(), frames.mean(axis=0), rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("frames", [998, 1003])
def test_mean_frame_is_empty_without_all_frames(frames):
    """A mean over frames at different places shows what was never received."""
    samples, tags = noise(frames * 90), []
    if frames > 1000:
        samples, tags, _ = with_losses(samples, [(400 * 90 + 7, 33)], 12.5e6)
    fold = run_fold(samples, tags, frame_length=90, repetitions=1, first_averaged=0)[2]
    assert len(fold.mean_frame()) == 0


def test_a_collected_group_goes_on_after_a_stop():
    """The memory in which a group begins is given back when a flowgraph stops."""
    samples, length = noise(10 * 720), 4
    frames, *_ = run_fold(samples, frame_length=720)
    source = blocks.vector_source_c(samples.tolist())
    fold = wiforce.preamble_fold.collected(length, frame_length=720)
    for first, groups in ((0, 2), (8, 3)):
        found = Run(source, fold).items
        source.rewind()
        want = frames[(np.arange(groups * length) + first) % len(frames)]
        assert np.array_equal(found.reshape(-1, 64), want)


def test_times_that_are_no_times_are_ignored_and_counted():
    tags = [rx_time(0, 1.0)]
    for number, value in enumerate(NO_TIMES.values()):
        tags.append(tag_at(3000 + number, "rx_time", value))
    folded, _, fold = run_fold(noise(10 * 720), tags, frame_length=720)
    assert len(folded) == 10
    assert fold.gaps() == 0 and fold.times_ignored() == len(NO_TIMES)
