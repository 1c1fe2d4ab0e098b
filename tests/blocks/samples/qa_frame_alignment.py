# SPDX-License-Identifier: GPL-3.0-or-later
"""frame_alignment and sigmf_recorder: which samples pass, their times, what a recording says."""

import json
import time

import numpy as np
import pmt
import pytest
from device_times import rx_time, tag_at
from gnuradio import blocks, wiforce
from gnuradio.wiforce.blocks.sample_files import capture_stream
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.capture.frame import MARGIN, measure_levels
from gnuradio.wiforce.io.capture import Segment, open_capture
from gnuradio.wiforce.io.readings import parsed_utc
from gnuradio.wiforce.signal.waveform import sounding_waveform
from press_capture import array_source, run_flowgraph

RATE = 12.5e6
WAVEFORM = sounding_waveform()


def stream(before, frames, seed=1):
    """Frames after so many samples of noise; complex64, exact in 16 bits."""
    rng = np.random.default_rng(seed)
    sent = np.tile(0.4 * WAVEFORM.frame(), frames)
    samples = np.concatenate([np.zeros(before), sent])
    samples = samples + 0.01 * (rng.normal(size=len(samples)) + 1j * rng.normal(size=len(samples)))
    return (np.rint(samples * 32768) / 32768).astype(np.complex64)


def align(samples, tags=(), **parameters):
    """What passes the block, its rx_time tags {offset: seconds}, and the block."""
    block = wiforce.frame_alignment(search_frames=20, **parameters)
    items, sink = samples, blocks.vector_sink_c()
    if parameters.get("item_type") == "sc16":
        items = np.rint(samples.view(np.float32) * 32768).astype(np.int16).reshape(-1, 2)
        sink = blocks.vector_sink_s(2)
    source = array_source(items, tags)
    run_flowgraph(source, block, sink)
    tags = [tag for tag in sink.tags() if str(tag.key) == "rx_time"]
    times = {tag.offset: sum(pmt.to_python(tag.value)) for tag in tags}
    return np.array(sink.data()), times, block


@pytest.mark.parametrize("item_type", ["fc32", "sc16"])
@pytest.mark.parametrize("before", [MARGIN, 64, 700])
def test_the_first_sample_is_a_frame_s_and_nothing_of_it_is_lost(item_type, before):
    samples = stream(before, 50)
    passed, times, block = align(samples, [rx_time(0, 3.5)], item_type=item_type)
    if item_type == "sc16":
        passed = (passed.reshape(-1, 2) / 32768) @ [1, 1j]
    first = before - MARGIN
    assert block.offset == first
    assert np.array_equal(passed.astype(np.complex64), samples[first:])
    assert times == {0: pytest.approx(3.5 + first / RATE, abs=1e-12)}
    assert block.start_time[0] == 3


def test_later_tags_stay_with_their_samples():
    samples = stream(100, 60)
    tags = [rx_time(n, 1.0 + n / RATE) for n in (0, 30_000, 40_000)]
    _, times, _ = align(samples, tags)
    assert list(times) == [0, 30_000 - 92, 40_000 - 92]
    assert times[30_000 - 92] == pytest.approx(1.0 + 30_000 / RATE, abs=1e-12)


def test_a_gap_while_searching_begins_the_search_anew():
    samples = np.concatenate([stream(100, 10), stream(300, 50, seed=2)])
    gap = 100 + 7200
    _, times, block = align(samples, [rx_time(0, 1.0), rx_time(gap, 2.0)])
    assert block.offset == gap + 300 - MARGIN
    assert times == {0: pytest.approx(2.0 + (300 - MARGIN) / RATE, abs=1e-12)}


def test_without_frames_nothing_passes_and_the_search_goes_on():
    passed, _, block = align(stream(50_000, 0))
    assert len(passed) == 0 and block.offset is None and block.searches == 3


def test_a_search_of_more_than_a_second_warns_of_nothing(monkeypatch):
    """A slow radio whose frames were not searched yet was said to have ended."""
    said = []
    monkeypatch.setattr(wiforce.frame_alignment, "_warn", lambda _, sentence: said.append(sentence))
    _, _, block = align(stream(100, 30), sample_rate=1e4)
    assert block.offset == 100 - MARGIN and not said


