# SPDX-License-Identifier: GPL-3.0-or-later
"""The clock offset that a flowgraph shows is the one that the separation found."""

import numpy as np
import pmt
import pytest
from gnuradio import blocks, gr, wiforce
from gnuradio.wiforce.blocks import names
from gnuradio.wiforce.blocks.group_block import state_to_pmt
from gnuradio.wiforce.estimation.groups import Groups


def separated(index, locked, offsets_ppm):
    """One group behind the separation."""
    return Groups(
        [index],
        locked=np.array([locked]),
        clock_offset_ppm=np.array([offsets_ppm]),
    )


def state_tag_at(offset, group):
    tag = gr.tag_t()
    tag.offset, tag.key, tag.value = offset, pmt.intern(names.STATE), state_to_pmt(group)
    return tag


def test_clock_offset_without_lock_is_nan():
    groups = [separated(0, [True, False], [40.0, 0.0]), separated(1, [True, True], [41.5, -65.25])]
    tags = [state_tag_at(n, group) for n, group in enumerate(groups)]
    source = blocks.vector_source_c([0j] * 3 * 256, False, 256, tags)
    block = wiforce.clock_offset(sensors=2, length=256)
    sink = blocks.vector_sink_f(2)
    flowgraph = gr.top_block()
    flowgraph.connect(source, block, sink)
    flowgraph.run()
    found = np.array(sink.data()).reshape(3, 2)
    np.testing.assert_array_equal(found, [[40, np.nan], [41.5, -65.25], [np.nan, np.nan]])


@pytest.mark.parametrize("parameters", [{"sensors": 0}, {"length": 0}])
def test_clock_offset_sizes_below_one_are_refused(parameters):
    with pytest.raises(ValueError, match=f"{next(iter(parameters))}: must be at least 1"):
        wiforce.clock_offset(**parameters)
