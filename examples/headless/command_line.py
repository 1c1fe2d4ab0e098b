# SPDX-License-Identifier: GPL-3.0-or-later
"""How the programs of this folder begin and end."""

import select
import signal
import sys
from contextlib import suppress
from pathlib import Path

from gnuradio.wiforce.errors import InputError

LOOK_S = 0.2


def start(main, usage="", counts=(0,), example=""):
    """Call ``main`` with the arguments of the program.

    A wrong number of them (``counts``) and bad input end it with a sentence and status 2.
    """
    program, arguments = Path(sys.argv[0]).name, sys.argv[1:]
    if len(arguments) not in counts:
        hint = f", for example: {program} {example}" if example else ""
        end(f"usage: {program} {usage}".rstrip() + hint)
    try:
        main(*arguments)
    except InputError as error:  # such as a device that does not answer, or an existing file
        end(error)
    except KeyboardInterrupt:
        pass


def end(message):
    print(message, file=sys.stderr)
    sys.exit(2)


def run(flowgraph):
    """Run until Enter, Ctrl-C, SIGTERM or the end of the input."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        # OSError: nohup gives programs an input that cannot be read.
        with suppress(KeyboardInterrupt, OSError):
            flowgraph.start()
            print("Press Enter or Ctrl-C to end.", flush=True)
            # With `input`, a signal that comes just before it would wait for a line.
            while not select.select([sys.stdin], [], [], LOOK_S)[0]:
                pass
            sys.stdin.readline()
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)  # the second one ends the program at once
        flowgraph.stop()
        flowgraph.wait()


def gains_db(texts):
    """Gains of transmitter and receiver as numbers; none are those of the device."""
    try:
        return [float(text) for text in texts]
    except ValueError:
        raise InputError("gains", "must be numbers, in dB", " ".join(texts)) from None