def test_a_recording_marks_the_gaps_and_goes_on_when_its_flowgraph_is_started_again(tmp_path):
    """As when the common start of a device's streams was missed: what came between is a gap."""
    samples = stream(0, 30)
    recorder = wiforce.sigmf_recorder(tmp_path / "run", fields={"core:hw": "a device"})
    parts = [(samples[:5000], 1.0), (samples[5000:], 1.0 + 6000 / RATE)]
    for part, start_s in parts:
        tags = [rx_time(0, start_s), rx_time(4000, start_s + 4100 / RATE)]
        run_flowgraph(array_source(part, tags), recorder)
    assert recorder.failure is None
    capture = open_capture(tmp_path / "run")
    assert np.array_equal(capture.read(len(samples)), samples)
    places = [(s.file_sample, s.global_index, s.length) for s in capture.segments]
    last = len(samples) - 9000
    expected = (0, 0, 4000), (4000, 4100, 1000), (5000, 6000, 4000), (9000, 10_100, last)
    assert places == [*expected]
    fields = json.loads((tmp_path / "run.sigmf-meta").read_text())["global"]
    assert fields["core:hw"] == "a device" and fields["core:datatype"] == "cf32_le"
    assert fields["wiforce:samples"] == len(samples) and capture.incomplete == ""


@pytest.mark.parametrize("clock", ["absolute", "compared", "unknown", "none"])
def test_a_recording_states_when_its_first_sample_was_received(tmp_path, clock):
    """It stated when samples were processed, and gaps did not agree with their length."""
    received_s = time.time() - 100.0
    start_s = {"absolute": received_s, "none": None}.get(clock, 5.0)
    tags = [] if start_s is None else [rx_time(0, start_s), rx_time(4000, start_s + 2)]
    recorder = wiforce.sigmf_recorder(tmp_path / "run", RATE)
    if clock == "compared":
        recorder.utc_offset_s = received_s - 5.0
    run_flowgraph(array_source(stream(0, 30), tags), recorder)
    captures = json.loads((tmp_path / "run.sigmf-meta").read_text())["captures"]
    times_s = [parsed_utc(each["core:datetime"]).timestamp() for each in captures]
    if clock in ("absolute", "compared"):
        assert times_s == pytest.approx([received_s, received_s + 2], abs=2e-6)
    else:
        assert times_s[0] == pytest.approx(time.time(), abs=30)
    assert np.diff(times_s) == pytest.approx([] if start_s is None else [2], abs=2e-6)


def test_a_recording_leaves_out_other_rates_and_carriers_and_states_its_own(tmp_path):
    """What live discards was recorded as good, at a carrier that the device never had."""
    samples = stream(0, 30)
    settings = ("rx_freq", 1000, 2.4e9), ("rx_freq", 2000, 900.2e6), ("rx_rate", 7000, 10e6)
    tags = [tag_at(at, key, pmt.from_double(hertz)) for key, at, hertz in settings]
    tags += [rx_time(0, 1.0), rx_time(8000, 1.0 + 8500 / RATE)]
    tags += [tag_at(9000, "rx_rate", pmt.from_double(RATE)), tag_at(9500, "rx_freq", pmt.PMT_T)]
    tags += [tag_at(at, "retuned", pmt.from_uint64(1)) for at in (7500, 12_000)]
    recorder = wiforce.sigmf_recorder(tmp_path / "run")
    run_flowgraph(array_source(samples, sorted(tags, key=lambda tag: tag.offset)), recorder)
    assert recorder.failure is None
    capture = open_capture(tmp_path / "run")
    kept = [samples[:1000], samples[2000:7000], samples[9000:]]
    assert np.array_equal(capture.read(len(samples)), np.concatenate(kept))
    assert capture.center_frequency_hz == 900.2e6
    assert capture.segments == (
        Segment(0, 0, 1000),
        Segment(1000, 2000, 5000, retuned=True),
        Segment(6000, 9500, 3000, retuned=True),
        Segment(9000, 12_500, len(samples) - 12_000, retuned=True),
    )
    entries = json.loads((tmp_path / "run.sigmf-meta").read_text())["captures"]
    assert "wiforce:retuned" not in entries[0] and entries[1]["wiforce:retuned"] is True
    followed, sink = capture_stream(tmp_path / "run"), blocks.vector_sink_c()
    followed.ended.set()
    run_flowgraph(followed, sink)
    tagged = [tag.offset for tag in sink.tags() if str(tag.key) == "retuned"]
    assert tagged == [1000, 6000, 9000]


