# SPDX-License-Identifier: GPL-3.0-or-later
"""The chain of one block per step reads a stream to its end, as the reader does."""

import numpy as np
import pytest
from chain_from_file import Chain
from chain_runs import (
    assert_equal_readings,
    press_fold,
    readings_of_chain,
    readings_of_reader,
    run_chain,
)
from device_times import rx_time
from gnuradio import blocks, gr
from press_capture import FRAME, GROUP, RATE_HZ, array_source, running

# Groups of the acquisition, then of the reference: 0.4 s and 0.3 s.
ACQUISITION, REFERENCE = 11, 8


class resumed_source(gr.sync_block):
    """Emits the next part of an array in each run of its flowgraph."""

    def __init__(self, items, ends):
        gr.sync_block.__init__(self, "resumed_source", None, [(items.dtype, items.shape[1])])
        self._items, self._ends, self._at, self._end = items, list(ends), 0, 0

    def start(self):
        self._end = self._ends.pop(0)
        return True

    def work(self, input_items, output_items):
        count = min(len(output_items[0]), self._end - self._at)
        output_items[0][:count] = self._items[self._at : self._at + count]
        self._at += count
        return count or -1


@pytest.mark.parametrize("groups", [0.5, 1, REFERENCE - 1, ACQUISITION, 17.3])
def test_chain_stream_of_any_length_is_read_as_by_the_reader(codes, plan, groups):
    """Streams shorter than acquisition and reference gave no readings, longer ones not all."""
    kept = codes[: int(groups * GROUP)]
    found = readings_of_chain(plan, array_source(kept), press_fold())
    assert len(found) == int(groups)
    assert_equal_readings(found, readings_of_reader(plan, array_source(kept)))


def test_chain_reads_a_clipped_group_and_a_gap_at_the_end_as_the_reader(codes, plan):
    """The snapshots of an incomplete group come as a message, and its sender has ended then."""
    start, lost, end = 18 * GROUP + 25_000, 9_000, 19 * GROUP
    tags = [rx_time(0, 0.0), rx_time(start, (start + lost) / RATE_HZ)]
    kept = np.delete(codes[:end], slice(start, start + lost), axis=0)
    kept[12 * GROUP + 100 :: FRAME][:4] = 32767
    found = readings_of_chain(plan, array_source(kept, tags), press_fold())
    assert [r.group for r in found if "saturated" in r.flags] == [12]
    assert found[18].touch == 1 and "gap" in found[18].flags
    assert_equal_readings(found, readings_of_reader(plan, array_source(kept, tags)))


@pytest.mark.parametrize("groups", [(4, 16.5, 25), (ACQUISITION, 16.5, 25)])
def test_chain_flowgraph_that_is_run_again_goes_on_as_the_reader(codes, plan, groups):
    ends = [int(end * GROUP) for end in groups]
    found, expected = (
        read(plan, resumed_source(codes, ends), *more, runs=len(ends))
        for read, more in ((readings_of_chain, [press_fold()]), (readings_of_reader, []))
    )
    assert len(found) == 25 and sum(reading.touch == 1 for reading in found) >= 8
    assert_equal_readings(found, expected)


def test_chain_exception_at_the_end_of_a_stream_ends_the_flowgraph(codes, plan, monkeypatch):
    def fail():
        raise RuntimeError("no clock")

    readings = []
    chain = Chain(plan, readings.append)
    monkeypatch.setattr(chain.to_force[0].stage, "flush", fail)
    with pytest.raises(RuntimeError, match="no clock"):
        run_chain(chain, array_source(codes[: 5 * GROUP]), press_fold())
    assert readings == []


def test_chain_that_is_stopped_ends_without_its_stream(plan):
    """A radio sends until the user stops the flowgraph."""
    readings, flowgraph = [], gr.top_block()
    chain = Chain(plan, readings.append)
    chain.connect(flowgraph, blocks.null_source(4), press_fold())
    with running(flowgraph):
        while chain.to_force[0].nitems_read(0) < 2:
            assert not chain.to_force[-1].ended.wait(0.02)
    chain.check()
    assert chain.to_force[-1].ended.is_set()


def test_chain_ended_by_another_branch_gives_its_readings_in_order(codes, plan):
    """A block that ends marks its input as ended, also for the others that read it."""
    readings, flowgraph = [], gr.top_block()
    chain, source = Chain(plan, readings.append), array_source(codes)
    chain.connect(flowgraph, source, press_fold())
    size = 128 * gr.sizeof_gr_complex
    flowgraph.connect(chain.to_force[0], blocks.head(size, 14), blocks.null_sink(size))
    flowgraph.run()
    chain.check()
    assert chain.to_force[-1].ended.is_set()
    groups = [reading.group for reading in readings]
    assert groups == list(range(len(groups)))
