# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings as float streams, for GNU Radio's own sinks."""

import numpy as np
import pmt
from chain_runs import PRESSED
from gnuradio import blocks, gr, wiforce
from machine import wait_until
from press_capture import running

UNTOUCHED = {"time_s": 0.9, "sensor": "arm", "touch": 0, "flags": "reference"}


def streams(messages, items, **settings):
    """The first items of the four streams after these messages, shape (4, items)."""
    flowgraph = gr.top_block()
    block = wiforce.readings_to_floats(**settings)
    sinks = [blocks.vector_sink_f() for _ in range(4)]
    for n, sink in enumerate(sinks):
        flowgraph.connect((block, n), sink)
    for message in messages:
        block.to_basic_block()._post(pmt.intern("readings"), pmt.to_pmt(message))
    with running(flowgraph):
        wait_until(lambda: min(len(sink.data()) for sink in sinks) >= items)
    return np.array([sink.data()[:items] for sink in sinks])


def test_floats_are_the_values_of_the_readings():
    odd = [{}, {"sensor": "arm"}]  # and malformed messages are omitted
    found = streams([*odd, UNTOUCHED, PRESSED, PRESSED | {"force_n": 5.0}], 3)
    unknown = np.nan
    expected = [[0, 4, 5], [unknown, 0.1, 0.1], [unknown, 40, 40], [unknown, 0.5, 0.5]]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_floats_are_repeated_in_the_order_of_the_readings():
    """A sink whose sample rate is stated as 3 x 28 would run at another speed."""
    forces = [PRESSED | {"force_n": float(n)} for n in range(1, 401)]
    found = streams(forces, 1200, repeat=3)
    np.testing.assert_array_equal(found[0], np.repeat(np.arange(1, 401), 3))


def test_floats_of_other_sensors_are_omitted():
    """Two sensors in one stream would look like one that jumps."""
    other = PRESSED | {"sensor": "finger", "force_n": 7.0}
    assert streams([PRESSED, other, PRESSED], 2)[0].tolist() == [4.0, 4.0]
    assert streams([PRESSED, other, PRESSED], 1, sensor="finger")[0].tolist() == [7.0]


def test_floats_of_flagged_readings_can_be_unknown():
    """A doubtful force must not look like a reliable one where no flag is shown."""
    flagged = PRESSED | {"flags": "weak", "force_n": 9.0}
    assert streams([PRESSED, flagged], 2)[0].tolist() == [4.0, 9.0]
    found = streams([PRESSED, flagged, UNTOUCHED], 3, flagged=False, unknown=-1.0)
    assert found[:, 1].tolist() == [-1.0] * 4
    assert found[0].tolist() == [4.0, -1.0, 0.0]
    assert found[2].tolist() == [40.0, -1.0, -1.0]
    odd = PRESSED | {"force_n": None, "location_mm": "40"}
    found = streams([odd, PRESSED], 2, unknown=-1.0)
    assert found[0].tolist() == [-1.0, 4.0] and found[2].tolist() == [-1.0, 40.0]
