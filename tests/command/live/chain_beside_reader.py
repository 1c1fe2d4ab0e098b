# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the chain behind a USRP until Enter is pressed, with a reader on the same samples.

    build/run python3 tests/command/live/chain_beside_reader.py DEVICE SCENE

Runs chain_from_usrp.py. Prints the readings of the chain, and fails unless they are those of the
reader.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT / "tests/helpers"), str(ROOT / "examples/headless")]

from chain_from_usrp import ChainFromUsrp  # noqa: E402
from chain_runs import assert_equal_readings  # noqa: E402
from gnuradio import wiforce  # noqa: E402
from live_uhd import run  # noqa: E402


def main(device, scene):
    readings, expected = [], []

    def on_reading(reading):
        readings.append(reading)
        print(reading, flush=True)

    flowgraph = ChainFromUsrp(device, scene, on_reading)
    reader = wiforce.reader(scene, "sc16", on_reading=expected.append)
    flowgraph.connect(flowgraph.usrp, reader)
    run(flowgraph)
    assert not any(block.failure for block in (*flowgraph.chain.to_force, reader))
    # Which groups are the last ones, when a flowgraph is stopped, differs from branch to branch.
    both = min(len(readings), len(expected)) - 1
    assert_equal_readings(readings[:both], expected[:both])


if __name__ == "__main__":
    main(*sys.argv[1:])
