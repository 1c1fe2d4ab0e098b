# SPDX-License-Identifier: GPL-3.0-or-later
"""tone_reader and folded_reader against the blocks that they stand for."""

import os
import subprocess
import threading

import numpy as np
import pytest
from gnuradio import wiforce
from gnuradio.wiforce import wiforce_kernels
from gnuradio.wiforce.signal.waveform import sounding_waveform
from gnuradio.wiforce.wiforce_kernels import folded_reader, tone_reader
from long_cases import cases
from press_capture import Run, counted_on, cut

FRAME, GROUP, TONES = 720, 6, 5
WAVEFORM = sounding_waveform()

KEPT = {
    "whole": [(0, 100 * FRAME)],
    "gaps in groups": [(0, 5 * FRAME + 100), (5 * FRAME + 110, 61 * FRAME + 250)],
    "lost groups": [(3, 20_000), (40_000, 41_000), (45_000, 70_000)],
    "retuned": [(0, 20_000), (20_000, 20_050), (21_000, 41_000), (45_000, 70_000)],
}


@pytest.fixture(params=[(d, k) for d in ("ci16_le", "cf32_le") for k in KEPT], ids=str)
def capture(request, tmp_path):
    """(path, datatype, segments, frame length) of a file with gaps, some samples not finite."""
    datatype, kept = request.param
    rng = np.random.default_rng(1)
    samples = rng.integers(-32768, 32768, size=(100 * FRAME, 2)).astype("<i2")
    if datatype == "cf32_le":
        samples = samples.astype("<f4") / 32768
        samples[30 * FRAME + 70] = np.nan
    data, segments = cut(samples, KEPT[kept])
    if kept == "retuned":
        segments = [(*segment, n in (1, 3)) for n, segment in enumerate(segments)]
    (tmp_path / "x.bin").write_bytes(data.tobytes())
    return str(tmp_path / "x.bin"), datatype, segments, FRAME


@pytest.fixture(scope="module")
def settings():
    """Weights, factors, rotation and bins."""
    rng = np.random.default_rng(3)
    weights = rng.normal(size=(TONES, GROUP)) + 1j * rng.normal(size=(TONES, GROUP))
    rotation = np.exp(2j * np.pi * rng.random((TONES, 64)))
    return weights, WAVEFORM.equalizer(), rotation, WAVEFORM.bins


def batches(read, size):
    """Everything a reader gives, in batches of at most ``size``."""
    found = [read(size)]
    while len(found[-1]["saturated"]):
        found.append(read(size))
    return found


