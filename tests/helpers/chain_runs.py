# SPDX-License-Identifier: GPL-3.0-or-later
"""The chain of one block per step and the reader, on the same samples."""

import threading

import pmt
from chain_from_file import Chain
from gnuradio import gr, wiforce
from press_capture import FRAME, RATE_HZ

# Between the blocks of the chain items have single precision.
FORCE_LIMIT_N = LOCATION_LIMIT_MM = PHASE_LIMIT_DEG = 1e-4
EXACT = ("time_s", "sensor", "touch", "flags", "group")
CLOSE = {
    "phase1_deg": PHASE_LIMIT_DEG,
    "phase2_deg": PHASE_LIMIT_DEG,
    "force_n": FORCE_LIMIT_N,
    "force_std_n": FORCE_LIMIT_N,
    "location_mm": LOCATION_LIMIT_MM,
    "location_std_mm": LOCATION_LIMIT_MM,
    "snr_db": 1e-3,
    "interference": 1e-6,
}


# A reading as it comes out of a port.
PRESSED = {
    "time_s": 1.0,
    "sensor": "arm",
    "touch": 1,
    "force_n": 4.0,
    "force_std_n": 0.1,
    "location_mm": 40.0,
    "location_std_mm": 0.5,
    "phase1_deg": 10.0,
    "phase2_deg": -20.0,
    "snr_db": 12.0,
    "flags": "",
}


class Collector(gr.basic_block):
    """Collects readings, or other messages, and lets the test wait for them."""

    def __init__(self):
        gr.basic_block.__init__(self, "collector", None, None)
        self.readings = []
        self._more = threading.Condition()
        self.message_port_register_in(pmt.intern("readings"))
        self.set_msg_handler(pmt.intern("readings"), self._on_message)

    def _on_message(self, message):
        with self._more:
            self.readings.append(pmt.to_python(message))
            self._more.notify_all()

    def wait_for(self, enough):
        with self._more:
            assert self._more.wait_for(lambda: enough(self.readings), timeout=300)


def press_fold(**settings):
    """The block that folds the samples of ``press_capture.SCENE``."""
    return wiforce.preamble_fold(FRAME, item_type="sc16", sample_rate=RATE_HZ, **settings)


def run_chain(chain, *before, runs=1):
    """Run one block per step behind blocks that give snapshots; raise what ended it."""
    flowgraph = gr.top_block()
    chain.connect(flowgraph, *before)
    for _ in range(runs):
        flowgraph.run()
    chain.check()


def readings_of_chain(plan, *before, runs=1, tracked=False):
    """Readings by one block per step, as in the examples, behind blocks that give snapshots."""
    readings = []
    chain = Chain(plan, readings.append)
    chain.to_force[-1] = wiforce.force_inversion(plan, tracked, on_reading=readings.append)
    run_chain(chain, *before, runs=runs)
    assert chain.to_force[-1].ended.is_set()
    return readings


def readings_of_reader(plan, *before, input_type="sc16", runs=1, **options):
    """Readings by the block that holds the whole receiver."""
    readings, flowgraph = [], gr.top_block()
    reader = wiforce.reader(plan, input_type, on_reading=readings.append, **options)
    flowgraph.connect(*before, reader)
    for _ in range(runs):
        flowgraph.run()
    assert reader.failure is None
    return readings


def assert_equal_readings(found, expected, precision=None):
    """Compare readings group by group: touch, force, location, phases and flags.

    Numbers agree within ``CLOSE``, or within ``precision`` of 1 and of their own size.
    """
    assert len(found) == len(expected)
    for own, other in zip(found, expected, strict=True):
        assert [getattr(own, name) for name in EXACT] == [getattr(other, name) for name in EXACT]
        for name, limit in CLOSE.items():
            value, wanted = getattr(own, name), getattr(other, name)
            assert (value is None) == (wanted is None), (name, own.group)
            if value is not None:
                most = limit if precision is None else precision * (1 + abs(wanted))
                assert abs(value - wanted) <= most, (name, own.group)