def test_a_recording_has_the_carrier_of_the_device_whatever_was_stated(tmp_path):
    """Center Frequency was left at 900 MHz, and a whole measurement was not recorded."""
    samples = stream(0, 30)
    settings = ("rx_freq", 0, 2.44e9), ("rx_freq", 4000, 900e6), ("rx_freq", 5000, 2.44e9)
    tags = [tag_at(at, key, pmt.from_double(hertz)) for key, at, hertz in settings]
    recorder = wiforce.sigmf_recorder(tmp_path / "run")
    run_flowgraph(array_source(samples, tags), recorder)
    capture = open_capture(tmp_path / "run")
    kept = np.concatenate([samples[:4000], samples[5000:]])
    assert np.array_equal(capture.read(len(samples)), kept)
    assert capture.center_frequency_hz == 2.44e9


def test_a_recording_without_samples_leaves_no_file(tmp_path):
    """An empty file without metadata cannot be read, and stood in the way of the next run."""
    recorder = wiforce.sigmf_recorder(tmp_path / "run")
    run_flowgraph(array_source(stream(0, 0)), recorder)
    assert list(tmp_path.iterdir()) == []
    run_flowgraph(array_source(stream(0, 3), [rx_time(0, 1.0)]), recorder)
    assert recorder.failure is None
    assert open_capture(tmp_path / "run").samples == 3 * WAVEFORM.frame_length


@pytest.mark.parametrize("start_s", [None, 0.5, 5000.0])
def test_a_recording_never_joins_what_may_lie_any_time_apart(tmp_path, start_s):
    samples = stream(0, 30)
    recorder = wiforce.sigmf_recorder(tmp_path / "run")
    for tags in ([rx_time(0, 1.0)], [] if start_s is None else [rx_time(0, start_s)]):
        run_flowgraph(array_source(samples, tags), recorder)
    assert "no rx_time reports the samples lost" in recorder.failure.strerror
    assert open_capture(tmp_path / "run").segments == (Segment(0, 0, len(samples)),)


def test_nothing_is_overwritten(tmp_path):
    (tmp_path / "run.sigmf-meta").write_text("precious")
    with pytest.raises(InputError, match="exists already"):
        wiforce.sigmf_recorder(tmp_path / "run")
    with pytest.raises(InputError, match="cannot be written"):
        wiforce.sigmf_recorder(tmp_path / "nowhere" / "run")
    assert (tmp_path / "run.sigmf-meta").read_text() == "precious"


def test_levels_are_those_of_the_parts_that_make_the_samples():
    rng = np.random.default_rng(3)
    count = 500 * 720
    noise = 1e-3 * (rng.normal(size=count) + 1j * rng.normal(size=count)) / np.sqrt(2)
    shifted = np.roll(np.tile(0.4 * WAVEFORM.frame(), 500), MARGIN)
    levels = measure_levels(shifted + noise + 0.01, WAVEFORM)
    assert levels.noise_dbfs == pytest.approx(-60, abs=0.1)
    assert levels.dc_dbfs == pytest.approx(-40, abs=0.1)
    assert levels.preamble_dbfs == pytest.approx(20 * np.log10(0.4), abs=0.1)
    assert levels.clipped == 0
    loud = np.clip((4 * (shifted + noise)).view(float), -1, 1).view(complex)
    clipped = measure_levels(loud, WAVEFORM).clipped
    assert clipped > 0.1
    assert measure_levels(0.5 * loud, WAVEFORM).clipped == clipped  # limited below full scale