@pytest.mark.parametrize("batch_size", [1, 4, 1000])
def test_tone_reader_over_gaps_gives_what_the_flowgraph_gives(capture, settings, batch_size):
    weights, factors, rotation, bins = settings
    reader = tone_reader(*capture, 64, 4, 0, 64, *settings)
    incomplete = []  # index, mask, folded snapshots

    def read(size):
        before = len(incomplete)
        found = reader.read(size, lambda *group: incomplete.append(group))
        incomplete[before:] = [(found["index"][row], *rest) for row, *rest in incomplete[before:]]
        return found

    found = batches(read, batch_size)
    index, missing, saturated, tones = (
        np.concatenate([batch[key] for batch in found])
        for key in ("index", "missing", "saturated", "tones")
    )
    source = wiforce.recording_source(*capture)
    doppler = wiforce.phase_group_doppler(weights, GROUP)
    estimator = wiforce.ofdm_channel_estimator(factors, TONES, rotation)
    run = Run(source, doppler, estimator)
    want = run.items.reshape(-1, TONES, 64)[:, :, bins]
    assert tones.dtype == np.complex64 and tones.shape == want.shape
    np.testing.assert_array_equal(tones, want)
    for key, values in (("group", index), ("missing", missing), ("saturated", saturated)):
        assert values.tolist() == [run.tags[key].get(n, 0) for n in range(len(want))], key
    # The runs of the file that hold no whole frame are marked at the next one.
    retuned = [frame // GROUP for frame in reader.retuned()]
    assert retuned == [index[item] for item in run.tags["retuned"]]
    assert retuned == ([5, 10] if len(capture[2]) == 4 else [])
    assert len(index) > 5
    assert reader.snapshots() == source.snapshots()
    assert reader.samples_missing() == reader.frames_moved() == 0

    for (group, mask, folded), announced in zip(incomplete, run.incomplete, strict=True):
        assert (
            group == announced[0] and mask.dtype == bool and mask.tolist() == announced[1].tolist()
        )
        np.testing.assert_array_equal(folded, announced[2][mask])


@pytest.mark.parametrize("batch_size", [1, 7, 1000])
def test_folded_reader_over_gaps_gives_what_the_block_gives(capture, batch_size):
    reader = folded_reader(*capture)
    found = batches(reader.read, batch_size)
    snapshot, folded, saturated = (
        np.concatenate([batch[key] for batch in found])
        for key in ("snapshot", "folded", "saturated")
    )
    run = Run(wiforce.recording_source(*capture))
    np.testing.assert_array_equal(folded, run.items)
    assert snapshot.tolist() == counted_on(run.tags["snapshot"], len(folded))
    assert saturated.dtype == bool
    assert set(np.flatnonzero(saturated)) == set(run.tags["saturated"])


LONG_GROUP = 256  # is not read at once, so that two are folded side by side


@pytest.fixture(scope="module")
def long_groups(tmp_path_factory):
    """Arguments of tone_reader for 30 groups of noise, a burst in every third of them."""
    rng = np.random.default_rng(7)
    frames = rng.integers(-900, 900, (30 * LONG_GROUP, 2 * FRAME), dtype="<i2")
    for first in range(0, len(frames), 3 * LONG_GROUP):
        frames[first + 20 : first + 25] += rng.integers(-9000, 9000, (5, 2 * FRAME), dtype="<i2")
    path = tmp_path_factory.mktemp("long") / "x"
    path.write_bytes(frames.tobytes())
    weights = rng.normal(size=(TONES, LONG_GROUP)).astype(complex)
    shape = "ci16_le", [(0, 0, frames.size // 2)], FRAME, 64, 4, 0, 64
    return str(path), *shape, weights, WAVEFORM.equalizer(), [], WAVEFORM.bins


def read_on_processors(count, settings):
    """All groups, and the incomplete ones, with so many processors or as many as there are."""
    usable = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(usable)[:count]))
    try:
        incomplete = []
        found = tone_reader(*settings).read(100, lambda *group: incomplete.append(group))
        return found, incomplete
    finally:
        os.sched_setaffinity(0, usable)


def test_groups_folded_side_by_side_are_those_of_one_processor(long_groups):
    """A machine with more cores must not read anything else."""
    (one, hit), (two, hit_too) = (read_on_processors(n, long_groups) for n in (1, 2))
    assert one["index"].tolist() == list(range(30)) and one["rejected"].sum() >= 10 * 5
    for key, values in one.items():
        np.testing.assert_array_equal(two[key], values)
    assert [row for row, *_ in hit] == list(range(0, 30, 3))
    for group, same in zip(hit, hit_too, strict=True):
        for value, of_same in zip(group, same, strict=True):
            np.testing.assert_array_equal(of_same, value)


def test_an_error_while_groups_are_folded_reaches_the_caller(long_groups):
    """A reader whose threads wait for each other for ever would have to be killed."""

    def fail(row, *_):
        if row == 12:
            raise OverflowError("no room")

    with pytest.raises(OverflowError, match="no room"):
        tone_reader(*long_groups).read(100, fail)


@pytest.mark.parametrize("seed", cases(0, 1, long=(2, 3)))
def test_groups_of_a_file_cut_short_meanwhile_end_there(long_groups, tmp_path, seed):
    path = tmp_path / "x"
    samples = 400 * LONG_GROUP * FRAME
    with open(path, "wb") as file:
        file.truncate(4 * samples)
    reader = tone_reader(str(path), "ci16_le", [(0, 0, samples)], *long_groups[3:])
    size = int(np.random.default_rng(seed).integers(4 * samples))
    cut = threading.Timer(0.005, os.truncate, (path, size))
    cut.start()
    found = batches(reader.read, 64)
    cut.join()
    missing = reader.samples_missing()
    # The last frame needs its averaged samples, not its guard.
    whole = (samples - missing + FRAME - 64 - 256) // FRAME
    assert reader.snapshots() == whole
    index = np.concatenate([batch["index"] for batch in found])
    assert len(index) in (whole // LONG_GROUP, whole // LONG_GROUP + 1)
    assert index.tolist() == list(range(len(index)))


def test_a_frame_cut_off_behind_a_sample_at_full_scale_is_none(tmp_path):
    path = tmp_path / "x"
    np.full((3 * FRAME, 2), 32767, "<i2").tofile(path)
    reader = folded_reader(str(path), "ci16_le", [(0, 0, 3 * FRAME)], FRAME, 64, 4, 0, 64)
    assert reader.read(1)["saturated"].tolist() == [True]
    os.truncate(path, 4 * (FRAME + 64 + 10))
    assert len(reader.read(1)["saturated"]) == 0
    assert reader.snapshots() == 1


def test_kernels_do_not_load_gnu_radio():
    linked = subprocess.run(
        ["ldd", wiforce_kernels.__file__], capture_output=True, text=True, check=True
    ).stdout
    assert "fftw3f" in linked
    assert "gnuradio" not in linked
