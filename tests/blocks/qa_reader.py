# SPDX-License-Identifier: GPL-3.0-or-later
"""The reader block: one chain whatever comes in, gaps that cost only what they hit."""

import threading

import numpy as np
import pmt
import pytest
from chain_runs import press_fold, readings_of_chain, readings_of_reader
from command_runs import rows_of
from device_times import tag_at
from gnuradio import blocks, gr, wiforce
from machine import wait_until
from press_capture import FRAME, GROUP, RATE_HZ, SCENE, array_source, run_flowgraph, running


def read(samples, tags=()):
    """Readings of codes (n, 2) through the reader block."""
    return readings_of_reader(SCENE, array_source(samples, tags))


@pytest.mark.parametrize("carrier_hz, first", [(900.8e6, 0), (2.4e9, 11), (float("nan"), 11)])
def test_reader_takes_samples_at_the_carrier_of_the_scene_only(codes, carrier_hz, first):
    """Phases at another carrier look like presses with another force."""
    tags = [
        tag_at(at, "rx_freq", pmt.from_double(hertz))
        for at, hertz in ((0, carrier_hz), (11 * GROUP + 7, carrier_hz if first == 0 else 900e6))
    ]
    readings = read(codes, tags)
    assert [r.group for r in readings if r.phase1_deg is not None][0] == first


@pytest.mark.parametrize("way", ["samples", "folded samples", "recording"])
def test_reader_clipped_groups_are_flagged_for_every_input(codes, tmp_path, way):
    clipped = codes.copy()
    clipped[11 * GROUP + 340 :: FRAME][:20] = 32767  # in guards, which are never looked at
    clipped[12 * GROUP + 100 :: FRAME][:4] = 32767
    clipped[15 * GROUP + 100 :: FRAME][:3] = 32767  # the peak of a recording: less than 1 %
    clipped[20 * GROUP - 4 * FRAME + 300 :: FRAME][:8] = -32768  # the last of 19, the first of 20
    before = [array_source(clipped)]
    if way == "folded samples":
        before.append(press_fold())
    elif way == "recording":
        clipped.tofile(tmp_path / "press.bin")
        before = [wiforce.capture_source(tmp_path / "press.bin", SCENE, datatype="ci16_le")]
    readings = readings_of_reader(
        SCENE, *before, input_type="sc16" if way == "samples" else "folded"
    )
    flagged = [i for i, reading in enumerate(readings) if "saturated" in reading.flags]
    assert flagged == [12, 19, 20]


@pytest.mark.parametrize("way", ["samples", "folded", "chain"])
def test_reader_times_count_from_the_first_sample_of_the_stream(codes, tmp_path, way):
    """A stream that begins before the first frame gave times that began with it."""
    before = 3 * FRAME + 100
    late = np.concatenate([np.zeros((before, 2), "<i2"), codes[: 14 * GROUP]])
    late.tofile(tmp_path / "late.bin")
    if way == "samples":
        found = readings_of_reader(SCENE, array_source(late), frame_offset=before)
    elif way == "folded":
        source = wiforce.capture_source(tmp_path / "late.bin", SCENE, before, "ci16_le")
        found = readings_of_reader(SCENE, source, input_type="folded", frame_offset=before)
    else:
        plan = wiforce.plan(SCENE).with_first_frame(before)
        found = readings_of_chain(plan, array_source(late), press_fold(frame_offset=before))
    first_s = (before + GROUP / 2) / RATE_HZ
    assert [r.time_s for r in found] == pytest.approx([first_s + 0.036 * n for n in range(14)])


def test_reader_exception_ends_the_flowgraph():
    def fail(reading):
        raise RuntimeError("no space left")

    reader = wiforce.reader(SCENE, on_reading=fail)
    flowgraph = gr.top_block()
    flowgraph.connect(blocks.null_source(gr.sizeof_gr_complex), reader)
    with running(flowgraph):
        # Dead air without end: only the failure ends it.
        assert reader.ended.wait(60)
    assert isinstance(reader.failure, RuntimeError) and reader.failure is reader.groups.failure


def test_reader_output_is_begun_by_readings_and_closed_at_the_end(codes, tmp_path):
    """Without samples, as of a device that does not start, the former file is kept."""
    path, flowgraph = tmp_path / "readings.csv", gr.top_block()
    path.write_text("former")
    reader = wiforce.reader(SCENE, "sc16", on_reading=wiforce.open_writer(path))
    source = array_source(codes[:0])
    flowgraph.connect(source, reader)
    flowgraph.run()
    assert path.read_text() == "former"
    for groups in (14, 28):  # the second run continues the file
        source._items, source._at = codes[: 14 * GROUP], 0
        flowgraph.run()
        assert reader.failure is None and len(rows_of(path)) == groups
        wiforce.open_writer(path, append=True).begin().close()  # nobody holds it


def test_reader_output_that_cannot_be_begun_ends_the_flowgraph(codes, tmp_path):
    path, source = tmp_path / "readings.csv", array_source(codes[: 14 * GROUP])
    with wiforce.open_writer(path) as other:
        other.begin()
        reader = wiforce.reader(SCENE, "sc16", on_reading=wiforce.open_writer(path))
        run_flowgraph(source, reader)
    assert "is being written to by another process" in str(reader.failure)


def test_reader_reports_what_becomes_of_a_tare():
    """By the message port and by the callback; the request comes from another thread."""
    reader, flowgraph = wiforce.reader("demo"), gr.top_block()
    states, ended = [], threading.Event()
    port = blocks.message_debug(False)
    flowgraph.connect(blocks.null_source(8), reader)
    flowgraph.msg_connect(reader, "tare_state", port, "store")
    with running(flowgraph):
        reader.tare(done=lambda state: (states.append(state), ended.set()))
        assert ended.wait(20)
        wait_until(port.num_messages)
    assert [s.state for s in states] == ["refused"]
    message = pmt.to_python(port.get_message(0))
    assert message["state"] == "refused" and "first reference" in message["reason"]


@pytest.mark.parametrize(
    "value, forced",
    [
        (pmt.PMT_NIL, False),
        (pmt.from_long(3), False),
        (pmt.to_pmt({"force": "yes", "request": [1]}), False),
        (pmt.to_pmt({"force": float("nan")}), False),
        (pmt.to_pmt({"force": True}), True),
        (pmt.dict_add(pmt.make_dict(), pmt.intern("force"), pmt.init_f32vector(2, [1, 2])), False),
    ],
)
def test_reader_takes_any_message_as_a_request_and_forces_by_true_only(value, forced):
    reader, states = wiforce.reader("demo"), []
    reader.stream.tares.on_state = states.append
    reader.groups._on_tare(value)
    assert reader.failure is None
    assert [(state.state, state.forced) for state in states] == [("refused", forced)]
