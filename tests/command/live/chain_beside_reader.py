# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the chain behind a USRP until Enter is pressed, with a reader on the same samples.

    build/run python3 tests/command/live/chain_beside_reader.py DEVICE SCENE [PROGRAM]

Runs chain_from_usrp.py, or the PROGRAM that Companion made of chain_from_usrp.grc. Prints the
readings of the chain, and fails unless they are those of the reader.
"""

import runpy
import sys
from pathlib import Path

import pmt

ROOT = Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT / "tests/helpers"), str(ROOT / "examples/headless")]

from chain_from_usrp import ChainFromUsrp  # noqa: E402
from chain_runs import assert_equal_readings  # noqa: E402
from gnuradio import gr, wiforce  # noqa: E402
from gnuradio.wiforce.io.readings import as_reading  # noqa: E402
from live_uhd import run  # noqa: E402

STEPS = ("separation", "difference", "average", "inversion")


class Listener(gr.basic_block):
    """Calls a function with the readings of a message port."""

    def __init__(self, on_reading):
        gr.basic_block.__init__(self, "listener", None, None)
        self.message_port_register_in(pmt.intern("readings"))
        # GNU Radio takes no lambda.
        self._on_reading = on_reading
        self.set_msg_handler(pmt.intern("readings"), self._on_message)

    def _on_message(self, message):
        self._on_reading(as_reading(pmt.to_python(message)))


def of_companion(program, device):
    """The flowgraph that Companion made, with windows that nobody sees."""
    from PyQt5.Qt import QApplication

    module = runpy.run_path(program)
    application = QApplication.instance() or QApplication([])
    flowgraph = module["chain_from_usrp"](device=device)
    flowgraph.application = application  # kept as long as its windows
    return flowgraph


def main(device, scene, program=None):
    readings, expected = [], []

    def on_reading(reading):
        readings.append(reading)
        print(reading, flush=True)

    if program is None:
        flowgraph = ChainFromUsrp(device, scene, on_reading)
        steps = flowgraph.chain.to_force
    else:
        flowgraph, listener = of_companion(program, device), Listener(on_reading)
        flowgraph.msg_connect(flowgraph.inversion, "readings", listener, "readings")
        steps = [getattr(flowgraph, name) for name in STEPS]
    reader = wiforce.reader(scene, "sc16", on_reading=expected.append)
    flowgraph.connect(flowgraph.usrp, reader)
    run(flowgraph)
    assert [block.failure for block in (*steps, reader)] == [None] * (len(steps) + 1)
    # Which groups are the last ones, when a flowgraph is stopped, differs from branch to branch.
    both = min(len(readings), len(expected)) - 1
    if program is not None:
        expected = [as_reading(reading.row()) for reading in expected]
    assert_equal_readings(readings[:both], expected[:both], last_digit=program is not None)


if __name__ == "__main__":
    main(*sys.argv[1:])
