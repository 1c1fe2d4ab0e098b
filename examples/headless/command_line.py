# SPDX-License-Identifier: GPL-3.0-or-later
"""How the programs of this folder begin and end."""

import select
import signal
import sys
from pathlib import Path

from gnuradio.wiforce.errors import InputError, OutputError

LOOK_S = 0.2


def start(main, usage="", counts=(0,), example=""):
    """Call ``main`` with the arguments of the program.

    A wrong number of them (``counts``) and bad input end it with a sentence and status 2, an
    output that cannot be written with 1.
    """
    program, arguments = Path(sys.argv[0]).name, sys.argv[1:]
    if len(arguments) not in counts:
        hint = f", for example: {program} {example}" if example else ""
        end(f"usage: {program} {usage}".rstrip() + hint)
    try:
        main(*arguments)
    except InputError as error:  # such as a device that does not answer, or an existing file
        end(error)
    except OutputError as error:
        end(error, 1)
    except KeyboardInterrupt:
        pass


def end(message, status=2):
    print(message, file=sys.stderr)
    sys.exit(status)


def run(flowgraph):
    """Run until Enter, Ctrl-C, SIGTERM or the end of the input."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        flowgraph.start()
        print("Press Enter or Ctrl-C to end.", flush=True)
        wait_for_enter()
    except KeyboardInterrupt:
        pass
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)  # the second one ends the program at once
        flowgraph.stop()
        flowgraph.wait()


def wait_for_enter():
    """Wait for a line or the end of the input; not at all where it is closed, or of nohup."""
    if sys.stdin is None:
        return
    try:
        # With `input`, a signal that comes just before it would wait for a line.
        while not select.select([sys.stdin], [], [], LOOK_S)[0]:
            pass
        sys.stdin.readline()
    except OSError:  # it cannot be read
        pass


def gains_db(texts):
    """Gains of transmitter and receiver as numbers; none are those of the device."""
    try:
        return [float(text) for text in texts]
    except ValueError:
        raise InputError("gains", "must be numbers, in dB", " ".join(texts)) from None
